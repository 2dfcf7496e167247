# SPDX-License-Identifier: Apache-2.0
"""Subpixel edges: where along each line's normal the image changes most, found at many places of every line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_core.parameters import Bounded, number
from deltacharger_vision.detector.outlines import Lines
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.projection import rays

SAMPLES = 24
"""Places per line."""
_STEP = 0.5
_REACH = 3  # steps on either side of the steepest place that its centroid takes in
_CORNER = 1.5  # px near a corner in which another edge disturbs
_PULL = 0.3  # of the peak
_SATURATED = 250.0  # of 255
_SHARP = 2.5  # px: ramp of an edge, as wide as its step over its steepest slope, that a sharp image has
_INDEPENDENT = 2.0  # px between samples of an edge that share little noise


@dataclass(frozen=True)
class EdgeSettings(Bounded):
    """How edges are searched.

    Raises:
        ParameterError: a value is out of bounds.
    """

    search: float = number(5.0, 1.0, 50.0, "px", "on either side of where a line is expected at first")
    follow: float = number(2.5, 1.0, 50.0, "px", "the same once the pose has been refined")
    contrast: float = number(1.0, 0.01, 100.0, "", "least step of light within a pixel, of 255")
    share: float = number(0.3, 0.0, 1.0, "", "the same as a share of the median step")


@dataclass(frozen=True)
class EdgePoints:
    """Places of L lines with SAMPLES each.

    Attributes:
        lines: the lines.
        model: (L, S, 3) m, in the terminal's frame.
        rays: (L, S, 2) x/z, y/z of where the edge was seen.
        seen: (L, S) whether it was.
        inside: (L, S) whether the image shows the place at all.
        weight: (L,) independent samples per sample.
        missed: independent samples of the bars' sides at which the image shows no edge.
        saturated: share of the places beside which the bar is as bright as the image can tell.
        blur: (L,) px by which the ramp of a line is wider than in a sharp image.
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


def find_edges(
    grey: NDArray[Any], lines: Lines, intrinsics: Intrinsics, window: float, settings: EdgeSettings
) -> EdgePoints:
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
    # Of a side's two lines each is looked for on its own side of the middle between them.
    beyond = np.where(lines.outer[:, None], -offsets, offsets)
    offset, height, ramp = _steepest(fall, offsets, beyond <= 0.5 * lines.room[:, None])
    enough = max(settings.contrast, settings.share * float(np.median(height[lines.outer])))
    bounds = np.array(grey.shape[::-1], dtype=float) - 1.0
    inside = np.all((centre > 0.0) & (centre < bounds), axis=2)
    found = rays(np.clip(centre + offset[..., None] * lines.outward[:, None], 0.0, bounds), intrinsics)
    weight = np.minimum(1.0, length / (_INDEPENDENT * SAMPLES))
    seen = inside & (height >= enough)
    missed = _leave_inner(seen, inside, weight, lines)
    blur = np.maximum(np.median(np.where(seen, ramp, 0.0), axis=1) - _SHARP, 0.0)
    # An edge sampled well inside the bar.
    saturated = float(np.mean(values[lines.outer, :, : steps // 2].max(axis=2) >= _SATURATED))
    return EdgePoints(lines, model, found, seen, inside, weight, missed, saturated, blur)


def _leave_inner(seen: Mask, inside: Mask, weight: Array, lines: Lines) -> float:
    """Drop inner edges whose outer one was seen, as streaks and blur would be taken for them.

    Returns:
        Independent samples of the sides at which neither was seen.
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
    """Return the offset (L, S) px of the steepest place of profiles (L, S, K), how steep it is, and the ramp's width.

    Only offsets (L, K) that are allowed count. The slope is 0 where the steepest place is not a peak of the profile.
    The width is that of a straight ramp as high and as steep, px.
    """
    near = fall * allowed[:, None]
    peak = np.argmax(near, axis=2)[..., None]
    last = fall.shape[2] - 1
    height = np.take_along_axis(near, peak, axis=2)[..., 0]
    inner = ((peak >= 2) & (peak <= last - 2))[..., 0]
    for step in (-1, 1):
        inner &= np.take_along_axis(fall, np.clip(peak + step, 0, last), axis=2)[..., 0] <= height
    reach = np.clip(peak + np.arange(-_REACH, _REACH + 1), 0, last)
    # Only what exceeds part of the peak counts: the neighbour's edge does not pull.
    strong = np.maximum(np.take_along_axis(near, reach, axis=2) - _PULL * height[..., None], 0.0)
    offset = np.sum(strong * offsets[reach], axis=2) / np.maximum(strong.sum(axis=2), 1e-9)
    ramp = _STEP * near.sum(axis=2) / np.maximum(height, 1e-9)
    return offset, np.where(inner, height, 0.0), ramp
