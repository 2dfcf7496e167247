# SPDX-License-Identifier: Apache-2.0
"""Laws of straight lines: rest at both ends, on the line, within every limit, refused before anything moves."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from deltacharger_kinematics import Delta, DeltaGeometry, Status
from deltacharger_kinematics.geometry import NO_ANSWER, LimbAdjustment
from deltacharger_kinematics.line import ARM_ACCELERATION, ARM_SPEED, PEAK_SPEED, REFUSED, Line, LineRefused, plan_line

from ..marks import night

DELTA = Delta()
DOCK = (0.0, 0.0, 0.080)
MILLIMETRE = 1e-3

place = st.tuples(st.floats(-0.060, 0.060), st.floats(-0.060, 0.060), st.floats(0.0, 0.110))
speeds = st.floats(1e-3, 1e3)


def lines(count: int, seed: int = 1) -> np.ndarray:
    geometry = DELTA.geometry
    return np.random.default_rng(seed).uniform(geometry.workspace_min, geometry.workspace_max, (count, 2, 3))


def off_line(points: np.ndarray, start: np.ndarray, goal: np.ndarray) -> float:
    """Return the distances (m) of the points from the line."""
    along = (goal - start) / np.linalg.norm(goal - start)
    relative = points - start
    return float(np.linalg.norm(relative - np.outer(relative @ along, along), axis=1).max())


def shares(line: Line) -> tuple[float, float]:
    """Return the shares of the arms' speed and acceleration limits that a line uses."""
    return np.abs(line.velocities).max() / ARM_SPEED, np.abs(line.accelerations).max() / ARM_ACCELERATION


@settings(max_examples=30)
@given(place, place, speeds)
def test_a_line_joins_its_ends_at_rest_and_keeps_every_limit(
    start: tuple[float, float, float], goal: tuple[float, float, float], speed: float
) -> None:
    line = plan_line(DELTA, start, goal, speed)
    assert line.positions[0].tolist() == list(start)
    assert line.positions[-1].tolist() == list(goal)
    assert line.times[0] == 0.0
    assert line.duration == line.times[-1]
    assert np.diff(line.times).max() <= 0.02 * (1 + 1e-9)
    assert np.all(np.diff(line.times) > 0.0)
    for moving in (line.velocities, line.accelerations):
        assert not moving[[0, -1]].any()
    assert np.array_equal(line.angles, DELTA.inverse(line.positions).angles)
    assert max(shares(line)) <= 1.0
    assert PEAK_SPEED * math.dist(start, goal) / line.duration <= speed * (1 + 1e-12)


def test_velocities_and_accelerations_are_the_derivatives_of_the_angles() -> None:
    limbs = (
        LimbAdjustment(radius_offset=1e-3, angle_offset=0.03),
        LimbAdjustment(tangential_offset=-2e-3, arm=0.101),
        LimbAdjustment(height_offset=1.5e-3, rod=0.1785),
    )
    delta = Delta(DeltaGeometry(limbs=limbs, joint_min=-3.0, joint_max=3.0))
    start, goal = (-0.010, 0.015, 0.060), (0.012, -0.008, 0.085)
    line = plan_line(delta, start, goal, 5e-4)
    step = line.times[1]
    speed = (line.angles[2:] - line.angles[:-2]) / (2 * step)
    assert np.allclose(line.velocities[1:-1], speed, atol=1e-5 * np.abs(speed).max())
    change = (line.velocities[2:] - line.velocities[:-2]) / (2 * step)
    assert np.allclose(line.accelerations[1:-1], change, atol=1e-5 * np.abs(change).max())
    platform = np.einsum("nij,nj->ni", delta.jacobian(line.positions).matrix, line.velocities)
    u = line.times / line.duration
    wanted = np.outer(30 * u**2 * (1 - u) ** 2 / line.duration, np.subtract(goal, start))
    assert np.allclose(platform, wanted, atol=1e-13)


@pytest.mark.parametrize("count", [6, night(120)])
@pytest.mark.parametrize(("speed", "bound"), [(0.12, 0.02), (0.5, 0.2), (1e3, 0.2)])
def test_linear_interpolation_of_angles_keeps_the_platform_near_the_line(
    speed: float, bound: float, count: int
) -> None:
    worst = 0.0
    box = np.array([DELTA.geometry.workspace_min, DELTA.geometry.workspace_max])
    corners = [box[[i, j, k], range(3)] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    for start, goal in [*lines(count, seed=4), *list(itertools.permutations(corners, 2))[: 2 * count]]:
        angles = plan_line(DELTA, start, goal, speed).angles
        for share in (0.25, 0.5, 0.75):
            between = DELTA.forward((1 - share) * angles[:-1] + share * angles[1:]).position
            worst = max(worst, off_line(between, start, goal))
    assert 0.0 < worst < bound * MILLIMETRE


def test_a_goal_out_of_reach_is_refused_with_the_last_reachable_place() -> None:
    with pytest.raises(LineRefused, match="mm") as caught:
        plan_line(DELTA, DOCK, (0.0, 0.0, 0.190), 0.12)
    error = caught.value
    assert Status.JOINT_LIMIT in error.status
    x, y, z = error.position
    assert (x, y) == (0.0, 0.0)
    assert error.share == pytest.approx((z - 0.080) / 0.110)
    assert DELTA.inverse((0.0, 0.0, z)).status & REFUSED
    assert not DELTA.inverse((0.0, 0.0, z - 1e-3)).status & REFUSED


def test_a_line_with_good_ends_that_leaves_the_limits_in_between_is_refused_even_if_no_waypoint_does() -> None:
    start, goal = np.array((-0.0535, 0.0664, -0.0028)), np.array((-0.0382, -0.0909, -0.0106))
    waypoints = DELTA.inverse([start, 0.5 * (start + goal), goal])
    assert not (np.asarray(waypoints.status) & np.uint32(REFUSED)).any()
    with pytest.raises(LineRefused, match="JOINT_LIMIT") as caught:
        plan_line(DELTA, start, goal, 1e3)
    assert 0.5 < caught.value.share < 0.7
    assert Status.LIMB_2 in caught.value.status


def test_a_stretched_arm_is_always_refused_because_it_would_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deltacharger_kinematics.line.REFUSED", NO_ANSWER)
    delta = Delta(DeltaGeometry(base_radius=0.050, z_offset=0.0, arm=0.125, rod=0.125, joint_min=-3.1, joint_max=3.1))
    reach = (0.0, 0.0, 0.250)  # arms and rods in one line, exactly
    assert delta.inverse(reach).margin == 0.0
    with pytest.raises(LineRefused, match="NEAR_TYPE_1"):
        plan_line(delta, (0.0, 0.0, 0.200), reach, 0.1)
