# SPDX-License-Identifier: Apache-2.0
"""What the driver makes of every fault of emulated servos, in virtual time."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from deltacharger_driver.servos import bus, controller
from deltacharger_sim.charger.faults import Fault, Faults, Hardware

from ..sim.fault_table import LEASE, SERVO_ROWS, Row
from .servo_rig import Rig


@pytest.mark.parametrize("row", SERVO_ROWS, ids=lambda row: row.name)
def test_every_fault_stops_a_moving_arm_by_its_rules_or_is_borne(rig: Rig, row: Row) -> None:
    """In virtual time: the contactor is asked to open in time and before torque goes, and nothing returns by itself."""
    rig.emulator.line_speed = rig.line.speed
    cable: Any = SimpleNamespace(unplug=rig.line.stop, replug=rig.line.start)
    faults = Faults((), Hardware(rig.emulator, cable, cable, cable, cable), rig.clock)
    told: list[str] = []

    def until(condition: Callable[[bus.ServoReport], object]) -> None:
        def watch(report: bus.ServoReport) -> object:
            _, message, found = controller.bus_entry(report, rig.controller)
            told.append(f"{message} {report.faults}")
            values.update(found)
            return condition(report)

        rig.until(watch)

    values: dict[str, Any] = {}
    rig.torque_on()
    rig.send((6.0, (0.3, 0.5, 1.2)))
    until(lambda report: rig.references()[0] > -0.6)
    began, count = rig.clock(), int(values.get(row.counted, 0))
    faults.begin_fault(Fault(kind=row.kind, servo=row.servo, amount=row.amount))
    if not row.torque_off:
        before = rig.references()[0]
        until(lambda report: rig.clock() > began + 2.0)
        assert rig.report.phase is bus.ServoPhase.ON
        assert rig.references()[0] > before + 0.1, "the motion goes on"
        assert not rig.requests
        assert not row.counted or int(values[row.counted]) > count
        return
    until(lambda report: rig.requests)
    noticed = row.opens - LEASE if row.opens > LEASE else row.opens
    assert rig.requests[0] - began <= noticed + 0.05
    for servo in row.unknown:
        until(lambda report, servo=servo: math.isnan(report.angle[servo - 1]))  # type: ignore[misc]
    until(lambda report: report.phase in (bus.ServoPhase.OFF, bus.ServoPhase.DISCONNECTED))
    for servo, on in enumerate(rig.torque_when_opened or [], 1):  # unknown if nothing answers any more
        assert on or servo in row.at_once
    assert not any(on for servo, on in enumerate(rig.arm.torque_enabled(), 1) if servo not in row.deaf)
    warning = [word.replace("/servo", rig.line.path) for word in row.warning]
    assert any(all(word in each for word in warning) for each in told), told[-3:]
    faults.clear()
    until(lambda report: all(report.valid) and not any(rig.arm.torque_enabled()))
    for _ in range(50):
        assert rig.cycle().phase is bus.ServoPhase.OFF
        assert not any(rig.arm.torque_enabled()), "torque does not return by itself"
    if row.recovery:
        assert not rig.ask("torque_on").success
        assert rig.ask("reboot").success
    rig.torque_on()
