# SPDX-License-Identifier: Apache-2.0
"""The exact geometry of the bars, compared with brute force and with docking's clearance formula."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltacharger_sim.clearance import Overlap
from deltacharger_sim.parameters import TerminalParameters

TERMINAL = TerminalParameters()
FULL = 2.0 * TERMINAL.length * TERMINAL.height
HALF_GAP, HALF_LENGTH = 0.5 * TERMINAL.gap, 0.5 * TERMINAL.length
PITCH = 1e-4

shift = st.floats(-0.02, 0.02)
angle = st.floats(-0.5, 0.5)


def formula(angle: float, y: float) -> float:
    return HALF_GAP * (1.0 + math.cos(angle)) - HALF_LENGTH * abs(math.sin(angle)) - abs(y)


def in_bar(x: np.ndarray, y: np.ndarray, side: int) -> np.ndarray:
    return (np.abs(x) <= HALF_LENGTH) & (side * y >= HALF_GAP) & (side * y <= HALF_GAP + TERMINAL.height)


def sampled(x: float, y: float, angle: float) -> np.ndarray:
    """Overlap areas (m²) [our bar, their bar] by counting grid points on our terminal."""
    half_x, half_y = HALF_LENGTH, HALF_GAP + TERMINAL.height
    px, py = np.meshgrid(
        np.arange(-half_x + PITCH / 2, half_x, PITCH), np.arange(-half_y + PITCH / 2, half_y, PITCH), indexing="ij"
    )
    cosine, sine = math.cos(angle), math.sin(angle)
    qx, qy = cosine * (px - x) + sine * (py - y), -sine * (px - x) + cosine * (py - y)
    ours = [in_bar(px, py, side) for side in (1, -1)]
    theirs = [in_bar(qx, qy, side) for side in (1, -1)]
    return np.array([[np.count_nonzero(a & b) for b in theirs] for a in ours]) * PITCH**2


@settings(max_examples=60, deadline=None)
@given(shift, shift, angle)
def test_area_and_shorts_agree_with_brute_force(x: float, y: float, angle: float) -> None:
    lies, counted = Overlap(TERMINAL, x, y, angle), sampled(x, y, angle)
    row = TERMINAL.length * PITCH  # the grid's error is up to a row of points along each bar
    assert lies.area == pytest.approx(counted[0, 0] + counted[1, 1], abs=2.0 * row)
    assert lies.fraction == pytest.approx(lies.area / FULL)
    wrong = counted[0, 1] + counted[1, 0]
    if wrong > row:
        assert lies.clearance < 0.0
    if wrong == 0.0:
        assert lies.clearance > -2.0 * PITCH
    touched = counted > row
    if touched.all(axis=1).any() or touched.all(axis=0).any():
        assert lies.short
    if lies.short:
        assert lies.clearance < 0.0


@settings(max_examples=200, deadline=None)
@given(shift, shift, angle)
def test_the_decision_formula_never_overestimates_clearance(x: float, y: float, angle: float) -> None:
    assert Overlap(TERMINAL, x, y, angle).clearance >= formula(angle, y) - 1e-12


@pytest.mark.parametrize("degrees", [0.0, 2.0, 5.0, -8.0, 11.9, 12.2, -16.0, 20.0])
def test_without_a_vertical_error_formula_and_geometry_agree(degrees: float) -> None:
    turn = math.radians(degrees)
    assert Overlap(TERMINAL, 0.0, 0.0, turn).clearance == pytest.approx(formula(turn, 0.0), abs=1e-9)


@pytest.mark.parametrize("y_mm", [-6.0, -2.5, 1.0, 5.0])
@pytest.mark.parametrize("degrees", [0.0, 3.0, -7.0, 10.0])
def test_with_a_vertical_error_they_differ_by_the_cosine_only(y_mm: float, degrees: float) -> None:
    turn, y = math.radians(degrees), 1e-3 * y_mm
    difference = Overlap(TERMINAL, 0.0, y, turn).clearance - formula(turn, y)
    assert -1e-12 <= difference <= abs(y) * (1.0 - math.cos(turn)) + 1e-9


@pytest.mark.parametrize(
    ("degrees", "short"), [(12.0, False), (12.06, False), (12.08, True), (-12.06, False), (-12.08, True)]
)
def test_the_critical_angle_is_12_07_degrees_when_centred(degrees: float, short: bool) -> None:
    lies = Overlap(TERMINAL, 0.0, 0.0, math.radians(degrees))
    assert lies.short is short
    assert (lies.clearance < 0.0) is short


@pytest.mark.parametrize(("y_mm", "critical"), [(2.5, 8.0), (5.0, 3.9)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_vertical_error_lowers_the_critical_angle(y_mm: float, critical: float, side: float) -> None:
    assert Overlap(TERMINAL, 0.0, side * 1e-3 * y_mm, math.radians(critical - 0.3)).clearance > 0.0
    assert Overlap(TERMINAL, 0.0, side * 1e-3 * y_mm, math.radians(critical + 0.3)).short


def test_aligned_terminals_have_full_overlap() -> None:
    lies = Overlap(TERMINAL, 0.0, 0.0, 0.0)
    assert lies.fraction == pytest.approx(1.0)
    assert lies.clearance == pytest.approx(TERMINAL.gap)
    assert not lies.short


def test_an_offset_of_half_a_bar_halves_the_area() -> None:
    assert Overlap(TERMINAL, HALF_LENGTH, 0.0, 0.0).fraction == pytest.approx(0.5)


def test_terminals_beside_each_other_do_not_touch() -> None:
    lies = Overlap(TERMINAL, 0.2, 0.0, 0.1)
    assert lies.area == 0.0
    assert not lies.short


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_offset_of_one_bar_connects_wrong_poles_without_a_short(side: float) -> None:
    lies = Overlap(TERMINAL, 0.0, side * (TERMINAL.gap + TERMINAL.height), 0.0)
    assert lies.clearance < -0.009
    assert lies.area == 0.0
    assert not lies.short  # each bar touches one bar of the other side, the wrong one
