# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import pytest

from deltacharger_driver.errors import DriverError, TrajectoryRefused
from deltacharger_driver.servos.trajectory import JointLimits, ServoWaypoint, check

NAMES = ("a", "b", "c")
LIMITS = JointLimits(NAMES, -1.0, 1.2, 4.0)
START = (0.0, 0.1, 0.2)


def points(*rows):
    return [ServoWaypoint(*row) for row in rows]


def test_linear_between_the_goal_and_the_points():
    trajectory = check(NAMES, points((1.0, (0.2, 0.2, 0.2)), (2.0, (0.0, 0.4, 0.2))), LIMITS)
    assert trajectory.goal_at(0.0, START) == START
    assert trajectory.goal_at(0.5, START) == pytest.approx((0.1, 0.15, 0.2))
    assert trajectory.goal_at(1.0, START) == (0.2, 0.2, 0.2)
    assert trajectory.goal_at(1.5, START) == pytest.approx((0.1, 0.3, 0.2))
    assert trajectory.goal_at(99.0, START) == (0.0, 0.4, 0.2)
    assert trajectory.duration == 2.0


def test_joints_may_be_in_any_order():
    trajectory = check(("c", "a", "b"), points((1.0, (0.3, 0.1, 0.2), (3.0, 1.0, 2.0))), LIMITS)
    assert trajectory.angles == ((0.1, 0.2, 0.3),)
    assert trajectory.torques == ((1.0, 2.0, 3.0),)


def test_a_bound_holds_from_the_start_of_its_segment():
    trajectory = check(
        NAMES, points((1.0, START), (2.0, START, (1.0, 1.0, 1.0)), (3.0, START), (4.0, START, (0.0, 2.0, 4.0))), LIMITS
    )
    assert trajectory.torque_at(0.5) is None
    assert trajectory.torque_at(1.0) == (1.0, 1.0, 1.0)
    assert trajectory.torque_at(2.5) == (1.0, 1.0, 1.0)
    assert trajectory.torque_at(3.0) == (0.0, 2.0, 4.0)
    assert trajectory.torque_at(9.0) == (0.0, 2.0, 4.0)


def test_the_rest_follows_the_same_path():
    trajectory = check(
        NAMES,
        points((1.0, (0.2, 0.2, 0.2), (1.0, 2.0, 3.0)), (2.0, (0.0, 0.4, 0.2)), (3.0, START, (0.0, 0.0, 0.0))),
        LIMITS,
    )
    for cut in (0.0, 0.3, 1.0, 1.7, 2.5):
        rest = trajectory.remaining(cut)
        here = trajectory.goal_at(cut, START)
        assert rest.duration == pytest.approx(3.0 - cut)
        for later in (0.0, 0.1, 0.4, 1.3, 5.0):
            assert rest.goal_at(later, here) == pytest.approx(trajectory.goal_at(cut + later, START))
            assert rest.torque_at(later) == trajectory.torque_at(cut + later)
    assert trajectory.remaining(3.0).is_hold


def test_no_points_mean_hold():
    assert check((), [], LIMITS).is_hold
    assert check(NAMES, [], LIMITS).is_hold


@pytest.mark.parametrize(
    ("names", "rows", "reason"),
    [
        (("a", "b", "x"), [(1.0, START)], "x"),
        (("a", "b"), [(1.0, (0.0, 0.0))], "exactly once"),
        (("a", "b", "b"), [(1.0, START)], "exactly once"),
        ((), [(1.0, ())], "exactly once"),
        (("a", "x", "c"), [], "x"),
        (NAMES, [(1.0, (0.0, 0.0))], "2 numbers for 3"),
        (NAMES, [(1.0, ())], "0 numbers"),
        (NAMES, [(1.0, START, (1.0, 1.0))], "effort"),
        (NAMES, [(1.0, (0.0, math.nan, 0.0))], "nan"),
        (NAMES, [(1.0, (0.0, 1.2001, 0.0))], "b is 1.2001"),
        (NAMES, [(1.0, START), (1.0, START)], "rise"),
        (NAMES, [(1.0, START), (0.5, START)], "rise"),
        (NAMES, [(1.0, START), (2.0, (0.0, 0.0, 9.0))], "point 1"),
    ],
)
def test_bad_trajectories_are_refused_with_a_reason(names, rows, reason):
    with pytest.raises(TrajectoryRefused, match=reason.replace(".", r"\.")) as caught:
        check(names, points(*rows), LIMITS)
    assert isinstance(caught.value, DriverError)
