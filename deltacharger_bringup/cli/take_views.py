# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate camera --take N`: move the board before the camera and store an image at each position."""

from __future__ import annotations

import argparse
import math
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.context import Context
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_bringup.cli import camera_views, charger, output
from deltacharger_bringup.records.arm_client import STILL, ArmClient, ArmError
from deltacharger_core.ros import qos
from deltacharger_core.ros.client import Guest
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_vision.cameras.ros_formats import color_array
from deltacharger_vision.hand_eye.board import Board
from deltacharger_vision.hand_eye.calibrate import PLACES_APART
from deltacharger_vision.images import Intrinsics, rgb8
from deltacharger_vision.mount import Mount
from deltacharger_vision.ros.messages import intrinsics_of, slash_hint

_IMAGE = 5.0  # s; limit for an image
_BLIND = 6  # positions without the board before giving up
_SHARE = 3  # positions tried per wanted view
_SAME_CLOCK = 10.0  # s between stamp and arrival; beyond it the camera has another clock
_LATENCY = 0.5  # s; largest latency of an image of such a camera


def take(
    options: argparse.Namespace,
    board: Board,
    offset: Vector,
    geometry: DeltaGeometry,
    context: Context,
    interrupts: output.Interrupts,
) -> None:
    """Fill the folder `options.views` up to `options.take` views, with the charger that `prepare` found.

    Raises:
        CommandError: the charger or the camera does not answer, or the board is not visible; exit code 130 after an
            interruption. Views already taken are kept.
        VisionError, ViewsError: the camera's intrinsics, its images or the folder cannot be used.
    """
    mount = Mount.load(options.mount) if options.mount else Mount.default()
    folder: camera_views.ViewsFolder | None = None
    try:
        with (
            ArmClient(context, geometry, options.namespace, interrupts.event) as arm,
            CameraClient(context, options.color_topic, options.namespace) as camera,
        ):
            arm.wait_until_ready(charger.DISCOVERY)
            intrinsics = camera.intrinsics(charger.DISCOVERY, arm.check)
            folder = camera_views.ViewsFolder(Path(options.views), intrinsics)
            if folder.angles:
                output.log_line(
                    f"{options.views} contains {len(folder.angles)} views already; continuing to {options.take}"
                )
            radius = board.size / math.sqrt(2.0) + board.margin
            places = camera_views.view_places(geometry, 1e-3 * options.z_max_mm, mount, intrinsics, offset, radius)
            if len(folder.angles) < options.take:
                _visit(arm, camera, board, _left(places, folder, geometry), folder, options.take)
    except (ArmError, CameraError) as error:
        held = 0 if folder is None else len(folder.angles)
        kept = f"; {options.views} contains {held} views; repeat the command to resume" if held else ""
        raise output.CommandError(f"{error}{kept}", interrupts.failure, views=held) from error
    output.log_line(f"{options.views} contains {len(folder.angles)} views; the torque is off")


def _left(places: Iterable[Vector], folder: camera_views.ViewsFolder, geometry: DeltaGeometry) -> list[Vector]:
    """Return the positions without a view in the folder.

    Raises:
        CommandError: there are none.
    """
    kinematics = ScalarDelta(geometry)
    held = [kinematics.forward(*angles) for angles in folder.angles]
    left = [place for place in places if all(math.dist(place, other) > PLACES_APART for other in held)]
    if not left:
        raise output.CommandError(
            "with this --mount the camera sees the board at no new position: correct --mount or --board-…-mm"
        )
    return left


