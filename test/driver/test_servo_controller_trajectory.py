# SPDX-License-Identifier: Apache-2.0
"""Trajectories: followed in time, replaced, sent in pieces, and interrupted by pauses of the host."""

from __future__ import annotations

import pytest

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_driver.servos.mx64 import CURRENT_UNIT, TICK
from deltacharger_driver.servos.report import ServoPhase, ServoReport

from .servo_rig import DEFAULT, START, Rig

FAR = (0.3, 0.5, 1.2)


def shifted(by: float) -> tuple[float, ...]:
    return tuple(angle + by for angle in START)


def test_a_trajectory_is_followed_in_time_and_takes_effect_in_the_next_cycle(rig: Rig) -> None:
    rig.torque_on()
    rig.send((0.0, shifted(0.1)))
    rig.cycle()
    assert rig.references() == pytest.approx(list(shifted(0.1)), abs=TICK)
    begin = rig.clock()
    rig.send((0.5, START))
    middle = []

    def done(report: ServoReport) -> bool:
        middle.append(rig.references()[0])
        return rig.references() == pytest.approx(list(START), abs=TICK)

    rig.until(done)
    assert 0.45 <= rig.clock() - begin <= 1.5
    assert middle == sorted(middle, reverse=True)
    assert len(set(middle)) > 15


def test_a_new_trajectory_starts_at_the_goal_where_the_old_one_was_cut(rig: Rig) -> None:
    rig.torque_on()
    rig.send((1.0, FAR))
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
    for rows, bounds in (
        ([(0.0, START, (2.8 * TORQUE_CONSTANT,) * 3)], [2.8] * 3),
        ([], [DEFAULT] * 3),
        ([(0.0, START, (0.3, 0.0, 0.3))], [0.3 / TORQUE_CONSTANT, 0.0, 0.3 / TORQUE_CONSTANT]),
        ([], [0.3 / TORQUE_CONSTANT, 0.0, 0.3 / TORQUE_CONSTANT]),  # a hold never raises the bound
        ([(0.0, START)], [DEFAULT] * 3),
    ):
        rig.send(*rows)
        rig.cycle()
        assert rig.bounds() == pytest.approx(bounds, abs=CURRENT_UNIT)


def test_after_a_pause_of_the_host_the_arm_resumes_from_where_it_stopped(rig: Rig) -> None:
    rig.torque_on()
    rig.send((1.0, FAR))
    rig.until(lambda report: rig.references()[0] > -0.6)
    before = rig.controller.watchdog_trips  # a busy computer may have paused the host already
    rig.pause()
    rig.cycle()
    assert rig.controller.watchdog_trips == before + 1
    stopped = rig.arm.angles
    rig.cycle()
    assert rig.references() == pytest.approx(list(stopped), abs=0.05)
    assert rig.report.phase is ServoPhase.ON
    rig.until(lambda report: report.angle == pytest.approx(FAR, abs=3 * TICK))


def test_a_pause_after_the_end_does_not_move_the_arm(rig: Rig) -> None:
    rig.torque_on()
    rig.send((0.0, FAR, (0.3, 0.3, 0.3)))
    rig.cycle()
    rig.pause()
    for _ in range(5):
        rig.cycle()
    assert rig.references() == pytest.approx(list(rig.arm.angles), abs=0.05)
    assert rig.references()[0] < 0.0


def test_repeated_pauses_of_the_host_stop_the_arm(rig: Rig) -> None:
    rig.torque_on()
    for _ in range(3):
        assert rig.report.phase is ServoPhase.ON
        rig.pause()
        rig.cycle()
    assert rig.report.phase is ServoPhase.STOPPING
    assert any("overloaded" in sentence for _, sentence in rig.events)


def test_a_line_sent_in_pieces_is_followed_like_one_message_and_its_end_is_held(rig: Rig) -> None:
    rig.torque_on()
    begin = rig.clock()
    errors = []

    def line(at: float) -> float:
        return 0.5 * min(max(at / 0.6, 0.0), 1.0)

    def feed(report: ServoReport) -> bool:
        now = rig.clock() - begin
        rig.send(*((now + 0.02 * step, shifted(line(now + 0.02 * step))) for step in range(1, 7)), start=begin)
        if report.phase is ServoPhase.ON and rig.references()[0] != pytest.approx(START[0]):
            errors.append(abs(rig.references()[0] - START[0] - line(now)))
        return now > 0.5

    rig.until(feed)
    assert len(errors) > 20
    assert sorted(errors)[len(errors) // 2] < 0.02
    assert max(errors) < 0.06 / 0.6 * 0.5  # the line's way in 60 ms: allows for a pause of this computer
    rig.until(lambda report: rig.clock() - begin > 1.0)  # the feed has ended
    assert rig.references() == pytest.approx(list(shifted(0.5)), abs=TICK)


@pytest.mark.parametrize(("times", "late"), [((0.1, 0.2), 0.3), ((0.0, 2.0), 0.01)], ids=["all past", "one due"])
def test_a_point_in_the_past_is_reached_at_once(rig: Rig, times: tuple[float, float], late: float) -> None:
    rig.torque_on()
    first = START if late > times[1] else shifted(0.05)
    rig.send((times[0], first), (times[1], shifted(0.05)), start=rig.clock() - late)
    rig.cycle()
    rig.cycle()
    assert rig.references() == pytest.approx(list(shifted(0.05)), abs=TICK)
