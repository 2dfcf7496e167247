# SPDX-License-Identifier: Apache-2.0
"""Pairs of simultaneous images from a camera's topics, subscribed only while needed."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_vision.cameras.pairing_by_stamp import StampMatcher
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.parameters import CAMERA_INFO, COLOR, DEPTH
from deltacharger_vision.ros.driver_diagnostics import DriverDiagnostics
from deltacharger_vision.ros.messages import rgbd_of, slash_hint, stamp_ns

SILENT = 1.0
"""A topic without a message for this long counts as silent, s."""


@dataclass(frozen=True)
class Shot:
    """Messages of one colour and depth image of the same time.

    Attributes:
        number: of this pair, increasing.
        stamp: of the colour image, ns.
        color: its message.
        depth: its message.
        info: calibration of the colour image.
    """

    number: int
    stamp: int
    color: Image
    depth: Image
    info: CameraInfo

    def image(self, depth_unit: float) -> RgbdImage:
        """Return the decoded image, its 16-bit depth in units of `depth_unit` (m).

        Raises:
            ImageError: an encoding is unknown, or the images do not match.
            CameraInfoError: the camera is not calibrated.
        """
        return rgbd_of(self.color, self.depth, self.info, depth_unit, CAMERA_INFO)


class Camera:
    """The three topics of an RGB-D camera.

    Args:
        node: that subscribes.
        tolerance: largest difference between the stamps of colour and depth, s.
        topics: names of colour, depth and calibration.

    Attributes:
        names: of the topics, resolved.
    """

    def __init__(self, node: Node, tolerance: float, topics: Sequence[str] = (COLOR, DEPTH, CAMERA_INFO)) -> None:
        self._node = node
        self._matcher: StampMatcher[Image, Image] = StampMatcher(round(1e9 * tolerance))
        self._tolerance = tolerance
        self._news = threading.Condition()
        self._watchers = 0
        self._subscriptions: list[Any] = []
        self._driver: DriverDiagnostics | None = None
        self._since = math.inf
        self._heard: dict[str, float] = {}
        self._matched = -math.inf
        self._info: CameraInfo | None = None
        self._shot: Shot | None = None
        self._closed = False
        self.names = [node.resolve_topic_name(topic) for topic in topics]
        self._hint = slash_hint(node, *topics)

    @property
    def watched(self) -> bool:
        """Whether anyone uses the images."""
        return self._watchers > 0

    @property
    def shots(self) -> int:
        """Number of pairs received."""
        return 0 if self._shot is None else self._shot.number

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Subscribe inside the context; a publisher that works only for subscribers then starts."""
        with self._news:
            self._watchers += 1
            if self._watchers == 1:
                self._open()
        try:
            yield
        finally:
            with self._news:
                self._watchers -= 1
                if self._watchers == 0:
                    self._unsubscribe()

    def close(self) -> None:
        """Release waiting threads."""
        with self._news:
            self._closed = True
            self._news.notify_all()

    def after(self, number: int, deadline: float) -> Shot | None:
        """Wait for a pair with a higher number than `number`, at most until `deadline` (monotonic, s)."""
        with self._news:
            while not self._closed:
                if self._shot is not None and self._shot.number > number:
                    return self._shot
                left = deadline - time.monotonic()
                if left <= 0.0:
                    break
                self._news.wait(left)
            return None

    def problem(self) -> str:
        """Return why no images arrive; '' if they do, or if the subscription is too recent to know."""
        absent = [name for name in self.names if not self._node.count_publishers(name)]
        if absent:
            start = "start camera_node, or the camera's driver with these names"
            return f"no publisher of {', '.join(absent)}: {start}{self._hint}"
        with self._news:
            now, since = time.monotonic(), self._since
            silent = [name for name in self.names if now - self._heard.get(name, since) > SILENT]
            unmatched = now - max(self._matched, since) > SILENT
            driver = self._driver.of_publisher(silent[0]) if silent and self._driver else ""
        if silent:
            why = driver or "check the camera, its cable and its driver"
            return f"no images on {', '.join(silent)}: {why}"
        if unmatched:
            limit = f"stamp_tolerance, {1e3 * self._tolerance:g} ms"
            return f"the stamps of colour and depth differ by more than {limit}: let the driver synchronise them"
        return ""

    def _open(self) -> None:
        self._since = time.monotonic()
        kinds: tuple[Any, ...] = (Image, Image, CameraInfo)
        takers = (self._on_color, self._on_depth, self._on_info)
        for name, kind, take in zip(self.names, kinds, takers, strict=True):
            self._subscriptions.append(
                self._node.create_subscription(kind, name, self._listener(name, take), qos_profile_sensor_data)
            )
        self._driver = DriverDiagnostics(self._node, self._news)

    def _listener(self, name: str, take: Callable[[Any], None]) -> Callable[[Any], None]:
        def on_message(message: Any) -> None:
            with self._news:
                self._heard[name] = time.monotonic()
                take(message)

        return on_message

    def _unsubscribe(self) -> None:
        """Drop subscriptions and messages, which would be too old for the next use."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        if self._driver is not None:
            self._driver.close()
            self._driver = None
        self._since = math.inf
        self._heard.clear()
        self._info = None
        self._matcher.clear()

    def _on_color(self, message: Image) -> None:
        self._take(self._matcher.add_color(stamp_ns(message), message))

    def _on_depth(self, message: Image) -> None:
        self._take(self._matcher.add_depth(stamp_ns(message), message))

    def _on_info(self, message: CameraInfo) -> None:
        self._info = message

    def _take(self, pair: tuple[int, Image, Image] | None) -> None:
        if pair is None or self._info is None:
            return
        stamp, color, depth = pair
        self._matched = time.monotonic()
        self._shot = Shot(self.shots + 1, stamp, color, depth, self._info)
        self._news.notify_all()
