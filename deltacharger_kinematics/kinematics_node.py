# SPDX-License-Identifier: Apache-2.0
"""kinematics_node: pose of the end effector, force on it, and kinematics services.

Subscribes: servo_state, only while pose or wrench has subscribers.
Publishes: end_effector_pose (charger_base) and contact_wrench (force on the end effector, in end_effector, without the
arm's weight), one of each per servo_state and with its stamp, only while subscribed. Nothing while a servo is not
valid, no wrench while a torque is off.
Serves: solve_inverse_kinematics, solve_forward_kinematics, with a status per point; an incomplete last point is
INVALID_INPUT. A request for more than POINTS_MAX gets an empty answer.
Parameters: geometry_file or the arm's single dimensions, gravity, servos_file or torque_constant.
"""

from __future__ import annotations

import array
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from deltacharger.msg import ServoState
from deltacharger.srv import SolveForwardKinematics, SolveInverseKinematics
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import ArrayLike
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

from deltacharger_core.frames import CHARGER_BASE, END_EFFECTOR, FrameParameters
from deltacharger_core.ros import clock, log, node_support, on_demand, parameters, qos
from deltacharger_kinematics import Delta
from deltacharger_kinematics.geometry import DeltaGeometry, load_geometry
from deltacharger_kinematics.parameters import SERVOS_FOLLOW, GeometryFileParameters, KinematicsNodeParameters
from deltacharger_kinematics.scalar import ScalarDelta

_DEFAULT_DEPTH = 10
POINTS_MAX = 1_000_000
"""Maximum points of a request; a larger one gets an empty answer, because it would take seconds."""
_CHECK_PERIOD = 0.2  # s between checks for subscribers of pose and wrench


class KinematicsNode(Node):
    """Pose, contact force and kinematics of the arm; the module's docstring lists the interface."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("kinematics_node", **kwargs)
        self._log = log.Log(self)
        geometry = parameters.declare_file(self, GeometryFileParameters, load_geometry) or DeltaGeometry()
        given = parameters.declare_with_servos(self, KinematicsNodeParameters(), SERVOS_FOLLOW)
        frames = parameters.declare_all(self, FrameParameters)
        self._charger_base, self._end_effector = frames.named(CHARGER_BASE), frames.named(END_EFFECTOR)
        parameters.reject_unknown(self)
        self._gravity, self._torque_constant = given.gravity, given.torque_constant
        self._delta = Delta(geometry)
        self._scalar = ScalarDelta(geometry)
        self._pose = self.create_publisher(PoseStamped, "end_effector_pose", _DEFAULT_DEPTH)
        self._wrench = self.create_publisher(WrenchStamped, "contact_wrench", _DEFAULT_DEPTH)
        self._servo_state = on_demand.PolledTopic(
            self, ServoState, "servo_state", QoSProfile(depth=1), callback=self._on_servo_state
        )
        clock.steady_timer(self, _CHECK_PERIOD, self._subscribe_on_demand)
        group = ReentrantCallbackGroup()
        self.create_service(
            SolveInverseKinematics,
            "solve_inverse_kinematics",
            self._on_inverse,
            callback_group=group,
            qos_profile=qos.SERVICE,
        )
        self.create_service(
            SolveForwardKinematics,
            "solve_forward_kinematics",
            self._on_forward,
            callback_group=group,
            qos_profile=qos.SERVICE,
        )

    def close(self) -> None:
        """Do nothing: this node drives no hardware."""

    def _subscribe_on_demand(self) -> None:
        self._servo_state.set_open(self._pose.get_subscription_count() + self._wrench.get_subscription_count() > 0)

    def _on_servo_state(self, message: ServoState) -> None:
        wants_pose = self._pose.get_subscription_count() > 0
        wants_wrench = self._wrench.get_subscription_count() > 0
        if not (wants_pose or wants_wrench) or not _complete(message.valid) or len(message.position) != 3:
            return
        x, y, z = self._scalar.forward(*message.position)
        if not math.isfinite(x + y + z):
            return
        if wants_pose:
            pose = PoseStamped()
            pose.header.stamp = message.header.stamp
            pose.header.frame_id = self._charger_base
            pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = x, y, z
            self._pose.publish(pose)
        # Without torque the current has no meaning: the gears carry the arm.
        if wants_wrench and len(message.current) == 3 and _complete(message.torque_enabled):
            self._publish_wrench(message, (x, y, z))

    def _publish_wrench(self, message: ServoState, position: tuple[float, float, float]) -> None:
        held = self._scalar.holding_torque(*position, self._gravity)
        spare = [self._torque_constant * current - hold for current, hold in zip(message.current, held, strict=True)]
        fx, fy, fz = self._scalar.force(*position, (spare[0], spare[1], spare[2]))
        if not math.isfinite(fx + fy + fz):
            return
        wrench = WrenchStamped()
        wrench.header.stamp = message.header.stamp
        wrench.header.frame_id = self._end_effector
        # The force on the arm is opposite to the force on the target.
        wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z = -fx, -fy, -fz
        self._wrench.publish(wrench)

    def _on_inverse(
        self, request: SolveInverseKinematics.Request, response: SolveInverseKinematics.Response
    ) -> SolveInverseKinematics.Response:
        if self._is_too_much(request.positions):
            return response
        solved = self._delta.inverse(points(request.positions))
        response.angles = _flat("d", solved.angles)
        response.status = _flat("I", solved.status)
        response.margin = _flat("d", solved.margin)
        return response

    def _on_forward(
        self, request: SolveForwardKinematics.Request, response: SolveForwardKinematics.Response
    ) -> SolveForwardKinematics.Response:
        if self._is_too_much(request.angles):
            return response
        solved = self._delta.forward(points(request.angles))
        response.positions = _flat("d", solved.position)
        response.status = _flat("I", solved.status)
        return response

    def _is_too_much(self, values: Sequence[float]) -> bool:
        """Return whether a request has too many points; if so, log a warning."""
        if len(values) <= 3 * POINTS_MAX:
            return False
        self._log.warning(
            f"refused a request for {len(values) // 3} points: send at most {POINTS_MAX} at once",
            pause=5.0,
        )
        return True


def _complete(flags: Sequence[bool]) -> bool:
    return len(flags) == 3 and all(flags)


def _flat(code: str, values: ArrayLike) -> array.array[Any]:
    """Return `values` as an array that a message accepts unchanged; conversion by number would take half the call."""
    return array.array(code, np.ascontiguousarray(values, dtype=code).tobytes())


def points(values: Sequence[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return `values`, three per point, as (n, 3); an incomplete last point is filled with NaN (INVALID_INPUT)."""
    flat = np.asarray(values, dtype=np.float64)
    missing = -len(flat) % 3
    return (np.concatenate([flat, np.full(missing, np.nan)]) if missing else flat).reshape(-1, 3)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; the executable."""
    return node_support.run(KinematicsNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
