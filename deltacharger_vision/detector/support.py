# SPDX-License-Identifier: Apache-2.0
"""Whether edges and depth support a pose; unsupported poses are not reported."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.parameters import Bounded, number
from deltacharger_vision.detector.edges import EdgePoints
from deltacharger_vision.detector.refine import PoseFit
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.poses import TerminalPose
from deltacharger_vision.projection import project
from deltacharger_vision.terminal import Terminal

_LONG, _ENDS = (0, 2), (1, 3)


@dataclass(frozen=True)
class SupportSettings(Bounded):
    """Requirements of a detection.

    Raises:
        ParameterError: a value is out of bounds.
    """

    seen: float = number(0.55, 0.2, 1.0, "", "least visible share of both outlines")
    unchecked: float = number(0.8, 0.0, 1.0, "", "least visible share of both outlines if no depth checks the pose")
    whole: float = number(0.75, 0.3, 1.0, "", "least visible share of the clearer bar's outline")
    part: float = number(0.15, 0.05, 1.0, "", "least visible share of each long side of the other bar")
    parts: float = number(0.4, 0.05, 1.0, "", "least visible share of all long sides of partly hidden bars")
    end: float = number(0.5, 0.1, 1.0, "", "least visible share of each end of the clearer bar")
    scatter: float = number(1.0, 0.05, 5.0, "px", "largest scatter of the edge points")
    around: float = number(0.45, 0.0, 1.0, "", "largest light above and below the bars, relative to theirs")
    disagreement: float = number(30.0, 1.0, 1000.0, "", "largest rise of the squared error when depth is added")


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


def supported(shares: Array, fit: PoseFit, settings: SupportSettings) -> float:
    """Return the visible share (0 to 1) of the outlines, or 0 if that is too little for a pose."""
    long_sides, ends = shares[:, _LONG], shares[:, _ENDS]
    bars = 0.7 * long_sides.mean(axis=1) + 0.3 * ends.mean(axis=1)
    clear = int(np.argmax(bars))
    overall = float(bars.mean())
    enough = (
        overall >= settings.seen
        and bars[clear] >= settings.whole
        and long_sides[1 - clear].min() >= settings.part
        and ends[clear].min() >= settings.end
        and fit.scatter <= settings.scatter
    )
    return overall if enough else 0.0
