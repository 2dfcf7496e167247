# SPDX-License-Identifier: Apache-2.0
"""Which trajectories the arm may follow, and whose in every state of the contactor."""

import math

import pytest

from deltacharger_core.real_time import AHEAD
from deltacharger_driver.errors import DriverError, TrajectoryRefused
from deltacharger_driver.servos import motion

NAMES = ("a", "b", "c")
LIMITS = motion.JointLimits(NAMES, -1.0, 1.2, 4.0)
START = (0.0, 0.1, 0.2)


def points(*rows):
    return [motion.ServoWaypoint(*row) for row in rows]


def test_linear_between_the_goal_and_the_points():
    trajectory = motion.check(NAMES, points((1.0, (0.2, 0.2, 0.2)), (2.0, (0.0, 0.4, 0.2))), LIMITS)
    assert trajectory.goal_at(0.0, START) == START
    assert trajectory.goal_at(0.5, START) == pytest.approx((0.1, 0.15, 0.2))
    assert trajectory.goal_at(1.0, START) == (0.2, 0.2, 0.2)
    assert trajectory.goal_at(1.5, START) == pytest.approx((0.1, 0.3, 0.2))
    assert trajectory.goal_at(99.0, START) == (0.0, 0.4, 0.2)
    assert trajectory.duration == 2.0


def test_joints_may_be_in_any_order():
    trajectory = motion.check(("c", "a", "b"), points((1.0, (0.3, 0.1, 0.2), (3.0, 1.0, 2.0))), LIMITS)
    assert trajectory.angles == ((0.1, 0.2, 0.3),)
    assert trajectory.torques == ((1.0, 2.0, 3.0),)


def test_a_bound_holds_from_the_start_of_its_segment():
    trajectory = motion.check(
        NAMES, points((1.0, START), (2.0, START, (1.0, 1.0, 1.0)), (3.0, START), (4.0, START, (0.0, 2.0, 4.0))), LIMITS
    )
    assert trajectory.torque_at(0.5) is None
    assert trajectory.torque_at(1.0) == (1.0, 1.0, 1.0)
    assert trajectory.torque_at(2.5) == (1.0, 1.0, 1.0)
    assert trajectory.torque_at(3.0) == (0.0, 2.0, 4.0)
    assert trajectory.torque_at(9.0) == (0.0, 2.0, 4.0)


def test_the_rest_follows_the_same_path():
    trajectory = motion.check(
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
    assert motion.check((), [], LIMITS).is_hold


@pytest.mark.parametrize(
    ("names", "rows", "reason"),
    [
        (("a", "b", "b"), [(1.0, START)], "exactly once"),
        ((), [(1.0, ())], "exactly once"),
        (("a", "x", "c"), [], "x"),
        (NAMES, [(1.0, (0.0, 0.0))], "2 numbers for 3"),
        (NAMES, [(1.0, START, (1.0, 1.0))], "effort"),
        (NAMES, [(1.0, (0.0, 1.2001, 0.0))], "b is 1.2001"),
        (NAMES, [(1.0, START), (1.0, START)], "rise"),
        (NAMES, [(1.0, START), (2.0, (0.0, 0.0, 9.0))], "point 1"),
    ],
)
def test_bad_trajectories_are_refused_with_a_reason(names, rows, reason):
    with pytest.raises(TrajectoryRefused, match=reason.replace(".", r"\.")) as caught:
        motion.check(names, points(*rows), LIMITS)
    assert isinstance(caught.value, DriverError)


DOCKING, STRANGER, UNKNOWN = motion.Sender("a" * 32, b"1"), motion.Sender("", b"2"), motion.Sender()
OPEN, ARMED, CLOSED = (
    {"closed": False, "armed": False},
    {"closed": False, "armed": True},
    {"closed": True, "armed": True},
)


def guard(
    *reports: dict[str, bool], publisher: bytes = b"board", age: float = 0.0, now: float = 0.0
) -> motion.MotionGuard:
    guard = motion.MotionGuard()
    for report in reports:
        guard.observe(publisher, **report, age=age, now=now)
    return guard


def after_docking_moved(report: dict[str, bool], **keys: float) -> motion.MotionGuard:
    """Return a guard after docking moved the arm with an open contactor, followed by `report`."""
    guard_ = guard(OPEN)
    guard_.record_move(DOCKING, motion.ContactorState.OPEN)
    guard_.observe(b"board", **report, **{"age": 0.0, "now": 0.0, **keys})
    return guard_


@pytest.mark.parametrize(
    ("state", "allowed"),
    [
        (motion.ContactorState.ABSENT, (DOCKING, STRANGER, UNKNOWN)),
        (motion.ContactorState.OPEN, (DOCKING, STRANGER, UNKNOWN)),
        (motion.ContactorState.ARMED, (DOCKING,)),
        (motion.ContactorState.UNKNOWN, (DOCKING,)),
        (motion.ContactorState.CLOSED, ()),
    ],
)
def test_senders_that_may_move_the_arm(state: motion.ContactorState, allowed: tuple[motion.Sender, ...]) -> None:
    found = after_docking_moved(OPEN)
    assert tuple(sender for sender in (DOCKING, STRANGER, UNKNOWN) if found.may_move(sender, state)) == allowed


def test_the_arm_is_free_without_a_board_but_not_with_a_silent_one() -> None:
    assert motion.MotionGuard().state(0.0, is_announced=False) is motion.ContactorState.ABSENT
    assert motion.MotionGuard().state(0.0, is_announced=True) is motion.ContactorState.UNKNOWN
    assert guard(OPEN).state(99.0, is_announced=False) is motion.ContactorState.UNKNOWN  # it was received before


@pytest.mark.parametrize("age", [math.nan, -AHEAD * 2.0, motion.FRESH * 1.01])
def test_a_wrong_or_old_stamp_frees_no_arm_that_was_stopped(age: float) -> None:
    later = guard(CLOSED)
    later.observe(b"board", **OPEN, age=age, now=0.05)
    assert later.state(0.05, False) is motion.ContactorState.CLOSED


def test_only_a_sender_that_moves_a_free_arm_becomes_the_leader() -> None:
    found = after_docking_moved(OPEN)
    for state in set(motion.ContactorState) - {motion.ContactorState.OPEN}:
        found.record_move(STRANGER, state)
        assert not found.may_move(STRANGER, motion.ContactorState.UNKNOWN)
    found.record_move(STRANGER, motion.ContactorState.OPEN)
    assert found.may_move(STRANGER, motion.ContactorState.UNKNOWN)


@pytest.mark.parametrize(
    "other",
    [motion.Sender("a" * 32, b"2"), motion.Sender("b" * 32, b"1"), motion.Sender("", b"1"), motion.Sender("a" * 32)],
)
def test_secret_and_publisher_must_both_be_the_same(other: motion.Sender) -> None:
    assert DOCKING.is_same(DOCKING)
    assert not DOCKING.is_same(other)
    assert not other.is_same(DOCKING)
