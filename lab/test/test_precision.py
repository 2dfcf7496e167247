# SPDX-License-Identifier: Apache-2.0
"""Precision relative to 60-digit arithmetic, and reachability."""

from fractions import Fraction

import numpy as np
import pytest

from deltacharger_kinematics import Delta, DeltaGeometry, Status
from deltacharger_kinematics.exact import exact_discriminant
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_lab.reports.kinematics import reference, sets
from test.marks import night

NOMINAL, CALIBRATED = DeltaGeometry(), DeltaGeometry(limbs=sets.ADJUSTED)
GEOMETRIES = {
    "nominal": NOMINAL,
    "calibrated": CALIBRATED,
    "arm longer than rod": DeltaGeometry(arm=0.2, rod=0.1, z_offset=0.0),
    "arm as long as rod": DeltaGeometry(arm=0.15, rod=0.15),
    "wide base": DeltaGeometry(base_radius=0.2, platform_radius=0.03),
    "platform wider than base": DeltaGeometry(base_radius=0.03, platform_radius=0.06),
}
INTERIOR, EDGE = 8e-16, 4e-16  # rad


def box_points(geometry: DeltaGeometry, count: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(geometry.workspace_min, geometry.workspace_max, (count, 3))


def worst_error(given: np.ndarray, points: np.ndarray, exact: reference.ExactDelta) -> float:
    """Return the largest error (rad) of `given` angles (n, 3); infinite if reachability is wrong."""
    true = exact.inverse(points).angles
    right = np.array_equal(np.isnan(given), np.isnan(true.high))
    return float(np.nanmax(np.abs((given - true.high) - true.low))) if right else np.inf


def solved(delta: Delta, points: np.ndarray) -> list[np.ndarray]:
    """Return the angles in a batch, and point by point in plain floats."""
    scalar = ScalarDelta(delta.geometry)
    return [delta.inverse(points).angles, np.array([scalar.inverse(*point) for point in points.tolist()])]


every_geometry = pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)


@pytest.mark.parametrize("count", [60, night(800)])
def test_the_workspace_is_solved_to_the_last_digits(count: int) -> None:
    points, exact = box_points(NOMINAL, count), reference.ExactDelta()
    assert max(worst_error(angles, points, exact) for angles in solved(Delta(), points)) <= INTERIOR


@every_geometry
@pytest.mark.parametrize("count", [12, night(360)])
def test_points_inside_the_edge_are_solved_to_the_last_digit_and_none_outside(
    geometry: DeltaGeometry, count: int
) -> None:
    """From 1e-17 m, far less than a unit in the last place."""
    random, delta, exact = np.random.default_rng(11), Delta(geometry), reference.ExactDelta(geometry)
    inside, outside = sets.boundary(exact, random, count), sets.outside(exact, random, count, -17.0, -3.0).points
    assert len(inside.points) == len(outside) == count
    batch, alone = (worst_error(angles, inside.points, exact) for angles in solved(delta, inside.points))
    assert batch <= EDGE
    assert alone <= np.spacing(2.0)  # a folded limb's angle is above 2 rad
    near = np.asarray(delta.inverse(inside.points).status)[np.asarray(inside.edge) < 1e-6 * geometry.arm]
    assert len(near)
    assert ((near & Status.NEAR_TYPE_1) != 0).all()
    assert ((near & (Status.LIMB_0 | Status.LIMB_1 | Status.LIMB_2)) != 0).all()
    assert worst_error(delta.inverse(outside).angles, outside, exact) <= INTERIOR
    assert all(np.isnan(angles).any(axis=1).all() for angles in solved(delta, outside))


def test_the_exact_discriminant_keeps_its_sign() -> None:
    geometry = DeltaGeometry(base_radius=0.25, platform_radius=0.125, arm=0.25, rod=0.5, z_offset=0.5)
    edge = 0.125 + 0.75  # stretched along limb 0: exactly at the edge
    for x, sign in ((edge, 0.0), (np.nextafter(edge, 0.0), 1.0), (np.nextafter(edge, 1.0), -1.0)):
        assert np.sign(exact_discriminant(float(x), 0.0, -0.5, geometry.limb(0))) == sign
    for point in box_points(geometry, 20).tolist():
        x, y, z = map(Fraction, point)
        across = (x - Fraction(1, 8)) ** 2 + (z + Fraction(1, 2)) ** 2
        exact = across / 4 - (across + y * y - Fraction(3, 16)) ** 2
        assert exact_discriminant(*point, geometry.limb(0)) == pytest.approx(float(exact), rel=1e-15)
