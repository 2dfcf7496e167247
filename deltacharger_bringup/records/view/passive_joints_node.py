# SPDX-License-Identifier: Apache-2.0
"""passive_joints_node: publish the URDF's passive joints, for RViz and other readers of tf.

A display tool, started by launch/view.launch.py; no other node needs it.

Subscribes: servo_state.
Publishes: joint_states with the platform's three prismatic joints and the left rods' revolute ones, by forward
kinematics, with the stamp of servo_state, at most 30 times a second; nothing while a servo is invalid.
Parameters: geometry_file or the arm's single dimensions.
"""

import math
from collections.abc import Sequence
from typing import Any

from deltacharger.msg import ServoState
from rclpy.node import Node
from sensor_msgs.msg import JointState

from deltacharger_core.frames import CHARGER_BASE, JointFrameParameters
from deltacharger_core.ros import node_support, qos
from deltacharger_core.ros.parameters import declare_all, declare_file, reject_unknown
from deltacharger_kinematics import geometry, parameters, scalar
from deltacharger_kinematics.passive_joints import passive_joints

_PERIOD = 1.0 / 30.0  # s, the shortest between two messages: as often as a screen shows them


class PassiveJointsNode(Node):
    """Publishes passive joints; see the module's docstring for its interface."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("passive_joints_node", **kwargs)
        frames = declare_all(self, JointFrameParameters)
        self._frame_id, self._prefix = frames.named(CHARGER_BASE), frames.joint_prefix
        self._delta = scalar.ScalarDelta(
            declare_file(self, parameters.GeometryFileParameters, geometry.load_geometry) or geometry.DeltaGeometry()
        )
        reject_unknown(self)
        self._last = -math.inf
        self._joints = self.create_publisher(JointState, "joint_states", qos.DEFAULT_DEPTH)
        self.create_subscription(ServoState, "servo_state", self._on_servo_state, qos.LATEST)

    def _on_servo_state(self, message: ServoState) -> None:
        if len(message.position) != 3 or len(message.valid) != 3 or not all(message.valid):
            return
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if 0.0 <= stamp - self._last < _PERIOD:  # a clock set back must not stop the output
            return
        values = passive_joints(self._delta, message.position)
        if not values:
            return
        self._last = stamp
        joints = JointState(name=[f"{self._prefix}{name}" for name in values], position=list(values.values()))
        joints.header.stamp, joints.header.frame_id = message.header.stamp, self._frame_id
        self._joints.publish(joints)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return node_support.run(PassiveJointsNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
