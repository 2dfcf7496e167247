# SPDX-License-Identifier: Apache-2.0
"""Outputs of docking: its state at every change, its decisions, its log, and diagnostics. Part of docking_node."""

import math
import time
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

from deltacharger.msg import DockingDecision, DockingState
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_core.ros import clock, diagnostics
from deltacharger_core.ros.log import Log
from deltacharger_core.texts import figure, passage, quantity
from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import Decision, DockingStatus, Observation
from deltacharger_docking.ros.inputs import SOURCES, Heard

_DECISIONS = 50  # depth: holds all decisions of a docking while a reader is busy
_DIAGNOSTICS = 1.0  # s


class Reports:
    """Publishes docking_state, docking_decision and /diagnostics, and logs.

    Args:
        node: publishes.
        log: of the node.
        age_max: age (s) of data from which diagnostics report ERROR.
        frame: full name of charger_base.
    """

    def __init__(self, node: Node, log: Log, age_max: float, frame: str) -> None:
        self._frame = frame
        self._node = node
        self._age_max = age_max
        self._shown: dict[str, Any] = {}
        self._diagnosed = -math.inf
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._state = node.create_publisher(DockingState, "docking_state", latched)
        self._decision = node.create_publisher(DockingDecision, "docking_decision", QoSProfile(depth=_DECISIONS))
        self._diagnostics = diagnostics.Diagnostics(node)
        self._log, self.phases = log, PhaseLog(log, State.IDLE)
        self._closed, self._closed_since = False, math.nan

    def log(self, status: DockingStatus, seen: Observation) -> None:
        """Log changes: phases, failures, the contactor."""
        if seen.contactor_closed and not self._closed:
            self._closed_since = seen.time
            self._log.info(f"contactor closed, target {figure(seen.target_voltage, 'V', 1)}")
        elif self._closed and not seen.contactor_closed:
            self._log.info(f"contactor open, it was closed for {seen.time - self._closed_since:.1f} s")
        self._closed = seen.contactor_closed
        entered = [] if status.state is self.phases.phase else [status.state]
        self.phases.show(status, entered, seen.time, *(_figures(status, seen) if entered else ()))

    def show(self, status: DockingStatus, force: bool = False) -> None:
        """Publish docking_state if it changed."""
        values = {name: getattr(status, name) for name in ("docked", "charging", "request_id", "duplicate_sources")}
        values |= {"state": int(status.state), "error_code": int(status.code), "error_message": status.message}
        if values == self._shown and not force:
            return
        self._shown, message = values, DockingState(**values)
        message.header.stamp, message.header.frame_id = self._node.get_clock().now().to_msg(), self._frame
        self._state.publish(message)

    def decided(self, decisions: Sequence[Decision], request_id: str) -> None:
        """Publish decisions; the stamp is the observation's time on the host clock."""
        for decision in decisions:
            message = DockingDecision(
                request_id=request_id,
                state=int(decision.state),
                kind=decision.kind,
                text=decision.text,
                names=[name for name, _ in decision.values],
                values=[float(value) for _, value in decision.values],
            )
            message.header.stamp = clock.before_now(self._node.get_clock(), time.monotonic() - decision.time)
            message.header.frame_id = self._frame
            self._decision.publish(message)

    def diagnose(self, status: DockingStatus, observation: Observation, heard: Heard) -> None:
        """Publish /diagnostics once a second; `heard` knows the refused messages."""
        if time.monotonic() - self._diagnosed <= _DIAGNOSTICS:
            return
        self._diagnosed = time.monotonic()
        level, text = (
            (diagnostics.WARN, observation.clock_problem)
            if observation.clock_problem
            else (diagnostics.OK, status.state.name)
        )
        if status.code:
            level, text = diagnostics.WARN, f"{status.code.name}: {status.message}"
        if status.duplicate_sources:
            level, text = (
                diagnostics.WARN,
                f"second source, so the contactor will not be closed: {status.duplicate_sources}",
            )
        ages = observation.servo_age, observation.tactile_age, observation.power_age
        stale = [name for name, age in zip(SOURCES, ages, strict=False) if age > self._age_max]
        if stale:
            level, text = diagnostics.ERROR, f"missing or stale: {', '.join(stale)}"
        entries = {
            "state": status.state.name,
            "docked": status.docked,
            "charging": status.charging,
            "contact_current": quantity(status.contact_current, ".3f", "A"),
            **dict(zip(("servo_age", "tactile_age", "power_age"), map(_age, ages), strict=True)),
            "duplicate_sources": status.duplicate_sources,
            "clock_problem": observation.clock_problem,
            "refused_messages": heard.refused,
            "refused_last": heard.last_refusal,
        }
        self._diagnostics.report(level, text, entries, "docking")


def _age(age: float) -> str:
    return "never received" if math.isinf(age) else quantity(age, ".3f", "s")


class PhaseLog:
    """Logs each phase that a machine enters, and each failure as a warning, under the title of the last goal.

    Attributes:
        phase: the last one logged; how long the first of all phases lasts is not told.
    """

    def __init__(self, log: Log, phase: IntEnum) -> None:
        self._log, self._title = log, ""
        self.phase, self._since, self._code = phase, math.nan, Code.NONE

    def begin_goal(self, title: str, wish: str = "") -> None:
        """Log that a goal was accepted, with its request as text."""
        self._title, self._code = title, Code.NONE
        self._log.info(f"{title}: accepted{wish and f', {wish}'}")

    def show(self, status: Any, entered: Sequence[IntEnum], now: float, *figures: str) -> None:
        """Log the phases entered since the last call, with figures at `now` (s), and a new failure."""
        for phase in entered:
            self._log.info(passage(self._title, self.phase.name, phase.name, now - self._since, *figures))
            self.phase, self._since = phase, now if phase else math.nan
        failed, self._code = status.code and status.code is not self._code, status.code
        if failed:
            tell = self._log.info if status.code is Code.CANCELED else self._log.warning
            tell(f"{self._title}: {int(status.code)} {status.code.name}: {status.message}")


def _figures(status: DockingStatus, seen: Observation) -> list[str]:
    """Return the present measurements as text, without unknown ones."""
    values = (
        ("z", 1e3 * status.position[2], "mm", 1),
        ("contact current", status.contact_current, "A", 3),
        ("force", status.contact_force, "N", 1),
        ("charge current", seen.charge_current if seen.contactor_closed else math.nan, "A", 2),
    )
    return [f"{name} {figure(value, unit, digits)}" for name, value, unit, digits in values if math.isfinite(value)]
