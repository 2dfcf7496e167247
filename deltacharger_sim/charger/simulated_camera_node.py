# SPDX-License-Identifier: Apache-2.0
"""simulated_camera_node: a simulated RGB-D camera on the topics of a real one.

Publishes, only while there are subscribers: color/image_raw (rgb8), depth/image_raw (16UC1, mm), color/camera_info.
Subscribes, only then: servo_state, to draw arms and platform.
Parameters: pose of the target, assumed mount and its error, image and its defects.
It commands nothing. Without a target, the picture has neither plate nor electrodes.
"""

import dataclasses
import math
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from deltacharger.msg import ServoState
from rclpy.node import Node
from rclpy.qos import QoSProfile

from deltacharger_core.arrays import Array
from deltacharger_core.frames import CAMERA, FrameParameters
from deltacharger_core.ros import node_support
from deltacharger_core.ros.parameters import declare_all, reject_unknown
from deltacharger_kinematics import geometry, scalar
from deltacharger_sim.charger.simulation import SimulatedCameraNodeParameters
from deltacharger_vision import errors, images, mount, terminal
from deltacharger_vision.hand_eye.board import Board
from deltacharger_vision.rendering import board_drawing, camera
from deltacharger_vision.rendering.scene import RenderedScene, charger_parts, draw_scene, shifted
from deltacharger_vision.ros.messages import CameraPublishers

_PAUSE = 0.05  # s between two checks for subscribers
_ARM = 1.0  # s that an image waits for the arm's angles
_MOVED, _TURNED = 0.002, 0.0087  # m and rad, standard deviations of a mount error of 1


def _mounted(given: SimulatedCameraNodeParameters, random: np.random.Generator) -> Array:
    """Return charger_base_T_camera (4, 4), including its drawn error.

    Raises:
        VisionError: the mount is not a valid pose.
    """
    pose = mount.Mount.from_numbers(given.mount).pose
    pose[:3, :3] = terminal.turn(given.mount_error * _TURNED * random.normal(size=3)) @ pose[:3, :3]
    pose[:3, 3] += given.mount_error * _MOVED * random.normal(size=3)
    return pose


class SimulatedCameraNode(Node):
    """See the module's docstring. Images are rendered in a separate thread.

    Attributes:
        looks: checks for subscribers so far.
        rendered: images so far.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("simulated_camera_node", **kwargs)
        given = declare_all(self, SimulatedCameraNodeParameters)
        frames = declare_all(self, FrameParameters)
        reject_unknown(self)
        self._period = 1.0 / given.rate
        self._random = np.random.default_rng(given.seed)
        try:
            self._mount = _mounted(given, self._random)
            self._target = mount.Mount.from_numbers(given.target).pose
            self._scene = draw_scene(self._random, given.clutter, given.target_present)
            self._camera = camera.SimulatedCamera(camera.OAK_D)
            self._board = Board.named(given.board, Board.size) if given.board else None
        except errors.VisionError as error:
            raise node_support.StartupError(f"simulated_camera_node: {error}") from error
        self._kinematics = scalar.ScalarDelta(geometry.DeltaGeometry())
        self._angles: tuple[float, float, float] | None = None
        self._images = CameraPublishers(self, frames.named(CAMERA))
        self.looks = self.rendered = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulated camera", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the thread."""
        self._stopping.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        while not self._stopping.wait(_PAUSE):
            self.looks += 1
            if not self._images.wanted():
                continue
            arm = self.create_subscription(ServoState, "servo_state", self._on_servo_state, QoSProfile(depth=1))
            self._await_arm()
            due = time.monotonic()
            while self._images.wanted() and not self._stopping.wait(max(0.0, due - time.monotonic())):
                due = max(due + self._period, time.monotonic())
                self._publish()
            self.destroy_subscription(arm)
            self._angles = None

    def _await_arm(self) -> None:
        """Wait for the arm's angles if there is an arm: the first image must show it, too."""
        end = time.monotonic() + _ARM
        while self._angles is None and self.count_publishers("servo_state") and time.monotonic() < end:
            self._stopping.wait(0.005)

    def _publish(self) -> None:
        """Publish the requested topics; renders depth only if it is requested."""
        deep = self._images.wanted(images.DEPTH)
        if not deep and not self._images.wanted(images.COLOR):
            self._images.info(self._camera.intrinsics)
            return
        taken = time.monotonic()
        pose = np.linalg.inv(self._mount) @ self._target
        image = self._camera.render(self._with_charger(), pose, self._random, color_only=not deep)
        self.rendered += 1
        self._images.image(image, taken, deep)

    def _with_charger(self) -> RenderedScene:
        """Return the scene with the charger's parts at their present pose; without them until the angles are known."""
        if self._angles is None:
            return self._scene
        platform = self._kinematics.forward(*self._angles)
        if not math.isfinite(sum(platform)):
            return self._scene
        parts = charger_parts(self._mount, platform, self._angles)
        scene = dataclasses.replace(self._scene, foreground=(*self._scene.foreground, *parts))
        if self._board is None:
            return scene
        return board_drawing.with_board(
            scene, self._board, np.linalg.inv(self._mount) @ shifted(platform) @ board_drawing.bracket()
        )

    def _on_servo_state(self, message: ServoState) -> None:
        if len(message.position) == 3 and all(map(math.isfinite, message.position)):
            self._angles = (message.position[0], message.position[1], message.position[2])


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(SimulatedCameraNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
