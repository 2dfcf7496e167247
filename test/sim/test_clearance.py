"""How the bars lie on each other: against brute force, and against the published critical angle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deltacharger_sim.clearance import overlap
from deltacharger_sim.parameters import TerminalParameters

TERMINAL = TerminalParameters()


def inside(points: np.ndarray, side: float) -> np.ndarray:
    """Whether (n, 2) points lie in the upper (+1) or lower (−1) bar of a terminal at the origin."""
    centre = side * 0.5 * (TERMINAL.gap + TERMINAL.height)
    along, across = np.abs(points[:, 0]), np.abs(points[:, 1] - centre)
    return (along <= 0.5 * TERMINAL.length) & (across <= 0.5 * TERMINAL.height)


def sampled(x: float, y: float, angle: float) -> tuple[float, bool]:
    """Matched overlap (m²) and short, from a grid of 0.1 mm."""
    axis = np.arange(-0.045, 0.045, 1e-4) + 5e-5
    grid = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    cosine, sine = math.cos(angle), math.sin(angle)
    local = (grid - (x, y)) @ np.array([[cosine, -sine], [sine, cosine]])
    touch = [[bool((inside(grid, i) & inside(local, j)).any()) for j in (1, -1)] for i in (1, -1)]
    matched = sum((inside(grid, i) & inside(local, i)).sum() for i in (1, -1)) * 1e-8
    short = all(touch[0]) or all(touch[1]) or (touch[0][0] and touch[1][0]) or (touch[0][1] and touch[1][1])
    return matched, short


@pytest.mark.parametrize("seed", range(12))
def test_overlap_and_shorts_agree_with_brute_force(seed: int) -> None:
    random = np.random.default_rng(seed)
    x, y, angle = random.uniform((-0.02, -0.012, -0.4), (0.02, 0.012, 0.4))
    lies = overlap(TERMINAL, x, y, angle)
    area, short = sampled(x, y, angle)
    assert lies.area == pytest.approx(area, abs=8e-6)
    if abs(lies.clearance) > 3e-4:
        assert lies.short == short
        assert lies.short == (lies.clearance < 0.0)


def test_clearance_vanishes_at_the_published_critical_angle() -> None:
    below, above = (overlap(TERMINAL, 0.0, 0.0, math.radians(value)) for value in (12.0, 12.15))
    assert below.clearance > 0.0 > above.clearance
    assert above.short
    assert not below.short


@pytest.mark.parametrize("angle", np.radians([0.0, 3.0, -7.0, 11.0]))
@pytest.mark.parametrize("y", [0.0, 0.002, -0.004])
def test_clearance_is_the_formula_that_docking_decides_by(angle: float, y: float) -> None:
    expected = 0.0037 * (1 + math.cos(angle)) - 0.035 * abs(math.sin(angle)) - abs(y)
    found = overlap(TERMINAL, 0.0, y, angle).clearance
    if expected > -0.001:
        assert found == pytest.approx(expected, abs=7e-5)
    else:
        assert found < 0.0


def test_aligned_bars_overlap_fully_and_are_a_gap_apart() -> None:
    lies = overlap(TERMINAL, 0.0, 0.0, 0.0)
    assert lies.fraction == pytest.approx(1.0)
    assert lies.clearance == pytest.approx(TERMINAL.gap)
