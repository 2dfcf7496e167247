# SPDX-License-Identifier: Apache-2.0
"""simulated_camera_node: an RGB-D camera on the simulated charger, on the topics of a real one.

Publishes, only while somebody subscribes: color/image_raw (rgb8), depth/image_raw (16UC1, mm), color/camera_info.
Subscribes, only then: servo_state, for where arms and platform are in the picture.
Parameters: where the target is, how the camera is mounted and how wrong that is, its image and its defects.
It drives nothing. A target that is not there leaves plate and electrodes out of the picture.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from deltacharger.msg import ServoState
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_ros import node_support
from deltacharger_ros.parameters import declare_all, reject_unknown
from deltacharger_sim.charger import simulated_camera_node_io as io
from deltacharger_sim.charger.parameters import ImageParameters, SimulatedCameraNodeParameters
from deltacharger_vision.errors import VisionError
from deltacharger_vision.parameters import CAMERA_INFO, COLOR, DEPTH
from deltacharger_vision.rendering.board_drawing import with_board
from deltacharger_vision.rendering.mujoco_camera import MujocoCamera
from deltacharger_vision.rendering.scene import RenderedScene, shifted
from deltacharger_vision.rendering.scene_drawing import charger_parts
from deltacharger_vision.ros.messages import (
    camera_info_message,
    color_message,
    depth_message,
)

_PAUSE = 0.05  # s between two looks for subscribers
_ARM = 1.0  # s that an image waits for the arm's angles


class SimulatedCameraNode(Node):
    """See the module's docstring. Images are made in a thread of their own.

    Attributes:
        looks: how often it looked for subscribers.
        rendered: how many images it made.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("simulated_camera_node", **kwargs)
        given = declare_all(self, SimulatedCameraNodeParameters)
        defects = declare_all(self, ImageParameters)
        reject_unknown(self)
        self._period = 1.0 / given.rate
        self._random = np.random.default_rng(given.seed)
        try:
            self._mount = io.mounted(given, self._random)
            self._target = io.target_pose(given)
            self._scene = io.scene(given, self._random)
            self._make_camera = io.camera_maker(given, defects)
            self._board = io.board(given)
        except VisionError as error:
            raise node_support.StartupError(f"simulated_camera_node: {error}") from error
        io.try_out(self, self._make_camera)
        self._kinematics = ScalarDelta(DeltaGeometry())
        self._angles: tuple[float, float, float] | None = None
        self._color = self.create_publisher(Image, COLOR, qos_profile_sensor_data)
        self._depth = self.create_publisher(Image, DEPTH, qos_profile_sensor_data)
        self._info = self.create_publisher(CameraInfo, CAMERA_INFO, qos_profile_sensor_data)
        self.looks = 0
        self.rendered = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulated camera", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._stopping.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        with contextlib.ExitStack() as stack:  # OpenGL belongs to one thread
            camera = self._make_camera()
            if isinstance(camera, MujocoCamera):
                stack.enter_context(camera)
            self._serve(camera)

    def _serve(self, camera: io.Camera) -> None:
        while not self._stopping.wait(_PAUSE):
            self.looks += 1
            if not self._wanted():
                continue
            arm = self.create_subscription(ServoState, "servo_state", self._on_servo_state, QoSProfile(depth=1))
            self._await_arm()
            due = time.monotonic()
            while self._wanted() and not self._stopping.wait(max(0.0, due - time.monotonic())):
                due = max(due + self._period, time.monotonic())
                self._publish(camera)
            self.destroy_subscription(arm)
            self._angles = None

    def _await_arm(self) -> None:
        """Wait for the arm's angles where there is an arm: the first image must show it like all others."""
        end = time.monotonic() + _ARM
        while self._angles is None and self.count_publishers("servo_state") and time.monotonic() < end:
            self._stopping.wait(0.005)

    def _wanted(self) -> bool:
        publishers = (self._color, self._depth, self._info)
        return any(publisher.get_subscription_count() for publisher in publishers)

    def _publish(self, camera: io.Camera) -> None:
        stamp = self.get_clock().now().to_msg()
        if self._info.get_subscription_count():
            self._info.publish(camera_info_message(camera.intrinsics, stamp))
        deep = bool(self._depth.get_subscription_count())
        if not deep and not self._color.get_subscription_count():
            return
        pose = np.linalg.inv(self._mount) @ self._target
        image = camera.render(self._with_charger(), pose, self._random, color_only=not deep)
        self.rendered += 1
        if not self.context.ok():
            return
        self._color.publish(color_message(image.color, stamp))
        if deep:
            self._depth.publish(depth_message(image.depth, stamp))

    def _with_charger(self) -> RenderedScene:
        """Return the scene with the charger's own parts as they stand; without them before the angles are known."""
        if self._angles is None:
            return self._scene
        platform = self._kinematics.forward(*self._angles)
        if not math.isfinite(sum(platform)):
            return self._scene
        parts = charger_parts(self._mount, platform, self._angles)
        scene = dataclasses.replace(self._scene, foreground=(*self._scene.foreground, *parts))
        if self._board is None:
            return scene
        board, place = self._board
        return with_board(scene, board, np.linalg.inv(self._mount) @ shifted(platform) @ place, in_camera=True)

    def _on_servo_state(self, message: ServoState) -> None:
        if len(message.position) == 3 and all(map(math.isfinite, message.position)):
            self._angles = (message.position[0], message.position[1], message.position[2])


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(SimulatedCameraNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
