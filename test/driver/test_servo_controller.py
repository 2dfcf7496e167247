# SPDX-License-Identifier: Apache-2.0
"""The servo controller: torque, trajectories, stops on faults, and the contactor that opens before torque goes off."""

import math
from collections.abc import Callable

import pytest

from deltacharger_core import machine, servo_types
from deltacharger_driver.errors import TrajectoryRefused
from deltacharger_driver.servos import bus, controller, registers

from ..waiting import host
from .servo_rig import DEFAULT, START, Rig

FAR = (0.3, 0.5, 1.2)


def moving(rig: Rig) -> None:
    """Torque on, and a line under way."""
    rig.torque_on()
    rig.send((2.0, FAR))
    rig.until(lambda report: rig.references()[0] > -0.6)


def test_torque_on_holds_and_off_releases(rig: Rig) -> None:
    rig.torque_on()
    rig.cycle()
    assert rig.arm.torque_enabled() == [True] * 3
    assert rig.references() == pytest.approx(list(START), abs=registers.TICK)
    assert rig.ask("torque_on").success
    assert rig.ask("torque_off").success
    assert rig.arm.torque_enabled() == [False] * 3
    assert rig.cycle().phase is bus.ServoPhase.OFF


def test_an_order_that_waited_too_long_is_refused_with_its_age(rig: Rig) -> None:
    rig.torque_on()
    for action in ("torque_off", "reboot"):
        late = rig.controller.request(action, age=2.3)
        rig.cycle()
        assert late.wait(0.0)
        assert not late.success
        assert "2.3 s ago" in late.message
    assert rig.arm.torque_enabled() == [True] * 3
    waits = rig.controller.request("torque_off", age=0.5)
    rig.cycle()
    assert waits.wait(0.0)
    assert waits.success


def test_a_single_lost_reply_does_not_stop_and_keeps_the_last_values(rig: Rig) -> None:
    rig.torque_on()
    before = rig.cycle()
    rig.emulator.faults.inject("drop", 2, 1)
    for _ in range(2):
        report = rig.cycle()
        assert report.valid == (False, True, True)
        assert report.angle[0] == before.angle[0]
    assert rig.cycle().valid == (True, True, True)
    rig.emulator.faults.missing = {1}
    reports = [rig.cycle() for _ in range(3)]
    assert [math.isnan(report.angle[0]) for report in reports] == [False, False, True]
    assert math.isnan(reports[2].voltage[0])
    assert reports[2].torque_enabled[0]  # the last known


def test_reboot_is_refused_with_torque_and_while_the_cause_persists(rig: Rig) -> None:
    rig.torque_on()
    assert not rig.ask("reboot").success
    rig.arm.temperature[0] = 85.0
    rig.until(lambda report: report.hardware_error[0] and report.phase is bus.ServoPhase.OFF)
    request = rig.ask("reboot")
    assert not request.success
    assert "overheating" in request.message


def test_closing_opens_the_contactor_and_switches_torque_off_whatever_happens(rig: Rig) -> None:
    rig.delay = 0.1
    rig.torque_on()
    pending = rig.controller.request("reboot")
    rig.controller.close()
    rig.controller.close()
    assert rig.torque_when_opened == [True] * 3
    assert rig.arm.torque_enabled() == [False] * 3
    assert pending.wait(0.0)
    assert not pending.success


def test_torque_goes_off_once_the_contactor_is_open_and_not_before(rig: Rig) -> None:
    rig.delay = 0.15
    moving(rig)
    begin = rig.clock()
    request = rig.controller.request("torque_off")
    rig.cycle()
    held = rig.references()
    with pytest.raises(TrajectoryRefused):
        rig.send((1.0, START))
    rig.until(lambda report: request.wait(0.0))
    assert request.success
    assert "contactor" not in request.message
    assert rig.torque_when_opened == [True] * 3
    assert rig.references() == held
    assert rig.arm.torque_enabled() == [False] * 3
    assert rig.clock() - begin >= 0.15
    assert not any(severity in ("error", "warning") for severity, _ in rig.events)


def test_a_contactor_that_stays_closed_does_not_keep_the_torque_on(rig: Rig) -> None:
    rig.delay = math.inf
    rig.torque_on()
    begin = rig.clock()
    request = rig.ask("torque_off")
    assert request.success
    assert "contactor" in request.message
    assert rig.clock() - begin >= controller.OPENING_TIME
    assert rig.arm.torque_enabled() == [False] * 3
    assert any(severity == "warning" for severity, _ in rig.events)


def shifted(by: float) -> tuple[float, ...]:
    return tuple(angle + by for angle in START)