def _visit(
    arm: ArmClient,
    camera: CameraClient,
    board: Board,
    places: Iterable[Vector],
    folder: camera_views.ViewsFolder,
    wanted: int,
) -> None:
    """Move through the positions and store images that show the board, until there are enough."""
    output.log_line("keep clear: the arm moves now")
    arm.start()
    blind, tried = 0, 0
    for place in places:
        if len(folder.angles) >= wanted or tried >= _SHARE * wanted:
            break
        tried += 1
        arm.move(place)
        before = arm.angles()
        image = camera.image(_IMAGE, arm.check)
        angles = arm.angles()
        where = ", ".join(f"{1e3 * value:.0f}" for value in place)
        if not _still(before, angles):
            output.log_line(f"at ({where}) mm the arm moved while the image was taken; skipped")
        elif board.detect(image) is None:
            blind += 1
            output.log_line(f"at ({where}) mm the board is not visible")
            if blind == _BLIND and not folder.angles:
                raise output.CommandError(
                    f"no image of {_BLIND} positions shows {board.name}: is it there, lit, and facing the camera?"
                )
        else:
            middle = tuple(0.5 * (first + second) for first, second in zip(before, angles, strict=True))
            name = folder.add(image, (middle[0], middle[1], middle[2]))
            output.log_line(f"{name}: {len(folder.angles)} of {wanted}, at ({where}) mm")
    if len(folder.angles) < wanted:
        output.log_line(
            f"only {len(folder.angles)} views at {tried} positions: correct --mount, or make the board visible"
        )
    arm.go_home()


def _still(before: Vector, after: Vector) -> bool:
    return float(np.abs(np.subtract(before, after)).max()) <= STILL


class CameraError(RuntimeError):
    """No image from the camera; the message has the remedy."""


class CameraClient(Guest):
    """Subscribes to a colour image and its camera_info.

    Args:
        context: a running rclpy context.
        topic: of the colour image, relative to the charger's namespace; camera_info is beside it.
        namespace: of the charger.
    """

    def __init__(self, context: Context, topic: str, namespace: str = "") -> None:
        super().__init__("camera_client", context, namespace)
        self._topic = self.node.resolve_topic_name(topic)
        self._info_topic = f"{self._topic.rpartition('/')[0]}/camera_info"
        self._hint = slash_hint(self.node, topic)
        self._lock = threading.Lock()
        self._image: tuple[float, Image] | None = None
        self._info: Any = None
        self.node.create_subscription(Image, self._topic, self._on_image, qos.SENSOR)
        self.node.create_subscription(CameraInfo, self._info_topic, self._on_info, qos.SENSOR)
        self._clock = self.node.get_clock()
        self.serve()

    def intrinsics(self, timeout: float, check: Callable[[], None]) -> Intrinsics:
        """Wait for camera_info and return it.

        Args:
            timeout: s.
            check: called while waiting; may raise.

        Raises:
            CameraError: none arrives.
            CameraInfoError: it cannot be used.
        """
        if not self.wait(lambda: self._info is not None, timeout, check):
            raise CameraError(f"no {self._info_topic} received: start the camera in this ROS domain{self._hint}")
        return intrinsics_of(self._info, self._info_topic)

    def image(self, timeout: float, check: Callable[[], None]) -> NDArray[np.uint8]:
        """Return an image (H, W, 3) RGB taken after this call; arguments as in `intrinsics`.

        Raises:
            CameraError: none arrives.
            ImageError: its encoding is unknown.
        """
        since, asked = self._now(), time.monotonic()

        def fresh() -> Image | None:
            with self._lock:
                latest = self._image
            if latest is None:
                return None
            arrival, message = latest
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            if abs(stamp - since) > _SAME_CLOCK:
                return message if arrival > asked + _LATENCY else None
            return message if stamp >= since and arrival > asked else None

        if not self.wait(lambda: fresh() is not None, timeout, check):
            raise CameraError(f"no image received on {self._topic}: check the camera's node and its cable{self._hint}")
        return rgb8(color_array(fresh()))

    def _now(self) -> float:
        return float(self._clock.now().nanoseconds) * 1e-9

    def _on_image(self, message: Image) -> None:
        with self._lock:
            self._image = (time.monotonic(), message)

    def _on_info(self, message: CameraInfo) -> None:
        self._info = message
