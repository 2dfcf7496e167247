# SPDX-License-Identifier: Apache-2.0
"""Trajectories: followed in time, replaced, sent in pieces, and interrupted by pauses of the host."""

from __future__ import annotations

import time
from collections.abc import Sequence

import pytest

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_driver.errors import TrajectoryRefused
from deltacharger_driver.servos.mx64 import CURRENT_UNIT, TICK
from deltacharger_driver.servos.report import ServoPhase, ServoReport
from deltacharger_driver.servos.trajectory import ServoWaypoint, check

from .servo_rig import DEFAULT, LIMITS, NAMES, START, Rig


def test_a_trajectory_without_torque_is_refused(rig: Rig) -> None:
    rig.cycle()
    with pytest.raises(TrajectoryRefused, match="set_torque"):
        rig.send((0.1, START))


def test_a_trajectory_is_followed_in_time_and_takes_effect_in_the_next_cycle(rig: Rig) -> None:
    rig.torque_on()
    goal = tuple(angle + 0.1 for angle in START)
    rig.send((0.0, goal))
    rig.cycle()
    assert rig.references() == pytest.approx(list(goal), abs=TICK)
    begin = time.monotonic()
    rig.send((0.5, START))
    middle = []

    def done(report: ServoReport) -> bool:
        middle.append(rig.references()[0])
        return rig.references() == pytest.approx(list(START), abs=TICK)

    rig.until(done)
    assert 0.45 <= time.monotonic() - begin <= 1.5
    assert middle == sorted(middle, reverse=True)
    assert len(set(middle)) > 15


def test_a_new_trajectory_starts_at_the_goal_where_the_old_one_was_cut(rig: Rig) -> None:
    rig.torque_on()
    rig.send((1.0, (0.3, 0.5, 1.2)))
    rig.until(lambda report: rig.references()[0] > -0.4)
    cut = rig.references()
    rig.send()
    rig.cycle()
    rig.cycle()
    held = rig.references()
    assert held == pytest.approx(cut, abs=0.1)
    rig.send((10.0, START))
    rig.cycle()
    assert rig.references() == pytest.approx(held, abs=0.02)


def test_effort_bounds_the_current_and_does_not_outlive_its_trajectory(rig: Rig) -> None:
    rig.torque_on()
    release = 2.8 * TORQUE_CONSTANT
    rig.send((0.0, START, (release, release, release)))
    rig.cycle()
    assert rig.bounds() == pytest.approx([2.8] * 3, abs=CURRENT_UNIT)
    rig.send()
    rig.cycle()
    assert rig.bounds() == pytest.approx([DEFAULT] * 3, abs=CURRENT_UNIT)
    rig.send((0.0, START, (0.3, 0.0, 0.3)))
    rig.cycle()
    assert rig.bounds() == pytest.approx([0.3 / TORQUE_CONSTANT, 0.0, 0.3 / TORQUE_CONSTANT], abs=CURRENT_UNIT)
    rig.send()
    rig.cycle()
    assert max(rig.bounds()) < 0.3  # a hold never raises the bound
    rig.send((0.0, START))
    rig.cycle()
    assert rig.bounds() == pytest.approx([DEFAULT] * 3, abs=CURRENT_UNIT)


def test_after_a_pause_of_the_host_the_arm_resumes_from_where_it_stopped(rig: Rig) -> None:
    rig.torque_on()
    rig.send((2.0, (0.3, 0.5, 1.2)))
    rig.until(lambda report: rig.references()[0] > -0.6)
    before = rig.controller.watchdog_trips  # a busy computer may have paused the host already
    time.sleep(0.2)  # the host's thread gets no processor
    rig.cycle()
    assert rig.controller.watchdog_trips == before + 1
    stopped = rig.arm.angles
    rig.cycle()
    assert rig.references() == pytest.approx(list(stopped), abs=0.05)
    assert rig.report.phase is ServoPhase.ON
    rig.until(lambda report: report.angle == pytest.approx((0.3, 0.5, 1.2), abs=3 * TICK))


