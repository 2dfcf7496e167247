# SPDX-License-Identifier: Apache-2.0
"""Whether edges and depth support a pose; unsupported poses are not reported."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_vision.detector.edges import EdgePoints
from deltacharger_vision.detector.refine import PoseFit
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.poses import TerminalPose
from deltacharger_vision.projection import project
from deltacharger_vision.terminal import Terminal

_SEEN = 0.55  # least visible share of both outlines
SEEN_UNCHECKED = 0.8  # least visible share of both outlines if no depth checks the pose
_WHOLE = 0.75  # least visible share of the clearer bar's outline
SIDE_SEEN = 0.15  # least visible share of each long side of the other bar
SIDES_SEEN = 0.4  # least visible share of all long sides of partly hidden bars
END_SEEN = 0.5  # least visible share of each end of the clearer bar
LARGEST_SCATTER = 1.0  # px, largest scatter of the edge points
LIGHT_AROUND = 0.45  # largest light above and below the bars, relative to theirs
DEPTH_RISE = 30.0  # largest rise of the squared error when depth is added

_LONG, _ENDS = (0, 2), (1, 3)


def outline_shares(points: EdgePoints, fit: PoseFit, outer: bool = False) -> Array:
    """Return the visible share (2, 4) of each side of each bar; 0 outside the image.

    Args:
        points: the edge points.
        fit: the pose.
        outer: count only the outermost line of each side.
    """
    shares = np.zeros((2, 4))
    lines = points.lines
    for index in np.flatnonzero(lines.outer) if outer else range(len(lines.bar)):
        share = float(np.mean(fit.used[index]))
        # Either line of a side suffices.
        bar, side = lines.bar[index], lines.side[index]
        shares[bar, side] = max(shares[bar, side], share)
    return shares


def plate_is_dark(
    grey: NDArray[Any], pose: TerminalPose, terminal: Terminal, intrinsics: Intrinsics, share: float
) -> tuple[float, bool]:
    """Return `share` of the bars' light (H, W), and whether the image is darker where a third bar would be."""
    places = np.linspace(-0.4, 0.4, 9) * terminal.bar_length
    rows = np.array([-1.5, -0.5, 0.5, 1.5]) * terminal.spacing
    points = np.stack(np.broadcast_arrays(places, rows[:, None], 0.0), axis=-1)
    points[[0, 3], :, 2] = terminal.bar_thickness
    pixels = np.round(project(pose.points(points), intrinsics)).astype(int)
    height, width = grey.shape
    inside = np.all((pixels >= 0) & (pixels < [width, height]), axis=-1)
    pixels = np.clip(pixels, 0, [width - 1, height - 1])
    light = np.where(inside, grey[pixels[..., 1], pixels[..., 0]].astype(float), np.nan)
    bars = light[1:3][inside[1:3]]
    if not len(bars):
        return math.inf, False
    limit = share * float(np.median(bars))
    return limit, all(not inside[row].any() or float(np.nanmedian(light[row])) < limit for row in (0, 3))


def supported(shares: Array, fit: PoseFit) -> float:
    """Return the visible share (0 to 1) of the outlines, or 0 if that is too little for a pose."""
    long_sides, ends = shares[:, _LONG], shares[:, _ENDS]
    bars = 0.7 * long_sides.mean(axis=1) + 0.3 * ends.mean(axis=1)
    clear = int(np.argmax(bars))
    overall = float(bars.mean())
    enough = (
        overall >= _SEEN
        and bars[clear] >= _WHOLE
        and long_sides[1 - clear].min() >= SIDE_SEEN
        and ends[clear].min() >= END_SEEN
        and fit.scatter <= LARGEST_SCATTER
    )
    return overall if enough else 0.0
