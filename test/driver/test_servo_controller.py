# SPDX-License-Identifier: Apache-2.0
"""The servo controller: torque, stops on faults, recovery, and the contactor that opens before torque goes off."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from deltacharger_core.machine import POSITION_P_GAIN, TORQUE_CONSTANT
from deltacharger_driver.errors import TrajectoryRefused
from deltacharger_driver.servos.controller import OPENING_TIME, STOP_TIME
from deltacharger_driver.servos.mx64 import TICK
from deltacharger_driver.servos.report import ServoPhase

from .servo_rig import OVERLOAD, START, Rig

FAR = (0.3, 0.5, 1.2)


def moving(rig: Rig) -> None:
    """Torque on, and a line under way."""
    rig.torque_on()
    rig.send((2.0, FAR))
    rig.until(lambda report: rig.references()[0] > -0.6)


def test_it_starts_without_torque_and_reports_everything(rig: Rig) -> None:
    report = rig.cycle()
    assert report.phase is ServoPhase.OFF
    assert report.valid == (True, True, True)
    assert report.angle == pytest.approx(START, abs=TICK)
    assert report.thermal_reserve == (math.inf,) * 3
    assert report.faults == ()
    assert rig.arm.torque_enabled() == [False] * 3


def test_torque_on_holds_and_off_releases(rig: Rig) -> None:
    rig.torque_on()
    rig.cycle()
    assert rig.arm.torque_enabled() == [True] * 3
    assert rig.references() == pytest.approx(list(START), abs=TICK)
    assert rig.ask("torque_on").success
    assert rig.ask("torque_off").success
    assert rig.arm.torque_enabled() == [False] * 3
    assert rig.cycle().phase is ServoPhase.OFF


def test_a_load_shows_as_current_and_as_reserve(rig: Rig) -> None:
    rig.torque_on()
    rig.send((0.0, START, (4.0, 4.0, 4.0)))
    rig.arm.load[1] = -2.0 * TORQUE_CONSTANT
    report = rig.until(lambda report: report.thermal_reserve[1] < 400 and report)
    assert report.current[1] == pytest.approx(2.0, abs=0.1)
    assert report.thermal_reserve[0] == math.inf


@pytest.mark.parametrize(
    ("fail", "reason"),
    [
        (lambda rig: rig.emulator.faults.missing.add(2), "servo 2 does not answer"),
        (lambda rig: rig.emulator.raise_hardware_error(2, OVERLOAD), "overload"),
        (lambda rig: rig.emulator.reboot(2, rig.clock()), "servo 2"),
        (lambda rig: rig.arm.temperature.__setitem__(1, 85.0), "overheating"),
        (lambda rig: rig.arm.voltage.__setitem__(1, 9.0), "voltage"),
    ],
    ids=["missing", "overload", "restarted", "hot", "weak"],
)
def test_a_fault_of_one_servo_stops_all(rig: Rig, fail: Callable[[Rig], object], reason: str) -> None:
    moving(rig)
    assert not rig.requests
    fail(rig)
    rig.until(lambda report: report.phase is ServoPhase.STOPPING)
    assert rig.requests  # at once, not only when torque goes off
    begin = rig.clock()
    stopped = rig.references()[0]
    assert stopped == pytest.approx(rig.arm.angles[0], abs=0.1)
    assert rig.arm.torque_enabled()[0]
    with pytest.raises(TrajectoryRefused):
        rig.send((1.0, START))
    assert not rig.ask("torque_on").success
    rig.until(lambda report: report.phase is ServoPhase.OFF)
    assert STOP_TIME - 0.1 <= rig.clock() - begin <= STOP_TIME + 0.5
    assert rig.references()[0] == stopped
    assert rig.arm.torque_enabled()[0] is rig.arm.torque_enabled()[2] is False
    assert any(severity == "error" and reason in sentence for severity, sentence in rig.events)


def test_a_single_lost_reply_does_not_stop_and_keeps_the_last_values(rig: Rig) -> None:
    rig.torque_on()
    before = rig.cycle()
    rig.emulator.faults.next_reply("drop", 1, 2)
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


def test_reboot_is_by_request_only_and_leaves_torque_off(rig: Rig) -> None:
    rig.torque_on()
    assert not rig.ask("reboot").success
    rig.emulator.raise_hardware_error(1, OVERLOAD)
    rig.until(lambda report: report.phase is ServoPhase.OFF)
    assert not rig.ask("torque_on").success
    assert rig.cycle().hardware_error[0] == OVERLOAD
    request = rig.ask("reboot")
    assert request.success, request.message
    report = rig.until(lambda report: all(report.valid) and report)
    assert report.hardware_error == (0, 0, 0)
    assert rig.arm.torque_enabled() == [False] * 3
    rig.torque_on()


def test_a_persisting_cause_is_reported(rig: Rig) -> None:
    rig.arm.temperature[0] = 85.0
    rig.until(lambda report: report.hardware_error[0])
    request = rig.ask("reboot")
    assert not request.success
    assert "overheating" in request.message


def test_a_servo_that_restarts_on_its_own_is_configured_again_without_torque(rig: Rig) -> None:
    rig.emulator.reboot(3, rig.clock())
    rig.until(lambda report: not report.valid[2])
    rig.until(lambda report: all(report.valid))
    assert rig.emulator.servo(3).table.get("bus_watchdog") == 6
    assert rig.emulator.servo(3).table.get("position_p_gain") == POSITION_P_GAIN
    assert rig.arm.torque_enabled() == [False] * 3
    assert any("servo 3" in sentence for _, sentence in rig.events)


def test_a_vanished_port_opens_the_contactor_and_is_back_soon_after_its_return(rig: Rig) -> None:
    rig.torque_on()
    rig.line.stop()
    report = rig.until(lambda report: report.phase is ServoPhase.DISCONNECTED and report)
    assert len(rig.requests) == 1
    assert not any(report.valid)
    assert all(map(math.isnan, report.angle))
    assert not rig.ask("torque_on").success
    away = rig.clock() + 2.0  # longer than the longest pause between two attempts
    report = rig.until(lambda report: rig.clock() > away and report)
    assert "no such port" in report.faults[0]
    begin = rig.clock()
    rig.line.start()
    rig.until(lambda report: report.phase is ServoPhase.OFF and all(report.valid))
    assert rig.clock() - begin < 2.0
    assert rig.controller.reconnections == 1
    assert rig.arm.torque_enabled() == [False] * 3
    rig.torque_on()


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
    assert rig.clock() - begin >= OPENING_TIME
    assert rig.arm.torque_enabled() == [False] * 3
    assert any(severity == "warning" for severity, _ in rig.events)


def test_torque_off_by_request_cuts_a_stop_short_once_the_contactor_is_open(rig: Rig) -> None:
    rig.torque_on()
    rig.controller.stop("a test")
    begin = rig.clock()
    assert rig.ask("torque_off").success
    assert rig.clock() - begin < STOP_TIME
    assert rig.cycle().phase is ServoPhase.OFF
