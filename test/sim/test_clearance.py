# SPDX-License-Identifier: Apache-2.0
"""The exact geometry of the bars, compared with brute force and with docking's clearance formula."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from deltacharger_core.machine import BAR_GAP, BAR_HEIGHT, BAR_LENGTH
from deltacharger_docking import clearance
from deltacharger_sim.circuit import Overlap

FULL = 2.0 * BAR_LENGTH * BAR_HEIGHT
HALF_GAP, HALF_LENGTH = 0.5 * BAR_GAP, 0.5 * BAR_LENGTH
PITCH = 2e-4

shift = st.floats(-0.02, 0.02)
angle = st.floats(-0.5, 0.5)


def formula(angle: float, y: float) -> float:
    return clearance.clearance(angle, y, HALF_GAP, HALF_LENGTH)


def in_bar(x: np.ndarray, y: np.ndarray, side: int) -> np.ndarray:
    return (np.abs(x) <= HALF_LENGTH) & (side * y >= HALF_GAP) & (side * y <= HALF_GAP + BAR_HEIGHT)


def sampled(x: float, y: float, angle: float) -> np.ndarray:
    """Overlap areas (m²) [our bar, their bar] by counting grid points on our terminal."""
    half_x, half_y = HALF_LENGTH, HALF_GAP + BAR_HEIGHT
    px, py = np.meshgrid(
        np.arange(-half_x + PITCH / 2, half_x, PITCH), np.arange(-half_y + PITCH / 2, half_y, PITCH), indexing="ij"
    )
    cosine, sine = math.cos(angle), math.sin(angle)
    qx, qy = cosine * (px - x) + sine * (py - y), -sine * (px - x) + cosine * (py - y)
    ours = [in_bar(px, py, side) for side in (1, -1)]
    theirs = [in_bar(qx, qy, side) for side in (1, -1)]
    return np.array([[np.count_nonzero(a & b) for b in theirs] for a in ours]) * PITCH**2


@settings(max_examples=40)
@given(shift, shift, angle)
def test_area_and_shorts_agree_with_brute_force(x: float, y: float, angle: float) -> None:
    lies, counted = Overlap(x, y, angle), sampled(x, y, angle)
    row = BAR_LENGTH * PITCH  # the grid's error is up to a row of points along each bar
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
        assert lies.clearance < 0.0 < lies.area


@settings(max_examples=80)
@given(shift, shift, angle)
def test_the_decision_formula_never_overestimates_clearance(x: float, y: float, angle: float) -> None:
    assert Overlap(x, y, angle).clearance >= formula(angle, y) - 1e-12
