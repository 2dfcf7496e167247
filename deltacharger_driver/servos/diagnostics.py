# SPDX-License-Identifier: Apache-2.0
"""The servos' state as entries of /diagnostics. No ROS."""

from __future__ import annotations

from dataclasses import asdict
from typing import NamedTuple

from deltacharger_core.quantity import quantity
from deltacharger_driver.servos.controller import ServoController
from deltacharger_driver.servos.mx64 import describe_hardware_error
from deltacharger_driver.servos.report import ServoPhase, ServoReport

OK, WARN, ERROR = b"\0", b"\1", b"\2"
"""Levels of diagnostic_msgs/DiagnosticStatus."""

_HOT = 70.0  # °C, ten below the servo's own limit
_LITTLE_RESERVE = 60.0  # s


class DiagnosticEntry(NamedTuple):
    """One status.

    Attributes:
        level: OK, WARN or ERROR.
        message: one sentence.
        values: further values.
        part: name of the device or bus.
    """

    level: bytes
    message: str
    values: dict[str, object]
    part: str


class RefusedTrajectories(NamedTuple):
    """Trajectories that were refused.

    Attributes:
        now: since the last diagnostic.
        total: since the start.
        forbidden: of the total, those forbidden by the state of the contactor.
        last: reason of the last refusal.
        by: senders of those forbidden since the last diagnostic.
    """

    now: int
    total: int
    forbidden: int
    last: str
    by: str


def bus_entry(
    report: ServoReport,
    controller: ServoController,
    contactor: str,
    refusals: RefusedTrajectories,
    rate: float,
    late: int,
) -> DiagnosticEntry:
    """Return the state of the bus.

    Args:
        report: of the last cycle.
        controller: for its counters.
        contactor: its known state.
        refusals: of trajectories.
        rate: cycles per second since the last diagnostic, Hz.
        late: number of late cycles since the start.
    """
    settings = controller.bus.settings
    values: dict[str, object] = {
        "state": report.phase.value,
        "baud_rate": settings.baud_rate,
        "ids": list(settings.ids),
        "rate": quantity(rate, ".1f", "Hz"),
        "late_cycles": late,
        **asdict(controller.bus.counters),
        "watchdog_trips": controller.watchdog_trips,
        "reconnections": controller.reconnections,
        "contactor": contactor,
        "refused_trajectories": refusals.total,
        "forbidden_trajectories": refusals.forbidden,
        "last_refusal": refusals.last,
    }
    if report.faults:
        level, message = ERROR, "; ".join(report.faults)
    elif report.phase is ServoPhase.STOPPING:
        level, message = WARN if controller.is_releasing else ERROR, controller.stop_reason
    elif refusals.now:
        level, message = WARN, f"{refusals.last}{f'; sent by {refusals.by}' if refusals.by else ''}"
    elif report.phase is ServoPhase.OFF and controller.unrequested_stop:
        level, message = WARN, f"torque off: {controller.unrequested_stop}"
    else:
        level, message = OK, report.phase.value
    return DiagnosticEntry(level, message, values, "servo bus")


def servo_entry(report: ServoReport, index: int, servo: int, joint: str) -> DiagnosticEntry:
    """Return the state of one servo."""
    values: dict[str, object] = {
        "joint": joint,
        "id": servo,
        "angle": quantity(report.angle[index], ".4f", "rad"),
        "current": quantity(report.current[index], ".3f", "A"),
        "voltage": quantity(report.voltage[index], ".1f", "V"),
        "temperature": quantity(report.temperature[index], ".0f", "°C"),
        "thermal_reserve": quantity(report.thermal_reserve[index], ".0f", "s"),
        "torque_enabled": report.torque_enabled[index],
    }
    errors = describe_hardware_error(report.hardware_error[index])
    level, message = OK, "OK"
    if errors:
        level, message = ERROR, f"latched: {errors}"
    elif not report.valid[index]:
        level, message = ERROR, "no good reply; check its supply and cable"
    elif report.temperature[index] >= _HOT:
        level, message = WARN, f"hot: {report.temperature[index]:.0f} °C"
    elif report.thermal_reserve[index] <= 0.0:
        level, message = ERROR, "the winding has reached its thermal limit; let it rest"
    elif report.thermal_reserve[index] < _LITTLE_RESERVE:
        level, message = WARN, f"thermal limit in {report.thermal_reserve[index]:.0f} s at this current"
    return DiagnosticEntry(level, message, values, f"servo {servo}")