def test_effort_bounds_the_current_and_does_not_outlive_its_trajectory(rig: Rig) -> None:
    rig.torque_on()
    for rows, bounds in (
        ([(0.0, START, (2.8 * machine.TORQUE_CONSTANT,) * 3)], [2.8] * 3),
        ([], [DEFAULT] * 3),
        ([(0.0, START, (0.3, 0.0, 0.3))], [0.3 / machine.TORQUE_CONSTANT, 0.0, 0.3 / machine.TORQUE_CONSTANT]),
        ([], [0.3 / machine.TORQUE_CONSTANT, 0.0, 0.3 / machine.TORQUE_CONSTANT]),  # a hold never raises the bound
        ([(0.0, START)], [DEFAULT] * 3),
    ):
        rig.send(*rows)
        rig.cycle()
        assert rig.bounds() == pytest.approx(bounds, abs=servo_types.MX_64.current_unit)


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
    assert rig.report.phase is bus.ServoPhase.ON
    rig.until(lambda report: report.angle == pytest.approx(FAR, abs=3 * registers.TICK))


def test_repeated_pauses_of_the_host_stop_the_arm(rig: Rig) -> None:
    rig.torque_on()
    for _ in range(3):
        assert rig.report.phase is bus.ServoPhase.ON
        rig.pause()
        rig.cycle()
    assert rig.report.phase is bus.ServoPhase.STOPPING
    assert any("overloaded" in sentence for _, sentence in rig.events)


def test_a_line_sent_in_pieces_is_followed_like_one_message_and_its_end_is_held(rig: Rig) -> None:
    rig.torque_on()
    begin = rig.clock()
    errors = []

    def line(at: float) -> float:
        return 0.5 * min(max(at / 0.6, 0.0), 1.0)

    def feed(report: bus.ServoReport) -> bool:
        now = rig.clock() - begin
        rig.send(*((now + 0.02 * step, shifted(line(now + 0.02 * step))) for step in range(1, 7)), start=begin)
        if report.phase is bus.ServoPhase.ON and rig.references()[0] != pytest.approx(START[0]):
            errors.append(abs(rig.references()[0] - START[0] - line(now)))
        return now > 0.5

    rig.until(feed)
    assert len(errors) > 20
    assert sorted(errors)[len(errors) // 2] < 0.02
    assert max(errors) < host(0.06) / 0.6 * 0.5  # the line's way during a pause of this computer
    rig.until(lambda report: rig.clock() - begin > 1.0)  # the feed has ended
    assert rig.references() == pytest.approx(list(shifted(0.5)), abs=registers.TICK)


@pytest.mark.parametrize(("times", "late"), [((0.1, 0.2), 0.3), ((0.0, 2.0), 0.01)], ids=["all past", "one due"])
def test_a_point_in_the_past_is_reached_at_once(rig: Rig, times: tuple[float, float], late: float) -> None:
    rig.torque_on()
    first = START if late > times[1] else shifted(0.05)
    rig.send((times[0], first), (times[1], shifted(0.05)), start=rig.clock() - late)
    rig.cycle()
    rig.cycle()
    assert rig.references() == pytest.approx(list(shifted(0.05)), abs=registers.TICK)


def keep_place(rig: Rig) -> None:
    """Servo 2 no longer hears its goals."""
    command, arm = rig.arm.command_servo, rig.arm
    held = arm.angles[1]

    def deaf(index: int, on: bool, goal: float, *more: float) -> None:
        command(index, on, held if index == 1 else goal, *more)

    rig.arm.command_servo = deaf  # type: ignore[method-assign]


def block(rig: Rig) -> None:
    """What servo 2 pushes against is as strong as its bound."""
    rig.arm._step = lambda index, step=rig.arm._step: None if index == 1 else step(index)  # type: ignore[method-assign]
    rig.arm._current[1] = DEFAULT


@pytest.mark.parametrize("fail", [keep_place, block])
def test_a_servo_that_stays_behind_stops_the_arm_whatever_its_current(rig: Rig, fail: Callable[[Rig], None]) -> None:
    rig.torque_on()
    fail(rig)
    began = rig.clock()
    rig.send((0.6, FAR))
    rig.until(lambda report: report.phase is bus.ServoPhase.STOPPING)
    assert "servo 2 is farther from its goal" in rig.controller.stop_reason
    assert rig.clock() - began < 0.4
    others = [abs(angle - start) for angle, start in zip(rig.arm.angles, START, strict=True) if start != START[1]]
    assert max(others) < 0.6, "nor does it drive the others on"
    rig.until(lambda report: report.phase is bus.ServoPhase.OFF)


def test_a_trajectory_faster_than_the_joints_is_refused(rig: Rig) -> None:
    rig.torque_on()
    with pytest.raises(TrajectoryRefused, match=r"joint 0 would turn by 1\.90 rad"):
        rig.send((0.0, (1.2, *START[1:])))
    rig.send((0.0, shifted(0.5)))
    rig.cycle()
    with pytest.raises(TrajectoryRefused):  # nor may it jump again and again
        rig.send((0.0, shifted(1.0)))
    rig.send((0.3, shifted(1.0)))
    rig.until(lambda report: report.angle == pytest.approx(shifted(1.0), abs=3 * registers.TICK))
