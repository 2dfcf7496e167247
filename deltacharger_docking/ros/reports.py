# SPDX-License-Identifier: Apache-2.0
"""Outputs of docking: its state at every change, its decisions, and diagnostics. Part of docking_node."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

from deltacharger.msg import DockingDecision, DockingState
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_core.quantity import quantity
from deltacharger_docking.codes import State
from deltacharger_docking.observation import Decision, DockingStatus, Observation
from deltacharger_docking.phase_log import PhaseLog, changes
from deltacharger_docking.ros.inputs import SOURCES
from deltacharger_docking.ros.refusals import Refusals
from deltacharger_ros.clock import before_now
from deltacharger_ros.diagnostics import ERROR, OK, WARN, Diagnostics
from deltacharger_ros.log import Log

_DECISIONS = 50  # depth: holds all decisions of a docking while a reader is busy
_DIAGNOSTICS = 1.0  # s


class Reports:
    """Publishes docking_state, docking_decision and /diagnostics, and logs.

    Args:
        node: publishes.
        log: of the node.
        ages_max: age (s) of servo_state, tactile_frame and charger_power from which diagnostics report ERROR.
        frame: full name of charger_base.
    """

    def __init__(self, node: Node, log: Log, ages_max: tuple[float, float, float], frame: str) -> None:
        self._frame = frame
        self._node = node
        self._ages_max = ages_max
        self._shown: DockingStatus | None = None
        self._diagnosed = -math.inf
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._state = node.create_publisher(DockingState, "docking_state", latched)
        self._decision = node.create_publisher(DockingDecision, "docking_decision", QoSProfile(depth=_DECISIONS))
        self._diagnostics = Diagnostics(node)
        self._log, self._phases = log, PhaseLog()

    def begin(self, title: str, wish: str) -> None:
        """Log that a goal was accepted, with its request as text."""
        self._phases.begin(title)
        self._log.info(f"{title}: accepted{wish and f', {wish}'}")

    def log(self, status: DockingStatus, passed: Sequence[State], observation: Observation) -> None:
        """Log changes: phases, failures, the contactor; a lost charge as a warning."""
        for line in self._phases.lines(status, passed, observation):
            (self._log.warning if line == self._phases.lost else self._log.info)(line)

    def show(self, status: DockingStatus, passed: Sequence[State] = (), force: bool = False) -> None:
        """Publish docking_state if it changed, once for each state passed through since the last call."""
        before = self._shown or DockingStatus()
        for state in changes(before.state, passed, status.state)[:-1]:
            self._publish(replace(status, state=state, docked=before.docked, charging=before.charging))
        if force or self._shown is None or _key(status) != _key(self._shown):
            self._publish(replace(status))

    def _publish(self, status: DockingStatus) -> None:
        self._shown = status
        message = DockingState(
            state=int(status.state),
            docked=status.docked,
            charging=status.charging,
            error_code=int(status.code),
            error_message=status.message,
            request_id=status.request_id,
            duplicate_sources=status.duplicate_sources,
        )
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
            message.header.stamp = before_now(self._node.get_clock(), time.monotonic() - decision.time)
            message.header.frame_id = self._frame
            self._decision.publish(message)

    def diagnose(self, status: DockingStatus, observation: Observation, slowest_tick: float, refused: Refusals) -> bool:
        """Publish /diagnostics once a second; return whether it did.

        Args:
            status: of the machine.
            observation: the latest.
            slowest_tick: s, since the last diagnostics.
            refused: refused messages so far.
        """
        if time.monotonic() - self._diagnosed <= _DIAGNOSTICS:
            return False
        self._diagnosed = time.monotonic()
        level, text = (WARN, observation.clock_problem) if observation.clock_problem else (OK, status.state.name)
        if status.code:
            level, text = WARN, f"{status.code.name}: {status.message}"
        if status.duplicate_sources:
            level, text = WARN, f"second source, so the contactor will not be closed: {status.duplicate_sources}"
        ages = observation.servo_age, observation.tactile_age, observation.power_age
        stale = [name for name, age, most in zip(SOURCES, ages, self._ages_max, strict=False) if age > most]
        if stale:
            level, text = ERROR, f"missing or stale: {', '.join(stale)}"
        entries = {
            "state": status.state.name,
            "docked": status.docked,
            "charging": status.charging,
            "contact_current": quantity(status.contact_current, ".3f", "A"),
            "servo_damping": ", ".join(quantity(value, ".2f", "N·m·s/rad") for value in status.dampings),
            "friction_force": quantity(status.friction_force, ".1f", "N"),
            "servo_age": _age(observation.servo_age),
            "tactile_age": _age(observation.tactile_age),
            "power_age": _age(observation.power_age),
            "slowest_tick": quantity(1000.0 * slowest_tick, ".1f", "ms"),
            "duplicate_sources": status.duplicate_sources,
            "clock_problem": observation.clock_problem,
            "refused_messages": refused.count,
            "refused_last": refused.last,
        }
        self._diagnostics.report(level, text, entries, "docking")
        return True


def _age(age: float) -> str:
    return "never received" if math.isinf(age) else quantity(age, ".3f", "s")


def _key(status: DockingStatus) -> tuple[object, ...]:
    values = (status.state, status.docked, status.charging, status.code, status.message, status.request_id)
    return *values, status.duplicate_sources
