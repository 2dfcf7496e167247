# SPDX-License-Identifier: Apache-2.0
"""Minimal publishers of a robot's transforms: robot_state_publisher and localization."""

import time
from collections.abc import Sequence
from typing import Any

import pytest
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time

from .nodes import options

WITHOUT_TF = "tf2_ros is not installed: it comes with ROS, or `make transforms` builds a stand-in"


def transforms() -> Any:
    """Return the module tf2_msgs.msg, or skip."""
    pytest.importorskip("tf2_ros", reason=WITHOUT_TF)
    return pytest.importorskip("tf2_msgs.msg", reason=WITHOUT_TF)


class Robot(Node):
    """Publishes transforms."""

    def __init__(self, context: Any, name: str = "robot") -> None:
        kind = transforms().TFMessage
        super().__init__(name, **options(context))
        self._kind = kind
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._moving = self.create_publisher(kind, "/tf", 100)
        self._fixed = self.create_publisher(kind, "/tf_static", latched)

    @property
    def heard(self) -> bool:
        """Whether both topics have subscribers."""
        return min(self._moving.get_subscription_count(), self._fixed.get_subscription_count()) > 0

    def fix(self, parent: str, child: str, pose: Sequence[float]) -> None:
        """Publish once the fixed pose of a frame in its parent (7 numbers)."""
        self._fixed.publish(self._kind(transforms=[self._message(parent, child, pose, time.time())]))

    def move(self, *links: tuple[str, str, Sequence[float]], when: float | None = None) -> None:
        """Publish poses of frames (parent, child, pose), now or at another time (s since 1970)."""
        at = time.time() if when is None else when
        self._moving.publish(self._kind(transforms=[self._message(*link, at) for link in links]))

    def _message(self, parent: str, child: str, pose: Sequence[float], when: float) -> TransformStamped:
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id, message.header.stamp = parent, stamp(when)
        place, turn = message.transform.translation, message.transform.rotation
        place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = (float(number) for number in pose)
        return message


def stamp(when: float) -> Any:
    """Return a time (s since 1970) as a message."""
    return Time(nanoseconds=round(1e9 * when)).to_msg()
