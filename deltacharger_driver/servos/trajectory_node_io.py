# SPDX-License-Identifier: Apache-2.0
"""Selects which received trajectory the servos follow: the newest that is allowed and valid.

Any node may publish on joint_trajectory. In each cycle a bounded part of the received data is read, the newest first. A
refused message is counted, and the one before it is tried.
"""

from __future__ import annotations

import math
from typing import Any

from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_driver.errors import TrajectoryRefused
from deltacharger_driver.servos.controller import ServoController
from deltacharger_driver.servos.motion_guard import ContactorState, MotionGuard, Sender
from deltacharger_driver.servos.report import ServoPhase
from deltacharger_driver.servos.servo_node_io import KEPT
from deltacharger_driver.servos.trajectory import JointLimits, ServoWaypoint, check, check_age
from deltacharger_ros.clock import stamp_age
from deltacharger_ros.messages import seconds
from deltacharger_ros.on_demand import BoundedTopic, Received

LONGEST_SECRET = 64  # characters of header.frame_id
_LARGEST = 128 * 1024  # bytes of a trajectory, and of all that one cycle reads; 1000 points have 112 000, read in 36 ms
_LARGEST_HOLD = 512  # bytes of a trajectory without points
_STRANGERS = 8  # publishers that are kept for the diagnostics

_Line = tuple[Sender, int, int]


class TrajectoryInbox:
    """Takes trajectories for a `ServoController`. Used by its thread.

    Args:
        node: the subscriber.
        limits: of angles and torque bounds.

    Attributes:
        refused: trajectories refused since the start.
        forbidden: of these, those refused because of the contactor.
        last_refusal: reason of the last refusal.
        strangers: publisher ids of the forbidden ones; the reader clears it.
    """

    def __init__(self, node: Node, limits: JointLimits) -> None:
        self.refused = self.forbidden = 0
        self.last_refusal = ""
        self.strangers: set[bytes] = set()
        self._node = node
        self._limits = limits
        self._topic = BoundedTopic(node, JointTrajectory, "joint_trajectory", KEPT)
        self._followed: _Line | None = None  # the line being followed

    @property
    def topic(self) -> str:
        """Full name of the topic."""
        return self._topic.name

    def serve(self, controller: ServoController, guard: MotionGuard, state: ContactorState) -> None:
        """Pass the newest valid trajectory to the controller and refuse the newer ones.

        Args:
            controller: receives the trajectory.
            guard: decides who may move the arm.
            state: present state of the contactor.
        """
        budget = _LARGEST + KEPT.depth * _LARGEST_HOLD
        for received in reversed(self._topic.take()):
            sender = _sender(received)
            if sender is None:
                self._refuse(f"its header cannot be read, or its frame_id is longer than {LONGEST_SECRET} characters")
                continue
            allowed = guard.may_move(sender, state)
            size = len(received.data)
            if not allowed and size > _LARGEST_HOLD:
                self._forbid(received, state)
                continue
            if size > _LARGEST:
                self._refuse(f"it has {size} bytes, more than {_LARGEST}; send fewer points and short names")
                continue
            budget -= size
            if budget < 0:  # too much data already refused
                return
            try:
                message = received.read()
                if message is None:
                    raise TrajectoryRefused("its bytes are not a JointTrajectory")
                if message.points and not allowed:
                    self._forbid(received, state)
                    continue
                self._follow(controller, message, sender)
            except TrajectoryRefused as error:
                self._refuse(error.reason)
                continue
            if message.points:
                guard.record_move(sender, state)
            return

    def _follow(self, controller: ServoController, message: Any, sender: Sender) -> None:
        """Submit a trajectory or raise TrajectoryRefused."""
        if controller.phase is not ServoPhase.ON:
            self._followed = None
        trajectory = check(message.joint_names, [_waypoint(point) for point in message.points], self._limits)
        stamp = message.header.stamp
        old = self._age(stamp)
        line = (sender, stamp.sec, stamp.nanosec)
        # A later piece of a running line is as old as its end: the line itself may last longer than a stamp is valid.
        check_age(max(old - trajectory.duration, 0.0) if line == self._followed else old)
        start = controller.now() - old if stamp.sec or stamp.nanosec else math.inf
        controller.submit(trajectory, start)
        self._followed = line if not trajectory.is_hold else self._followed

    def _age(self, stamp: Any) -> float:
        """Return the age of a stamp on the node's clock, s; 0 if not set, NaN if invalid."""
        return stamp_age(self._node.get_clock(), stamp) if stamp.sec or stamp.nanosec else 0.0

    def _forbid(self, received: Received, state: ContactorState) -> None:
        self.forbidden += 1
        if len(self.strangers) < _STRANGERS:
            self.strangers.add(received.publisher)
        self._refuse(state.value)

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.last_refusal = str(TrajectoryRefused(reason))


def _sender(received: Received) -> Sender | None:
    """Return the sender; None if its frame_id is unreadable or too long."""
    secret = received.frame_id(LONGEST_SECRET)
    return None if secret is None else Sender(secret, received.publisher)


def _waypoint(point: JointTrajectoryPoint) -> ServoWaypoint:
    return ServoWaypoint(seconds(point.time_from_start), point.positions, point.effort)
