# SPDX-License-Identifier: Apache-2.0
"""Exact contact of charger bars with target bars, as rectangles; independent of docking's clearance formula."""

from __future__ import annotations

import math
from functools import cached_property

from deltacharger_sim.parameters import TerminalParameters

Polygon = list[tuple[float, float]]


class Overlap:
    """Overlap of two terminals; attributes are computed when first used.

    Args:
        terminal: size of the bars, equal on both sides.
        x: position of the target in end_effector, m.
        y: along y, m.
        angle: of the target, rad.
    """

    def __init__(self, terminal: TerminalParameters, x: float, y: float, angle: float) -> None:
        self._terminal, self._cosine, self._sine = terminal, math.cos(angle), math.sin(angle)
        # From one bar's centre to the wrong bar's; the target's bars are offset along its own turned y.
        pitch = 0.5 * (terminal.gap + terminal.height)
        across_x, across_y = self._sine * pitch, -pitch - self._cosine * pitch
        self._down, self._up = (x + across_x, y + across_y), (x - across_x, y - across_y)
        # From one bar's centre to its mate's: upper to upper, lower to lower.
        aside_x, aside_y = -self._sine * pitch, self._cosine * pitch - pitch
        self._mates = (x + aside_x, y + aside_y), (x - aside_x, y - aside_y)

    @cached_property
    def area(self) -> float:
        """Overlap of the matching pairs (upper on upper, lower on lower), m²."""
        return sum(self._common(mate) for mate in self._mates)

    @property
    def fraction(self) -> float:
        """The overlap relative to full overlap."""
        return self.area / (2.0 * self._terminal.length * self._terminal.height)

    @cached_property
    def clearance(self) -> float:
        """Distance (m) of the nearest mismatched pair; negative = depth of overlap."""
        return min(self._separation(self._down), self._separation(self._up))

    @cached_property
    def short(self) -> bool:
        """Whether a bar of one terminal touches both bars of the other."""
        wrong = (self._down, self._up)
        return self.clearance < 0.0 < self.area and any(self._common(other) > 0.0 for other in wrong)

    def _common(self, place: tuple[float, float]) -> float:
        return _common(self._terminal, *place, self._cosine, self._sine)

    def _separation(self, place: tuple[float, float]) -> float:
        return _separation(self._terminal, *place, self._cosine, self._sine)


def _common(terminal: TerminalParameters, x: float, y: float, cosine: float, sine: float) -> float:
    """Return the common area (m²) of two bars, the second's centre at (x, y) m from the first's, turned.

    The second is clipped at the first's four sides (Sutherland–Hodgman).
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
    """Return the part of a convex polygon with non-negative distances (m) to the inside of a line."""
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
