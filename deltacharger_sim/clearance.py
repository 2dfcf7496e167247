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
    ours = [_bar(terminal, side) for side in (1.0, -1.0)]
    cosine, sine = math.cos(angle), math.sin(angle)
    theirs = [
        [(x + cosine * u - sine * v, y + sine * u + cosine * v) for u, v in _bar(terminal, side)]
        for side in (1.0, -1.0)
    ]
    areas = [[_area(_clip(ours[i], theirs[j])) for j in (0, 1)] for i in (0, 1)]
    clearance = min(_separation(ours[0], theirs[1]), _separation(ours[1], theirs[0]))
    touch = [[areas[i][j] > 0.0 for j in (0, 1)] for i in (0, 1)]
    short = any(all(touch[i]) for i in (0, 1)) or any(touch[0][j] and touch[1][j] for j in (0, 1))
    matched = areas[0][0] + areas[1][1]
    return Overlap(matched, matched / (2.0 * terminal.length * terminal.height), clearance, short)


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


def _separation(first: Polygon, second: Polygon) -> float:
    """Return the largest gap between the two along an edge normal; negative where they overlap."""
    widest = -math.inf
    for one, other in ((first, second), (second, first)):
        for (ax, ay), (bx, by) in zip(one, one[1:] + one[:1], strict=True):
            length = math.hypot(bx - ax, by - ay)
            nx, ny = (by - ay) / length, -(bx - ax) / length
            gap = min(nx * (px - ax) + ny * (py - ay) for px, py in other)
            widest = max(widest, gap)
    return widest
