# SPDX-License-Identifier: Apache-2.0
"""ROS input and output of servo_node's bus thread, without the executor's cost."""

from __future__ import annotations

import contextlib
import math
import time
from array import array
from collections.abc import Callable
from typing import Any

from deltacharger.msg import ChargerPower, ServoState
from deltacharger.srv import SetContactor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import JointState

from deltacharger_core.host_clock import AHEAD
from deltacharger_core.machine import JOINTS, ZERO_CURRENT
from deltacharger_driver.board.protocol import PROBE_LIFETIME
from deltacharger_driver.servos.motion_guard import ContactorState, MotionGuard
from deltacharger_driver.servos.report import ServoReport
from deltacharger_ros.clock import Stamps, stamp_age
from deltacharger_ros.on_demand import BoundedTopic
from deltacharger_ros.qos import SERVICE

KEPT = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=64, reliability=ReliabilityPolicy.RELIABLE)
"""charger_power and joint_trajectory: read in every cycle, so that a flood from one sender does not hide the others."""

_LISTENERS_EVERY = 10  # cycles between two checks for subscribers of joint_states
_HOLDER = "servo_node"  # anyone may open; the name only shows who did
_LARGEST_POWER = 1024  # bytes of a charger_power; a valid one has 80


class ContactorClient:
    """The contactor for `ServoController`, and the motion guard, over set_contactor and charger_power.

    Used by one thread.

    Args:
        node: the client; its executor takes the answers without a waiting thread.
        clock: s.

    Attributes:
        guard: decides who may move the arm.
    """

    def __init__(self, node: Node, clock: Callable[[], float] = time.monotonic) -> None:
        self.guard = MotionGuard()
        self._clock = clock
        self._node = node
        self._client: Any = node.create_client(SetContactor, "set_contactor", qos_profile=SERVICE)
        self._power = BoundedTopic(node, ChargerPower, "charger_power", KEPT)
        self._pending: Future[Any] | None = None
        self._requested_at = -math.inf  # s, of the last request to open
        self._open = True

    def request_open(self) -> None:
        """Request an opening if there is a server; returns at once."""
        with contextlib.suppress(RuntimeError):  # ROS is shutting down
            if self._pending is not None:
                self._client.remove_pending_request(self._pending)  # its server died: it would wait forever
                self._pending = None
            self._open = not self._client.service_is_ready()
            if not self._open:
                self._requested_at = self._clock()
                self._pending = self._client.call_async(SetContactor.Request(close=False, holder=_HOLDER))

    def is_open(self) -> bool:
        """Return whether it was measured open and without current after the last `request_open`, or has no server."""
        if not self._open:
            with contextlib.suppress(RuntimeError):
                self._read_power()
        return self._open

    def state(self) -> ContactorState:
        """Return its known state."""
        with contextlib.suppress(RuntimeError):  # ROS is shutting down
            self._read_power()
        announced = not self.guard.was_received and self._is_announced()
        return self.guard.state(self._clock(), announced)

    def _is_announced(self) -> bool:
        with contextlib.suppress(RuntimeError):
            return bool(self._client.service_is_ready() or self._node.count_publishers(self._power.name))
        return True

    def _read_power(self) -> None:
        received = self._power.take()
        if not received:
            return
        now, clock = self._clock(), self._node.get_clock()
        opened = False
        # The newest of each publisher; all messages if rclpy does not provide the publisher.
        for each in {one.publisher or one.data: one for one in received}.values():
            power = each.read() if len(each.data) <= _LARGEST_POWER else None
            if power is None:
                continue
            age = stamp_age(clock, power.header.stamp)
            current = abs(power.charge_current) >= ZERO_CURRENT  # NaN = not measured: the contactor alone decides
            live = power.contactor_closed or current or power.fault == ChargerPower.FAULT_CONTACTOR_WELDED
            opened |= not live and now - age > self._requested_at and age >= -AHEAD
            armed = power.probe_age < PROBE_LIFETIME  # whatever it found: limits may allow a close on a dead port
            self.guard.observe(each.publisher or self._nameless(live), live, armed, age, now)
        self._open |= opened and self.guard.state(now, False) is not ContactorState.CLOSED

    def _nameless(self, live: bool) -> bytes:
        """Return an id if rclpy provides none: with several publishers, reports of open and live are kept apart."""
        return b"live" if live and self._node.count_publishers(self._power.name) > 1 else b""


class StatePublishers:
    """Publishes servo_state and joint_states from reports.

    Args:
        node: the publisher.
        qos: of servo_state.
        torque_constant: N·m/A, for the efforts of joint_states.
        frame_id: full name of charger_base.
        joint_prefix: prefix of the names in joint_states.
    """

    def __init__(
        self, node: Node, qos: QoSProfile, torque_constant: float, frame_id: str, joint_prefix: str = ""
    ) -> None:
        self._torque_constant = torque_constant
        self._cycle = 0
        self._joints_wanted = False
        self._state = ServoState(name=list(JOINTS))
        self._joint = JointState(name=[f"{joint_prefix}{name}" for name in JOINTS])
        self._state.header.frame_id = self._joint.header.frame_id = frame_id
        self._stamps = Stamps(node.get_clock())
        self._states = node.create_publisher(ServoState, "servo_state", qos)
        self._joints = node.create_publisher(JointState, "joint_states", 10)

    def publish(self, report: ServoReport) -> None:
        """Publish the state after a cycle; joint_states only if all angles are known and it has subscribers."""
        state, stamp = self._state, self._stamps.at(report.time)
        state.header.stamp = stamp
        state.position, state.velocity = array("d", report.angle), array("d", report.velocity)
        state.current = array("d", report.current)
        state.voltage, state.temperature = array("f", report.voltage), array("f", report.temperature)
        state.hardware_error, state.stray = array("B", report.hardware_error), array("B", report.stray)
        state.torque_enabled, state.valid = list(report.torque_enabled), list(report.valid)
        state.thermal_reserve = array("f", report.thermal_reserve)
        self._states.publish(state)
        if self._cycle % _LISTENERS_EVERY == 0:
            self._joints_wanted = self._joints.get_subscription_count() > 0
        self._cycle += 1
        if self._joints_wanted and not math.isnan(sum(report.angle)):
            joint = self._joint
            joint.header.stamp, joint.position, joint.velocity = stamp, state.position, state.velocity
            joint.effort = array("d", [current * self._torque_constant for current in report.current])
            self._joints.publish(joint)
