"""simulated_camera_node: an RGB-D camera on the simulated charger, on the topics of a real one.

Publishes, only while somebody subscribes: color/image_raw (rgb8), depth/image_raw (16UC1, mm), color/camera_info.
Subscribes, only then: servo_state, for where arms and platform are in the picture.
Parameters: where the target is, how the camera is mounted and how wrong that is, its image and its defects.
It drives nothing. A target that is not there leaves plate and electrodes out of the picture.
"""

from __future__ import annotations

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

from deltacharger_bringup import node_support
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_vision.errors import MountError, VisionError
from deltacharger_vision.image_node_io import (
    CAMERA_INFO,
    COLOR,
    DEPTH,
    camera_info_message,
    color_message,
    depth_message,
)
from deltacharger_vision.mount import Mount, quaternion
from deltacharger_vision.poses import turn
from deltacharger_vision.scene_drawing import charger_parts, draw_scene
from deltacharger_vision.simulated_camera import OAK_D, SimulatedCamera
from deltacharger_vision.simulated_parameters import CameraParameters
from deltacharger_vision.simulated_scene import Scene

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
        self._period = 1.0 / node_support.declare(self, "rate", 15.0, "images per second (Hz)", 0.1, 120.0)
        seed = node_support.declare(self, "seed", 1, "surroundings, light, noise and the mount's error", 0, 2**31 - 1)
        self._random = np.random.default_rng(seed)
        self._mount = _declare_mount(self, self._random)
        self._target = _declare_target(self)
        self._scene = _declare_scene(self, self._random)
        self._camera = _declare_camera(self)
        node_support.reject_unknown(self)
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
        while not self._stopping.wait(_PAUSE):
            self.looks += 1
            if not self._wanted():
                continue
            arm = self.create_subscription(ServoState, "servo_state", self._on_servo_state, QoSProfile(depth=1))
            self._await_arm()
            due = time.monotonic()
            while self._wanted() and not self._stopping.wait(max(0.0, due - time.monotonic())):
                due = max(due + self._period, time.monotonic())
                self._publish()
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

    def _publish(self) -> None:
        stamp = self.get_clock().now().to_msg()
        if self._info.get_subscription_count():
            self._info.publish(camera_info_message(self._camera.intrinsics, stamp))
        deep = bool(self._depth.get_subscription_count())
        if not deep and not self._color.get_subscription_count():
            return
        scene = dataclasses.replace(self._scene, foreground=(*self._scene.foreground, *self._charger()))
        pose = np.linalg.inv(self._mount) @ self._target
        image = self._camera.render(scene, pose, self._random, color_only=not deep)
        self.rendered += 1
        if not self.context.ok():
            return
        self._color.publish(color_message(image.color, stamp))
        if deep:
            self._depth.publish(depth_message(image.depth, stamp))

    def _charger(self) -> list[Any]:
        """Return the charger's own parts as they stand; none before the arm's angles are known."""
        if self._angles is None:
            return []
        platform = self._kinematics.forward(*self._angles)
        return charger_parts(self._mount, platform, self._angles) if math.isfinite(sum(platform)) else []

    def _on_servo_state(self, message: ServoState) -> None:
        if len(message.position) == 3 and all(map(math.isfinite, message.position)):
            self._angles = (message.position[0], message.position[1], message.position[2])


def _declare_mount(node: Node, random: np.random.Generator) -> np.ndarray[Any, Any]:
    """Declare how the camera is mounted and return charger_base_T_camera (4, 4), its drawn error included."""
    usual = Mount.default().pose
    seven = node_support.declare(
        node,
        "mount",
        [float(value) for value in (*usual[:3, 3], *quaternion(usual[:3, :3]))],
        "where the camera is believed to be in charger_base: x, y, z in m, then the quaternion x, y, z, w",
    )
    position = node_support.declare(
        node, "hand_eye_position_stddev", 0.0, "by how much the camera sits elsewhere, drawn per axis (m)", 0.0, 0.05
    )
    rotation = node_support.declare(
        node, "hand_eye_rotation_stddev", 0.0, "by how much it looks elsewhere, drawn per axis (rad)", 0.0, 0.2
    )
    try:
        pose = Mount.from_numbers(seven).pose
    except MountError as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error
    pose[:3, :3] = turn(rotation * random.normal(size=3)) @ pose[:3, :3]
    pose[:3, 3] += position * random.normal(size=3)
    return pose


def _declare_target(node: Node) -> np.ndarray[Any, Any]:
    """Declare where the electrodes are and return charger_base_T_terminal (4, 4)."""
    place = [
        node_support.declare(node, f"target_{axis}", default, f"electrodes along {axis} of charger_base (m)", -2.0, 2.0)
        for axis, default in (("x", 0.0), ("y", 0.0), ("z", 0.080))
    ]
    roll, pitch, yaw = (
        node_support.declare(node, f"target_{name}", 0.0, f"of the electrodes about {axis} (rad)", -1.6, 1.6)
        for name, axis in (("roll", "z"), ("pitch", "x"), ("yaw", "y"))
    )
    pose = np.eye(4)
    pose[:3, :3] = turn(np.array([pitch, 0.0, 0.0])) @ turn(np.array([0.0, yaw, 0.0])) @ turn(np.array([0, 0, roll]))
    pose[:3, 3] = place
    return pose


def _declare_scene(node: Node, random: np.random.Generator) -> Scene:
    """Declare what else is in the picture and return it."""
    present = node_support.declare(node, "target_present", True, "whether there is a target")
    clutter = node_support.declare(node, "clutter", 0, "boxes around the target", 0, 100)
    decoys = node_support.declare(node, "decoys", 0, "things around it that resemble electrodes", 0, 20)
    glare = node_support.declare(
        node, "glare", -1.0, "highlight on the metal, 1 = full scale; negative = drawn by seed", -1.0, 20.0
    )
    scene = draw_scene(random, clutter=clutter, decoys=decoys, target=present)
    if glare < 0.0:
        return scene
    return dataclasses.replace(scene, parameters=dataclasses.replace(scene.parameters, highlight=glare))


def _declare_camera(node: Node) -> SimulatedCamera:
    """Declare size, defects and renderer of the image and return its camera."""
    width = node_support.declare(node, "width", OAK_D.width, "of the image (px)", 64, 4096)
    height = node_support.declare(node, "height", OAK_D.height, "of the image (px)", 40, 4096)
    names = ("exposure", "defocus", "motion_x", "disparity_noise", "hole_metal", "hole_glare", "hole_matte")
    items = {item.name: item for item in dataclasses.fields(CameraParameters)}
    defects = {
        name: node_support.declare(
            node,
            name,
            items[name].default,
            f"{items[name].metadata['doc']} ({items[name].metadata['unit'] or 'ratio'})",
            items[name].metadata["low"],
            items[name].metadata["high"],
        )
        for name in names
    }
    try:
        return SimulatedCamera(OAK_D.scaled(width, height), CameraParameters(**defects))
    except VisionError as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(SimulatedCameraNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
