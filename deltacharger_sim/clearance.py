# SPDX-License-Identifier: Apache-2.0
"""Which charger bar touches which target bar, exactly: rectangles, not the formula that docking decides by."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_sim.parameters import TerminalParameters

Point = tuple[float, float]
Polygon = list[Point]


@dataclass(frozen=True)
class Overlap:
    """How two terminals lie on each other.

    Attributes:
        area: overlap of the right pairs (upper on upper, lower on lower), m².
        fraction: the same relative to full overlap.
        clearance: distance (m) of the nearest wrong pair; negative = how deep they overlap.
        short: whether a bar of one terminal touches both bars of the other.
    """

    area: float
    fraction: float
    clearance: float
    short: bool


def overlap(terminal: TerminalParameters, x: float, y: float, angle: float) -> Overlap:
    """Return how the bars lie for a target at (x, y) m, turned by `angle` rad, in end_effector."""
    cosine, sine = math.cos(angle), math.sin(angle)
    ours = [_bar(terminal, side) for side in (1.0, -1.0)]
    theirs = [
        [(x + cosine * u - sine * v, y + sine * u + cosine * v) for u, v in _bar(terminal, side)]
        for side in (1.0, -1.0)
    ]
    # From one bar's centre to the wrong one's; the target's bars lie along its own turned y.
    pitch = 0.5 * (terminal.gap + terminal.height)
    across_x, across_y = sine * pitch, -pitch - cosine * pitch
    down = _separation(terminal, x + across_x, y + across_y, cosine, sine)
    up = _separation(terminal, x - across_x, y - across_y, cosine, sine)
    areas = [_area(_clip(ours[0], theirs[0])), _area(_clip(ours[1], theirs[1]))]
    crossed = [
        down < 0.0 and _area(_clip(ours[0], theirs[1])) > 0.0,
        up < 0.0 and _area(_clip(ours[1], theirs[0])) > 0.0,
    ]
    short = (crossed[0] or crossed[1]) and (areas[0] > 0.0 or areas[1] > 0.0)
    matched = areas[0] + areas[1]
    return Overlap(matched, matched / (2.0 * terminal.length * terminal.height), min(down, up), short)


def _bar(terminal: TerminalParameters, side: float) -> Polygon:
    """Return the corners of the upper (side +1) or lower (−1) bar, counter-clockwise."""
    half = 0.5 * terminal.length
    centre = side * 0.5 * (terminal.gap + terminal.height)
    low, high = centre - 0.5 * terminal.height, centre + 0.5 * terminal.height
    return [(-half, low), (half, low), (half, high), (-half, high)]


def _clip(subject: Polygon, window: Polygon) -> Polygon:
    """Return the part of `subject` inside the convex, counter-clockwise `window` (Sutherland–Hodgman)."""
    result = subject
    for (ax, ay), (bx, by) in zip(window, window[1:] + window[:1], strict=True):
        edge_x, edge_y = bx - ax, by - ay
        corners, result = result, []
        sides = [edge_x * (py - ay) - edge_y * (px - ax) for px, py in corners]
        for index, (point, side) in enumerate(zip(corners, sides, strict=True)):
            previous, before = corners[index - 1], sides[index - 1]
            if (side >= 0.0) != (before >= 0.0):
                share = before / (before - side)
                result.append(
                    (previous[0] + share * (point[0] - previous[0]), previous[1] + share * (point[1] - previous[1]))
                )
            if side >= 0.0:
                result.append(point)
        if not result:
            break
    return result


def _area(polygon: Polygon) -> float:
    total = 0.0
    for (ax, ay), (bx, by) in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        total += ax * by - bx * ay
    return max(0.5 * total, 0.0)


def _separation(terminal: TerminalParameters, x: float, y: float, cosine: float, sine: float) -> float:
    """Return the largest gap (m) along an edge normal of two bars, the second's centre at (x, y) m, turned; < 0
    overlap."""
    half_x, half_y = 0.5 * terminal.length, 0.5 * terminal.height
    wide = half_x + half_x * abs(cosine) + half_y * abs(sine)
    high = half_y + half_x * abs(sine) + half_y * abs(cosine)
    along, across = cosine * x + sine * y, cosine * y - sine * x
    return max(abs(x) - wide, abs(y) - high, abs(along) - wide, abs(across) - high)
