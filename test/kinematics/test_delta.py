"""Laws of the kinematics: round trips, finite differences, virtual work, and what bad points return."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltacharger_kinematics import Delta, DeltaGeometry, KinematicsError, Status
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.statics import TORQUE_CONSTANT

DELTA = Delta()
SCALAR = ScalarDelta()
DOCK = (0.0, 0.0, 0.080)
MILLIMETRE = 1e-3

AZIMUTHS = np.radians((0.0, 120.0, 240.0))

lateral = st.floats(-0.060, 0.060)
forward = st.floats(0.0, 0.110)


def workspace_points(count: int, seed: int = 1) -> np.ndarray:
    geometry = DELTA.geometry
    return np.random.default_rng(seed).uniform(geometry.workspace_min, geometry.workspace_max, (count, 3))


@given(lateral, lateral, forward)
def test_forward_undoes_inverse_in_the_whole_workspace(x: float, y: float, z: float) -> None:
    solved = DELTA.inverse((x, y, z))
    assert solved.status == Status.OK
    assert np.allclose(DELTA.forward(solved.angles).position, (x, y, z), atol=1e-14)


@given(lateral, lateral, forward)
def test_the_scalar_path_agrees_with_the_arrays(x: float, y: float, z: float) -> None:
    angles = SCALAR.inverse(x, y, z)
    assert np.allclose(angles, DELTA.inverse((x, y, z)).angles, atol=1e-15)
    assert np.allclose(SCALAR.forward(*angles), (x, y, z), atol=1e-14)
    assert np.allclose(SCALAR.jacobian(x, y, z), DELTA.jacobian((x, y, z)).matrix.ravel(), atol=1e-14)
    weight = (0.0, -9.81, 0.0)
    assert np.allclose(SCALAR.holding_torque(x, y, z, weight), DELTA.holding_torque((x, y, z), weight), atol=1e-14)


def test_published_angles() -> None:
    home, dock = DELTA.inverse([(0.0, 0.0, 0.0), DOCK]).angles
    assert np.allclose(np.degrees(home), -41.55, atol=0.01)
    assert np.allclose(np.degrees(dock), 15.27, atol=0.01)


def test_the_jacobian_is_the_derivative_of_forward_kinematics() -> None:
    points = workspace_points(200)
    angles = DELTA.inverse(points).angles
    step = 1e-6
    for joint in range(3):
        shift = step * np.eye(3)[joint]
        slope = (DELTA.forward(angles + shift).position - DELTA.forward(angles - shift).position) / (2 * step)
        assert np.allclose(DELTA.jacobian(points).matrix[..., joint], slope, atol=1e-9)


def test_the_workspace_is_well_conditioned() -> None:
    condition = DELTA.jacobian(workspace_points(2000)).condition
    assert condition.max() < 3.5
    assert 2.0 < np.median(condition) < 2.4


def test_torque_does_the_work_of_the_force() -> None:
    points = workspace_points(100)
    force = np.random.default_rng(2).normal(size=(100, 3))
    speed = np.random.default_rng(3).normal(size=(100, 3))
    velocity = np.einsum("nij,nj->ni", DELTA.jacobian(points).matrix, speed)
    assert np.allclose((DELTA.torque(points, force) * speed).sum(-1), (force * velocity).sum(-1), atol=1e-12)
    assert np.allclose(DELTA.force(points, DELTA.torque(points, force)), force, atol=1e-12)


def test_twenty_newtons_at_the_dock_cost_half_an_ampere() -> None:
    current = DELTA.torque(DOCK, (0.0, 0.0, 20.0)) / TORQUE_CONSTANT
    assert np.allclose(current, 0.521, atol=5e-4)


def test_holding_torque_is_the_slope_of_potential_energy() -> None:
    geometry, gravity = DELTA.geometry, np.array((1.0, -9.0, 2.0))

    def arms(angles: np.ndarray) -> np.ndarray:
        return geometry.arm * np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    def energy(angles: np.ndarray) -> float:
        platform = DELTA.forward(angles).position
        elbows = np.stack(
            [(np.cos(azimuth) * arm[0], np.sin(azimuth) * arm[0], arm[1]) for azimuth, arm in zip(AZIMUTHS, arms(angles))]
        )
        carried = (geometry.platform_mass + 1.5 * geometry.rod_mass) * platform
        return -float(gravity @ (carried + 0.5 * geometry.rod_mass * elbows.sum(0)))

    for point in workspace_points(20):
        angles = DELTA.inverse(point).angles
        slope = [(energy(angles + 1e-6 * e) - energy(angles - 1e-6 * e)) / 2e-6 for e in np.eye(3)]
        assert np.allclose(DELTA.holding_torque(point, gravity), slope, atol=1e-8)


def test_contact_force_is_free_of_the_arms_weight() -> None:
    push = np.array((1.0, -2.0, 18.0))
    current = (DELTA.torque(DOCK, push) + DELTA.holding_torque(DOCK)) / TORQUE_CONSTANT
    assert np.allclose(DELTA.contact_force(DOCK, current), push, atol=1e-12)


@pytest.mark.parametrize(
    ("point", "status"),
    [
        ((math.nan, 0, 0), Status.INVALID_INPUT),
        ((0, math.inf, 0), Status.INVALID_INPUT),
        ((0, 0, 1e200), Status.UNREACHABLE_FAR),
        ((1e308, -1e308, 0), Status.UNREACHABLE_FAR),
        ((0, 0, 0.5), Status.UNREACHABLE_FAR),
        ((0, 0.3, 0), Status.UNREACHABLE_LATERAL),
        ((0, 0, -0.095), Status.UNREACHABLE_NEAR),
    ],
)
def test_points_without_an_answer_are_nan_and_say_why(point: tuple[float, float, float], status: Status) -> None:
    with np.errstate(all="raise"):
        solved = DELTA.inverse(point)
    assert status in solved.status
    assert np.isnan(solved.angles).any()


def test_a_bad_point_leaves_its_neighbours_alone() -> None:
    points = np.array([DOCK, (math.nan, 0, 0), (0, 0, 9.0), DOCK])
    solved = DELTA.inverse(points)
    assert solved.status.tolist()[0::3] == [0, 0]
    assert np.array_equal(solved.angles[0], DELTA.inverse(DOCK).angles)
    assert np.isnan(solved.margin[1])
    assert solved.margin[2] < 0


def test_strict_names_the_offenders() -> None:
    with pytest.raises(KinematicsError, match="point 1") as caught:
        DELTA.inverse([DOCK, (0, 0, 9.0)], strict=True)
    assert caught.value.indices == [1]


def test_outside_the_box_but_reachable_is_a_flag_and_an_answer() -> None:
    solved = DELTA.inverse((0.0, 0.0, 0.115))
    assert solved.status == Status.OUTSIDE_WORKSPACE
    assert np.isfinite(solved.angles).all()


def test_joint_limit_names_the_limb() -> None:
    solved = DELTA.inverse((0.0, 0.0, 0.178))
    assert Status.JOINT_LIMIT in solved.status
    assert Status.LIMB_0 in solved.status


def test_reachable_points_of_the_mirror_assembly_are_told() -> None:
    points = np.random.default_rng(5).uniform((-0.2, -0.2, 0), (0.2, 0.2, 0.2), (5000, 3))
    solved = DELTA.inverse(points)
    good = np.isfinite(solved.angles).all(-1)
    returned = DELTA.forward(solved.angles[good]).position
    elsewhere = np.abs(returned - points[good]).max(-1) > MILLIMETRE
    assert elsewhere.any()
    assert np.array_equal(elsewhere, (solved.status[good] & Status.WRONG_ASSEMBLY) != 0)


def test_rods_that_do_not_meet() -> None:
    delta = Delta(DeltaGeometry(base_radius=0.4, rod=0.11))
    solved = delta.forward((0.0, 0.0, 0.0))
    assert Status.NOT_ASSEMBLABLE in solved.status
    assert np.isnan(solved.position).all()
    assert all(math.isnan(value) for value in ScalarDelta(delta.geometry).forward(0.0, 0.0, 0.0))


@pytest.mark.parametrize("field", ["base_radius", "arm", "rod", "platform_radius"])
@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf])
def test_impossible_lengths_are_refused(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        DeltaGeometry().with_values(**{field: value})


def test_wrong_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        DELTA.inverse([1.0, 2.0])