def test_a_pause_after_the_end_does_not_move_the_arm(rig: Rig) -> None:
    rig.torque_on()
    rig.send((0.0, (0.3, 0.5, 1.2), (0.3, 0.3, 0.3)))
    rig.cycle()
    time.sleep(0.2)
    for _ in range(5):
        rig.cycle()
    assert rig.references() == pytest.approx(list(rig.arm.angles), abs=0.05)
    assert rig.references()[0] < 0.0


def test_repeated_pauses_of_the_host_stop_the_arm(rig: Rig) -> None:
    rig.torque_on()
    for _ in range(3):
        assert rig.report.phase is ServoPhase.ON
        time.sleep(0.2)
        rig.cycle()
    assert rig.report.phase is ServoPhase.STOPPING
    assert any("overloaded" in sentence for _, sentence in rig.events)


def test_a_pause_without_torque_is_not_reported(rig: Rig) -> None:
    rig.cycle()
    time.sleep(0.2)
    rig.cycle()
    assert rig.events == []
    rig.torque_on()
    goal = tuple(angle + 0.1 for angle in START)
    rig.send((0.0, goal))
    rig.cycle()
    assert rig.references() == pytest.approx(list(goal), abs=TICK)


def line(begin: Sequence[float], end: Sequence[float], seconds: float, at: float) -> tuple[float, ...]:
    """Return the angles `at` s along a straight line that lasts `seconds`."""
    share = min(max(at / seconds, 0.0), 1.0)
    return tuple(a + share * (b - a) for a, b in zip(begin, end, strict=True))


def test_a_line_sent_in_pieces_is_followed_like_one_message(rig: Rig) -> None:
    rig.torque_on()
    goal = tuple(angle + 0.5 for angle in START)
    begin = time.monotonic()
    errors = []

    def feed(report: ServoReport) -> bool:
        now = time.monotonic() - begin
        ahead = [now + step * 0.02 for step in range(1, 7)]
        points = [ServoWaypoint(at, line(START, goal, 0.6, at)) for at in ahead]
        rig.controller.submit(check(NAMES, points, LIMITS), begin)
        if report.phase is ServoPhase.ON and rig.references()[0] != pytest.approx(START[0]):
            errors.append(abs(rig.references()[0] - line(START, goal, 0.6, now)[0]))
        return now > 0.7

    rig.until(feed)
    assert len(errors) > 30
    late = 0.06 / 0.6 * 0.5  # the line's way in 60 ms: allows for a pause of this computer
    assert sorted(errors)[len(errors) // 2] < 0.02
    assert max(errors) < late
    assert rig.references() == pytest.approx(list(goal), abs=TICK)


def test_when_a_feed_ends_the_arm_holds_its_last_point(rig: Rig) -> None:
    rig.torque_on()
    goal = tuple(angle + 0.5 for angle in START)
    begin = time.monotonic()
    points = [ServoWaypoint(at, line(START, goal, 2.0, at)) for at in (0.04, 0.08, 0.12)]
    rig.controller.submit(check(NAMES, points, LIMITS), begin)
    rig.until(lambda report: time.monotonic() - begin > 0.5)
    assert rig.references() == pytest.approx(list(line(START, goal, 2.0, 0.12)), abs=TICK)


def test_a_piece_in_the_past_holds_at_its_last_point(rig: Rig) -> None:
    rig.torque_on()
    goal = tuple(angle + 0.05 for angle in START)
    rig.controller.submit(
        check(NAMES, [ServoWaypoint(0.1, START), ServoWaypoint(0.2, goal)], LIMITS), time.monotonic() - 0.3
    )
    rig.cycle()
    rig.cycle()
    assert rig.references() == pytest.approx(list(goal), abs=TICK)


def test_a_due_point_of_a_late_message_is_reached_at_once(rig: Rig) -> None:
    rig.torque_on()
    goal = tuple(angle + 0.05 for angle in START)
    rig.controller.submit(
        check(NAMES, [ServoWaypoint(0.0, goal), ServoWaypoint(2.0, goal)], LIMITS), time.monotonic() - 0.01
    )
    rig.cycle()
    assert rig.references() == pytest.approx(list(goal), abs=TICK)
