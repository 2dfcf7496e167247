# SPDX-License-Identifier: Apache-2.0
"""Precision relative to 60-digit arithmetic, and reachability."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpmath import mpf

from deltacharger_kinematics import WORKING_MODES, Delta, DeltaGeometry, Status
from deltacharger_kinematics.exact.precise import exact_discriminant
from deltacharger_kinematics.scalar import ScalarDelta

from ..marks import night
from .reference import CALIBRATED, along, angles, discriminants, edge_of_reach, worst_error

NOMINAL = DeltaGeometry()
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


def edge_points(geometry: DeltaGeometry, side: int, decades: range, rays: int) -> np.ndarray:
    """Return doubles at 10^decade m on one side (+1 outside, −1 inside) of the edge of reach."""
    generator = np.random.default_rng(11)
    start = (0.0, 0.0, geometry.rod - geometry.z_offset)
    points = []
    for _ in range(rays):
        direction = generator.normal(size=3)
        direction /= np.linalg.norm(direction)
        edge = edge_of_reach(start, direction, geometry)
        points += [along(start, direction, edge + side * mpf(10) ** decade) for decade in decades]
    return np.array(points, dtype=float)


def solved(geometry: DeltaGeometry, points: np.ndarray) -> list[np.ndarray]:
    """Return the angles in a batch and point by point."""
    delta = Delta(geometry)
    return [delta.inverse(points).angles, np.array([delta.inverse(point).angles for point in points])]


every_geometry = pytest.mark.parametrize("name", GEOMETRIES)
few_and_many = pytest.mark.parametrize("rays", [1, night(30)])


@pytest.mark.parametrize("count", [60, night(800)])
def test_the_workspace_is_solved_to_the_last_digits(count: int) -> None:
    points = box_points(NOMINAL, count)
    assert max(worst_error(angles, points, NOMINAL) for angles in solved(NOMINAL, points)) <= INTERIOR


@every_geometry
@pytest.mark.parametrize("count", [60, night(300)])
def test_precise_is_correct_to_the_last_digit_everywhere(name: str, count: int) -> None:
    geometry = GEOMETRIES[name]
    reach = geometry.arm + geometry.rod
    points = np.random.default_rng(3).uniform(-reach, reach, (count, 3))
    assert worst_error(Delta(geometry).inverse(points, precise=True).angles, points, geometry) <= EDGE


@every_geometry
@few_and_many
def test_points_inside_the_edge_are_solved_to_the_last_digit_and_none_outside(name: str, rays: int) -> None:
    geometry = GEOMETRIES[name]
    inside, outside = edge_points(geometry, -1, range(-15, -3), rays), edge_points(geometry, 1, range(-15, -2), rays)
    assert max(worst_error(angles, inside, geometry) for angles in solved(geometry, inside)) <= EDGE
    status = np.asarray(Delta(geometry).inverse(inside[:10]).status)
    assert ((status & Status.NEAR_TYPE_1) != 0).all()
    assert ((status & (Status.LIMB_0 | Status.LIMB_1 | Status.LIMB_2)) != 0).all()
    assert np.isnan(Delta(geometry).inverse(outside).angles).any(axis=1).all()
    assert all(np.isnan(ScalarDelta(geometry).inverse(*point)).all() for point in outside.tolist())


@pytest.mark.parametrize("rays", [8, night(40)])
def test_doubles_nearer_to_the_edge_than_one_ulp_are_decided_too(rays: int) -> None:
    points = edge_points(NOMINAL, +1, range(-22, -16), rays)
    truth = [[q >= 0 for q in discriminants(point, NOMINAL)] for point in points.tolist()]
    assert np.array_equal(np.isfinite(Delta().inverse(points).angles), truth)
    assert not np.all(truth)
    assert np.any(np.all(truth, axis=1))


@pytest.mark.parametrize("mode", WORKING_MODES)
def test_every_working_mode_is_a_separate_solution(mode: tuple[int, int, int]) -> None:
    delta = Delta(CALIBRATED, working_mode=mode)
    points = box_points(CALIBRATED, 10)
    exact = np.array([angles(point.tolist(), CALIBRATED, mode) for point in points], dtype=float)
    assert np.allclose(delta.inverse(points).angles, exact, rtol=0.0, atol=INTERIOR)
    assert np.allclose([delta.inverse(point).angles for point in points], exact, rtol=0.0, atol=INTERIOR)


def test_round_trip_over_the_workspace() -> None:
    points = box_points(NOMINAL, 20_000)
    returned = Delta().forward(Delta().inverse(points).angles).position
    assert np.linalg.norm(returned - points, axis=1).max() <= 5e-16


def test_the_exact_discriminant_keeps_its_sign() -> None:
    geometry = DeltaGeometry(base_radius=0.25, platform_radius=0.125, arm=0.25, rod=0.5, z_offset=0.5)
    edge = 0.125 + 0.75  # stretched along limb 0: exactly at the edge
    for x, sign in ((edge, 0.0), (np.nextafter(edge, 0.0), 1.0), (np.nextafter(edge, 1.0), -1.0)):
        assert np.sign(exact_discriminant(float(x), 0.0, -0.5, geometry.limb(0))) == sign
    for index, point in itertools.product(range(3), box_points(NOMINAL, 20).tolist()):
        exact = exact_discriminant(*point, NOMINAL.limb(index))
        assert exact == pytest.approx(float(discriminants(point, NOMINAL)[index]), rel=1e-15)


def test_the_margin_falls_monotonically_through_the_edge() -> None:
    for direction in np.random.default_rng(2).normal(size=(6, 3)):
        unit = direction / np.linalg.norm(direction)
        edge = float(edge_of_reach((0.0, 0.0, 0.06), unit, NOMINAL))
        steps = edge + np.concatenate([-np.logspace(-3, -12, 19), [0.0], np.logspace(-12, -3, 19)])
        margin = np.asarray(Delta().inverse(np.array((0.0, 0.0, 0.06)) + steps[:, None] * unit).margin)
        assert (np.diff(margin) < 0.0).all()
        assert margin[0] > 0.0 > margin[-1]


def test_continuity_where_a_platform_joint_passes_the_motor_plane() -> None:
    """w changes sign at z = −z_offset, where forms that divide by w lose the angle or turn the knee."""
    geometry = DeltaGeometry(base_radius=0.2, platform_radius=0.03, z_offset=0.0)
    offsets = np.concatenate([-np.logspace(-2, -300, 150), [-0.0, 0.0], np.logspace(-300, -2, 150)])
    points = np.stack([np.full_like(offsets, 0.01), np.full_like(offsets, -0.02), offsets], axis=-1)
    found = Delta(geometry).inverse(points)
    assert np.isfinite(found.angles).all()
    steps = np.abs(np.diff(found.angles, axis=0)).max(axis=1)
    assert (steps <= 40.0 * np.diff(offsets) + 1e-15).all()
    assert worst_error(found.angles[140:160], points[140:160], geometry) <= INTERIOR
