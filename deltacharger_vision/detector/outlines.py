# SPDX-License-Identifier: Apache-2.0
"""Lines of two bars that a camera can see as edges, for a rough pose of the terminal.

A bar rises above its plate, so at a slant it shows a side beside its touched face. If that side is wide enough, its
root on the plate is a separate line. If it is too narrow for two lines, the edge lies somewhere between them and has
less weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.poses import TerminalPose
from deltacharger_vision.projection import project
from deltacharger_vision.terminal import Terminal

_OUTWARD = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
_FLAT = 0.7
"""A narrower side is invisible, px."""
_APART = 3.0
"""A wider side shows two edges, px."""
_MERGED = 0.3
"""Standard deviation of a narrow side's merged edge, in widths of the side."""
_DRAWN = 0.5
"""Standard deviation of an edge whose neighbour is just far enough to separate them, px."""
_BARS = np.repeat([0, 1], 4)
_SIDES = np.tile([0, 1, 2, 3], 2)


@dataclass(frozen=True)
class Lines:
    """L line segments in the terminal's frame that may appear as edges.

    Attributes:
        start: (L, 3) m.
        end: (L, 3) m.
        pixels: (L, 2, 2) px, both ends in the image.
        outward: (L, 2) unit normal in the image, away from the bar.
        bar: (L,) 0 at −y, 1 at +y.
        side: (L,) 0 at −y, 1 at +x, 2 at +y, 3 at −x of the bar.
        outer: (L,) the outermost line of its side: bright inside, dark outside.
        room: (L,) px to the next line of the same side, inf if there is none.
        bias: (L,) px, standard deviation of the shift of an entire edge.
    """

    start: Array
    end: Array
    pixels: Array
    outward: Array
    bar: NDArray[np.int64]
    side: NDArray[np.int64]
    outer: Mask
    room: Array
    bias: Array


def visible_lines(pose: TerminalPose, terminal: Terminal, intrinsics: Intrinsics, bias: float) -> Lines:
    """Return the lines of the touched faces, and of the roots of visible sides."""
    corners = terminal.corners()
    start, end = corners.reshape(8, 3), np.roll(corners, -1, axis=1).reshape(8, 3)
    camera = -pose.rotation.T @ pose.translation
    depth = np.array([0.0, 0.0, terminal.bar_thickness])
    middle = 0.5 * (start + end)
    seen = np.sum((camera - middle) * _OUTWARD[_SIDES], axis=1) > 0.0
    pixels = project(pose.points(np.stack([start, end], axis=1)), intrinsics)
    roots = project(pose.points(np.stack([start, end], axis=1) + depth), intrinsics)
    normal = _normals(pixels, pose, intrinsics, middle)
    width = np.where(seen, np.abs(np.sum((roots - pixels).mean(axis=1) * normal, axis=1)), 0.0)
    two = width >= _APART
    merged = (width > _FLAT) & ~two
    shift = np.where(merged, 0.5, 0.0)
    pixels = pixels + shift[:, None, None] * (roots - pixels)
    front = shift[:, None] * depth
    rows = np.flatnonzero(two)
    # The blur of one edge still affects the other.
    near = _DRAWN * np.maximum(1.0 - (width - _APART) / _APART, 0.0)
    return Lines(
        np.concatenate([start + front, start[rows] + depth]),
        np.concatenate([end + front, end[rows] + depth]),
        np.concatenate([pixels, roots[rows]]),
        np.concatenate([normal, normal[rows]]),
        np.concatenate([_BARS, _BARS[rows]]),
        np.concatenate([_SIDES, _SIDES[rows]]),
        np.concatenate([~two, np.ones(len(rows), dtype=bool)]),
        np.concatenate([np.where(two, width, np.inf), width[rows]]),
        np.hypot(bias, np.concatenate([np.where(two, 0.0, _MERGED * width), near[rows]])),
    )


def _normals(pixels: Array, pose: TerminalPose, intrinsics: Intrinsics, middle: Array) -> Array:
    """Return unit normals (L, 2) of segments (L, 2, 2) px, away from the bar."""
    along = pixels[:, 1] - pixels[:, 0]
    along = along / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    # Project the middle itself: with lens distortion, the middle of both ends is beside the line.
    at, beyond = project(pose.points(np.stack([middle, middle + 1e-4 * _OUTWARD[_SIDES]])), intrinsics)
    return np.where(np.sum((beyond - at) * normal, axis=1)[:, None] < 0.0, -normal, normal)
