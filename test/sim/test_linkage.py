# SPDX-License-Identifier: Apache-2.0
"""The linkage agrees with the kinematics and its derivatives."""

from __future__ import annotations

import math
import random

import pytest

from deltacharger_kinematics.geometry import DeltaGeometry, LimbAdjustment, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.linkage import Linkage

ADJUSTED = DeltaGeometry(
    limbs=(
        LimbAdjustment(radius_offset=5e-4, angle_offset=0.02),
        LimbAdjustment(tangential_offset=-3e-4, arm=0.1004),
        LimbAdjustment(height_offset=2e-4, rod=0.1797),
    )
)
GEOMETRIES = pytest.mark.parametrize("geometry", [DeltaGeometry(), ADJUSTED], ids=["usual", "adjusted"])


def places(count: int) -> list[Vector]:
    draw = random.Random(5)
    return [(draw.uniform(-0.06, 0.06), draw.uniform(-0.06, 0.06), draw.uniform(0.0, 0.11)) for _ in range(count)]


@GEOMETRIES
def test_angles_their_slopes_and_turns_agree_with_the_kinematics(geometry: DeltaGeometry) -> None:
    linkage, delta, step = Linkage(geometry), ScalarDelta(geometry), 1e-6
    for place in places(50):
        here = linkage.linearise(*place)
        assert here is not None
        angles, rows, turns = here
        assert angles == pytest.approx(delta.inverse(*place), abs=1e-14)
        for index, (angle, turn) in enumerate(zip(angles, turns, strict=True)):
            true = angle + geometry.limb(index).angle_offset
            assert turn == pytest.approx((math.cos(true), math.sin(true)), abs=1e-14)
        for axis in range(3):
            near = [tuple(p + sign * step * (i == axis) for i, p in enumerate(place)) for sign in (1.0, -1.0)]
            ahead, behind = (delta.inverse(*point) for point in near)
            slopes = [(ahead[limb] - behind[limb]) / (2.0 * step) for limb in range(3)]
            assert [row[axis] for row in rows] == pytest.approx(slopes, abs=1e-6)


def test_results_are_finite_at_the_edge_of_reach_and_none_beyond() -> None:
    linkage, delta = Linkage(DeltaGeometry()), ScalarDelta()
    low, high = 0.1, 0.3
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if math.isnan(delta.inverse(0.0, 0.0, middle)[0]) else (middle, high)
    here = linkage.linearise(0.0, 0.0, low)
    assert here is not None
    assert here[0] == pytest.approx(delta.inverse(0.0, 0.0, low), abs=1e-9)
    assert all(math.isfinite(value) for row in here[1] for value in row)
    assert linkage.linearise(0.0, 0.0, high + 1e-9) is None
    assert linkage.linearise(math.nan, 0.0, 0.05) is None
