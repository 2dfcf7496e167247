# SPDX-License-Identifier: Apache-2.0
"""Which charger bar touches which target bar, exactly: rectangles, not the formula that docking decides by."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_sim.parameters import TerminalParameters

Polygon = list[tuple[float, float]]


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
    # From one bar's centre to the wrong one's; the target's bars lie along its own turned y.
    pitch = 0.5 * (terminal.gap + terminal.height)
    across_x, across_y = sine * pitch, -pitch - cosine * pitch
    down = _separation(terminal, x + across_x, y + across_y, cosine, sine)
    up = _separation(terminal, x - across_x, y - across_y, cosine, sine)
    # The same from one bar's centre to that of its mate: upper from upper, lower from lower.
    aside_x, aside_y = -sine * pitch, cosine * pitch - pitch
    matched = _common(terminal, x + aside_x, y + aside_y, cosine, sine)
    matched += _common(terminal, x - aside_x, y - aside_y, cosine, sine)
    short = matched > 0.0 and (
        (down < 0.0 and _common(terminal, x + across_x, y + across_y, cosine, sine) > 0.0)
        or (up < 0.0 and _common(terminal, x - across_x, y - across_y, cosine, sine) > 0.0)
    )
    return Overlap(matched, matched / (2.0 * terminal.length * terminal.height), min(down, up), short)


def _common(terminal: TerminalParameters, x: float, y: float, cosine: float, sine: float) -> float:
    """Return the common area (m²) of two bars, the second's centre at (x, y) m from the first's, turned.

    The second is cut at the first's four sides (Sutherland–Hodgman).
    """
    if sine == 0.0 and cosine > 0.0:
        return max(terminal.length - abs(x), 0.0) * max(terminal.height - abs(y), 0.0)
    half_x, half_y = 0.5 * terminal.length, 0.5 * terminal.height
    along_x, along_y, across_x, across_y = half_x * cosine, half_x * sine, -half_y * sine, half_y * cosine
    polygon = [
        (x - along_x - across_x, y - along_y - across_y),
        (x + along_x - across_x, y + along_y - across_y),
        (x + along_x + across_x, y + along_y + across_y),
        (x - along_x + across_x, y - along_y + across_y),
    ]
    for axis, sign, most in ((0, 1.0, half_x), (0, -1.0, half_x), (1, 1.0, half_y), (1, -1.0, half_y)):
        inside = [most - sign * point[axis] for point in polygon]
        if min(inside) >= 0.0:
            continue
        if max(inside) <= 0.0:
            return 0.0
        polygon = _cut(polygon, inside)
    (before_x, before_y), total = polygon[-1], 0.0
    for corner_x, corner_y in polygon:
        total += before_x * corner_y - before_y * corner_x
        before_x, before_y = corner_x, corner_y
    return max(0.5 * total, 0.0)


def _cut(polygon: Polygon, inside: list[float]) -> Polygon:
    """Return the part of a convex polygon whose distances inside of a line (m) are not negative."""
    kept = []
    (before_x, before_y), before = polygon[-1], inside[-1]
    for (corner_x, corner_y), here in zip(polygon, inside, strict=True):
        if (here >= 0.0) != (before >= 0.0):
            share = before / (before - here)
            kept.append((before_x + share * (corner_x - before_x), before_y + share * (corner_y - before_y)))
        if here >= 0.0:
            kept.append((corner_x, corner_y))
        before_x, before_y, before = corner_x, corner_y, here
    return kept


def _separation(terminal: TerminalParameters, x: float, y: float, cosine: float, sine: float) -> float:
    """Return the largest gap (m) along an edge normal of two bars, the second's centre at (x, y) m, turned; < 0
    overlap."""
    half_x, half_y = 0.5 * terminal.length, 0.5 * terminal.height
    wide = half_x + half_x * abs(cosine) + half_y * abs(sine)
    high = half_y + half_x * abs(sine) + half_y * abs(cosine)
    along, across = cosine * x + sine * y, cosine * y - sine * x
    return max(abs(x) - wide, abs(y) - high, abs(along) - wide, abs(across) - high)
