# SPDX-License-Identifier: Apache-2.0
"""Lines of two bars that a camera can see as edges, and the subpixel places of these edges in an image.

A bar rises above its plate, so at a slant it shows a side beside its touched face. If that side is wide enough, its
root on the plate is a separate line. If it is too narrow for two lines, the edge lies somewhere between them and has
less weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.images import Intrinsics, project, rays
from deltacharger_vision.terminal import Terminal, TerminalPose

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


EDGE_SEARCH = 5.0  # px, first search distance on either side of a line's expected position
EDGE_FOLLOW = 2.5  # px, search distance once the pose has been refined
_CONTRAST = 1.0  # least step of light within a pixel, of 255
_SHARE = 0.3  # least step as a share of the median step

SAMPLES = 24
"""Places per line."""
_STEP = 0.5
_REACH = 3  # steps on either side of the steepest place that enter its centroid
_CORNER = 1.5  # px near a corner that another edge disturbs
_PULL = 0.3  # of the peak
_SATURATED = 250.0  # of 255
_SHARP = 2.5  # px: width of an edge's ramp (step over steepest slope) in a sharp image
_INDEPENDENT = 2.0  # px between samples of an edge that share little noise


@dataclass(frozen=True)
class EdgePoints:
    """Edge points of L lines, SAMPLES per line.

    Attributes:
        lines: the lines.
        model: (L, S, 3) m, in the terminal's frame.
        rays: (L, S, 2) x/z, y/z of the edge.
        seen: (L, S) whether the edge was found.
        inside: (L, S) whether the place is inside the image.
        weight: (L,) independent samples per sample.
        missed: independent samples of the bars' sides without an edge in the image.
        saturated: share of places where the bar beside the edge is saturated.
        blur: (L,) px, excess width of the line's ramp over a sharp image.
    """

    lines: Lines
    model: Array
    rays: Array
    seen: Mask
    inside: Mask
    weight: Array
    missed: float
    saturated: float
    blur: Array


def find_edges(grey: NDArray[Any], lines: Lines, intrinsics: Intrinsics, window: float) -> EdgePoints:
    """Return the steepest places within `window` px of each line in a grey image (H, W) float32."""
    import cv2

    length = np.hypot(*(lines.pixels[:, 1] - lines.pixels[:, 0]).T)
    trim = np.minimum(0.3, _CORNER / np.maximum(length, 1e-6))[:, None]
    place = trim + (1.0 - 2.0 * trim) * np.linspace(0.0, 1.0, SAMPLES)
    centre = lines.pixels[:, None, 0] + place[..., None] * (lines.pixels[:, None, 1] - lines.pixels[:, None, 0])
    model = lines.start[:, None] + place[..., None] * (lines.end[:, None] - lines.start[:, None])
    steps = round(window / _STEP)
    offsets: Array = np.asarray(_STEP * np.arange(-steps - 1, steps + 2), dtype=np.float64)
    sampled = centre[:, :, None] + offsets[:, None] * lines.outward[:, None, None]
    flat = sampled.reshape(len(centre), -1, 2).astype(np.float32)
    profile = cv2.remap(grey, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(profile, dtype=float).reshape(sampled.shape[:3])
    change = (values[..., :-2] - values[..., 2:]) / (2.0 * _STEP)
    fall = np.where(lines.outer[:, None, None], np.maximum(change, 0.0), np.abs(change))
    offsets = offsets[1:-1]
    # A side's two lines are each searched on their own side of the middle between them.
    beyond = np.where(lines.outer[:, None], -offsets, offsets)
    offset, height, ramp = _steepest(fall, offsets, beyond <= 0.5 * lines.room[:, None])
    enough = max(_CONTRAST, _SHARE * float(np.median(height[lines.outer])))
    bounds = np.array(grey.shape[::-1], dtype=float) - 1.0
    inside = np.all((centre > 0.0) & (centre < bounds), axis=2)
    found = rays(np.clip(centre + offset[..., None] * lines.outward[:, None], 0.0, bounds), intrinsics)
    weight = np.minimum(1.0, length / (_INDEPENDENT * SAMPLES))
    seen = inside & (height >= enough)
    missed = _leave_inner(seen, inside, weight, lines)
    blur = np.maximum(np.median(np.where(seen, ramp, 0.0), axis=1) - _SHARP, 0.0)
    # Sampled well inside the bar.
    saturated = float(np.mean(values[lines.outer, :, : steps // 2].max(axis=2) >= _SATURATED))
    return EdgePoints(lines, model, found, seen, inside, weight, missed, saturated, blur)


def _leave_inner(seen: Mask, inside: Mask, weight: Array, lines: Lines) -> float:
    """Drop inner edges whose outer edge was found, because streaks and blur pass for inner edges.

    Returns:
        Independent samples of the sides without either edge.
    """
    missed = 0.0
    for outer in np.flatnonzero(lines.outer):
        found = seen[outer]
        inner = np.flatnonzero((lines.bar == lines.bar[outer]) & (lines.side == lines.side[outer]) & ~lines.outer)
        if len(inner) and np.mean(found) > 0.5:
            seen[inner] = False
        elif len(inner):
            found = found | seen[inner[0]]
        missed += float(weight[outer] * np.count_nonzero(inside[outer] & ~found))
    return missed


def _steepest(fall: Array, offsets: Array, allowed: Mask) -> tuple[Array, Array, Array]:
    """Return the offset (L, S) px of the steepest place of profiles (L, S, K), its slope, and the ramp's width.

    Only allowed offsets (L, K) count. The slope is 0 if the steepest place is not a peak of the profile. The width is
    that of a straight ramp of the same height and slope, px.
    """
    near = fall * allowed[:, None]
    peak = np.argmax(near, axis=2)[..., None]
    last = fall.shape[2] - 1
    height = np.take_along_axis(near, peak, axis=2)[..., 0]
    inner = ((peak >= 2) & (peak <= last - 2))[..., 0]
    for step in (-1, 1):
        inner &= np.take_along_axis(fall, np.clip(peak + step, 0, last), axis=2)[..., 0] <= height
    reach = np.clip(peak + np.arange(-_REACH, _REACH + 1), 0, last)
    # Only the excess over part of the peak counts, so that a neighbouring edge does not pull.
    strong = np.maximum(np.take_along_axis(near, reach, axis=2) - _PULL * height[..., None], 0.0)
    offset = np.sum(strong * offsets[reach], axis=2) / np.maximum(strong.sum(axis=2), 1e-9)
    ramp = _STEP * near.sum(axis=2) / np.maximum(height, 1e-9)
    return offset, np.where(inner, height, 0.0), ramp
