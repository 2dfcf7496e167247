# SPDX-License-Identifier: Apache-2.0
"""What servo_node says to ROS and hears from it, without the executor's cost: for its bus thread."""

from __future__ import annotations

import contextlib
import math
from array import array
from typing import Any

from deltacharger.msg import ChargerPower, ServoState
from deltacharger.srv import SetContactor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_driver.servos.report import ServoReport
from deltacharger_driver.servos.trajectory import ServoWaypoint
from deltacharger_ros.flat_messages import FlatPublisher, Stamps
from deltacharger_ros.messages import seconds
from deltacharger_ros.on_demand import LatestMessage

_FRAME = "charger_base"
_STATE_FIELDS = (
    "position",
    "velocity",
    "current",
    "voltage",
    "temperature",
    "hardware_error",
    "torque_enabled",
    "valid",
    "thermal_reserve",
)
_LISTENERS_EVERY = 10  # cycles between two looks whether anybody listens to joint_states
_HOLDER = "servo_node"  # anyone may open; the name only says who did
_OPEN_CURRENT = 0.5  # A, below it a charge current counts as none (docs/docking.md)


class ContactorClient:
    """The contactor for `ServoController`, over set_contactor and charger_power. Used by one thread.

    Args:
        node: the client; its executor takes the answers, and nobody waits for them.
        qos: of charger_power.
    """

    def __init__(self, node: Node, qos: QoSProfile) -> None:
        self._node = node
        self._client: Any = node.create_client(SetContactor, "set_contactor")
        self._power = LatestMessage(node, ChargerPower, "charger_power", qos)
        self._pending: Future[Any] | None = None
        self._asked = 0  # ns, the node's clock; 0 where nobody was there to be asked
        self._open = True

    def ask_open(self) -> None:
        """Ask for an opening where somebody serves one; returns at once."""
        with contextlib.suppress(RuntimeError):  # ROS is shutting down
            if self._pending is not None:
                self._client.remove_pending_request(self._pending)  # its server died: it would wait for ever
                self._pending = None
            self._open = not self._client.service_is_ready()
            if not self._open:
                self._asked = self._node.get_clock().now().nanoseconds
                self._pending = self._client.call_async(SetContactor.Request(close=False, holder=_HOLDER))

    def is_open(self) -> bool:
        """Return whether it was measured open and without current after the last `ask_open`, or nobody serves one."""
        while not self._open and (power := self._power.take()) is not None:
            stamp = power.header.stamp
            measured = stamp.sec * 1_000_000_000 + stamp.nanosec
            flows = abs(power.charge_current) >= _OPEN_CURRENT  # NaN = not measured: the contactor alone decides
            self._open = measured > self._asked and not power.contactor_closed and not flows
        return self._open


class StatePublishers:
    """servo_state and joint_states from reports.

    Args:
        node: the publisher.
        qos: of servo_state.
        torque_constant: N·m/A, for the efforts of joint_states.
    """

    def __init__(self, node: Node, qos: QoSProfile, torque_constant: float) -> None:
        self._torque_constant = torque_constant
        self._cycle = 0
        self._joints_wanted = False
        count = len(JOINTS)
        zero, short_zero, none = array("d", [0.0] * count), array("f", [0.0] * count), [False] * count
        state = ServoState(name=list(JOINTS), position=zero, velocity=zero, current=zero)
        state.voltage = state.temperature = state.thermal_reserve = short_zero
        state.hardware_error, state.torque_enabled, state.valid = array("B", bytes(count)), none, none
        joint = JointState(name=list(JOINTS), position=zero, velocity=zero, effort=zero)
        state.header.frame_id = joint.header.frame_id = _FRAME
        stamps = Stamps(node.get_clock())
        state_topic = node.create_publisher(ServoState, "servo_state", qos)
        self._states = FlatPublisher(state_topic, state, _STATE_FIELDS, stamps)
        self._joint_topic = node.create_publisher(JointState, "joint_states", 10)
        self._joints = FlatPublisher(self._joint_topic, joint, ("position", "velocity", "effort"), stamps)

    def publish(self, report: ServoReport) -> None:
        """Publish the state after a cycle; joint_states only where all angles are known and somebody listens."""
        position, velocity = array("d", report.angle), array("d", report.velocity)
        self._states.publish(
            report.time,
            position,
            velocity,
            array("d", report.current),
            array("f", report.voltage),
            array("f", report.temperature),
            bytes(report.hardware_error),
            bytes(report.torque_enabled),
            bytes(report.valid),
            array("f", report.thermal_reserve),
        )
        if self._cycle % _LISTENERS_EVERY == 0:
            self._joints_wanted = self._joint_topic.get_subscription_count() > 0
        self._cycle += 1
        if self._joints_wanted and not math.isnan(sum(report.angle)):
            effort = array("d", [current * self._torque_constant for current in report.current])
            self._joints.publish(report.time, position, velocity, effort)


def waypoint(point: JointTrajectoryPoint) -> ServoWaypoint:
    """Return a point of a message."""
    return ServoWaypoint(seconds(point.time_from_start), point.positions, point.effort)


def age(node: Node, stamp: Any) -> float:
    """Return how long ago, s, a stamp was on the node's clock; 0 for a stamp that is not set."""
    when = Time.from_msg(stamp, clock_type=node.get_clock().clock_type)
    return float((node.get_clock().now() - when).nanoseconds) * 1e-9 if when.nanoseconds else 0.0
