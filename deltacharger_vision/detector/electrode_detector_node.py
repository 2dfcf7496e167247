# SPDX-License-Identifier: Apache-2.0
"""electrode_detector_node finds the target's electrodes in the images of any RGB-D camera.

Subscribes while detecting: color/image_raw, depth/image_raw (aligned to colour), color/camera_info.
Publishes: electrode_detection if it finds electrodes, electrode_detection/image (annotated, while it has subscribers),
/diagnostics (1 Hz).
Serves: detect_electrodes, which examines new images until it finds the electrodes or times out.
Parameters: rate (0 = on demand only), image_age_max, topics, nearest depth, mount, and the terminal's lengths.
It moves nothing. With a rate, it detects while electrode_detection has subscribers. Without OpenCV it keeps running and
reports the error: a charger can dock to coordinates without a camera.
"""

import contextlib
import math
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from deltacharger.msg import ElectrodeDetection
from deltacharger.srv import DetectElectrodes
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core import frames, texts
from deltacharger_core.ros import clock, diagnostics, log, messages, node_support, parameters, qos
from deltacharger_core.ros.frames import TfTree, TransformError, installed
from deltacharger_vision import errors, mount
from deltacharger_vision.detector.detector import ElectrodeDetector, annotated
from deltacharger_vision.images import COLOR, DEPTH, INFO, STAMP_TOLERANCE, RgbdImage, StampMatcher
from deltacharger_vision.parameters import DetectorNodeParameters, info_topic
from deltacharger_vision.ros.messages import color_message, detection_message, rgbd_of, slash_hint, stamp_ns
from deltacharger_vision.terminal import Terminal

_TIMEOUT = 2.0  # s, search time of a request without its own


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

    def image(self) -> RgbdImage:
        """Return the decoded image.

        Raises:
            ImageError: an encoding is unknown, or the images do not match.
            CameraInfoError: the camera is not calibrated.
        """
        return rgbd_of(self.color, self.depth, self.info)


class Camera:
    """The three topics of an RGB-D camera.

    Args:
        node: that subscribes.
        topics: names of colour, depth and calibration.

    Attributes:
        names: of the topics, resolved.
    """

    def __init__(self, node: Node, topics: Sequence[str]) -> None:
        self._node = node
        self._matcher: StampMatcher[Image] = StampMatcher()
        self._news = threading.Condition()
        self._watchers = 0
        self._subscriptions: list[Any] = []
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
        if silent:
            return f"no images on {', '.join(silent)}: check the camera, its cable and its driver's messages"
        if unmatched:
            limit = f"{1e-6 * STAMP_TOLERANCE:g} ms"
            return f"the stamps of colour and depth differ by more than {limit}: let the driver synchronise them"
        return ""

    def _open(self) -> None:
        self._since = time.monotonic()
        for name, kind in zip(self.names, (COLOR, DEPTH, INFO), strict=True):
            receive = partial(self._on_message, name, kind)
            message: Any = CameraInfo if kind == INFO else Image
            self._subscriptions.append(self._node.create_subscription(message, name, receive, qos_profile_sensor_data))

    def _unsubscribe(self) -> None:
        """Drop subscriptions and messages, which would be too old for the next use."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions = []
        self._since = math.inf
        self._heard.clear()
        self._info = None
        self._matcher.clear()

    def _on_message(self, name: str, kind: str, message: Any) -> None:
        with self._news:
            self._heard[name] = time.monotonic()
            if kind == INFO:
                self._info = message
            elif (pair := self._matcher.add_image(kind, stamp_ns(message), message)) and self._info is not None:
                self._matched = time.monotonic()
                self._shot = Shot(self.shots + 1, *pair, self._info)
                self._news.notify_all()


_FUTURE = 0.05  # s that a stamp may be ahead of this computer's clock


@dataclass
class _Tally:
    """Counts of images so far."""

    examined: int = 0
    found: int = 0
    stale: int = 0
    milliseconds: float = float("nan")


class ElectrodeDetectorNode(Node):
    """See the module's docstring. The service waits for images."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("electrode_detector_node", **kwargs)
        self._log = log.Log(self)
        given, transforms = (
            parameters.declare_all(self, DetectorNodeParameters),
            parameters.declare_all(self, frames.TransformParameters),
        )
        terminal = parameters.declare_all(self, Terminal)
        parameters.reject_unknown(self)
        self._given = given
        topics = [given.color_topic, given.depth_topic, info_topic(given.color_topic)]
        self._charger_base = transforms.named(frames.CHARGER_BASE)
        self._tf = _tf(self, given, transforms) if given.mount_from_tf else None
        self._transform_timeout = transforms.transform_timeout
        self._mount = _mount(self, given)
        self._detector = ElectrodeDetector(terminal, given.depth_range_min)
        self._camera = Camera(self, topics)
        self._tally = _Tally()
        self._looking = threading.Lock()
        self._detections = self.create_publisher(ElectrodeDetection, "electrode_detection", 10)
        self._pictures = self.create_publisher(Image, "electrode_detection/image", qos_profile_sensor_data)
        self._diagnostics = diagnostics.Diagnostics(self)
        self._missing = _missing_library()
        if self._missing:
            self._log.error(self._missing)
        group = ReentrantCallbackGroup()
        self.create_service(
            DetectElectrodes, "detect_electrodes", self._on_detect, callback_group=group, qos_profile=qos.SERVICE
        )
        clock.steady_timer(self, 1.0, self._diagnose)
        self._regularly = parameters.Regularly(self._watch, "detector", given.rate)

    def close(self) -> None:
        """Release waiting requests and stop the thread."""
        self._camera.close()
        if self._tf is not None:
            self._tf.close()
        self._regularly.stop()

    def _on_detect(
        self, request: DetectElectrodes.Request, response: DetectElectrodes.Response
    ) -> DetectElectrodes.Response:
        messages.unknown(response)
        limit = messages.seconds(request.timeout)
        if limit < 0.0:
            response.message = f"timeout is {limit:g} s; give 0 for the default of {_TIMEOUT:g} s, or more"
            return response
        if self._missing:
            response.message = self._missing
            return response
        limit = limit or _TIMEOUT
        deadline = time.monotonic() + limit
        refusal, late, images, old, number = "", "", 0, 0, self._camera.shots
        with self._camera.watching():
            while not images or time.monotonic() < deadline:  # detection may be slower than the camera
                if (shot := self._camera.after(number, deadline)) is None:
                    break
                number, images = shot.number, images + 1
                if problem := self._age_problem(shot):
                    late, old = problem, old + 1
                    continue
                message, refusal = self._examine(shot, deadline)
                if message is not None:
                    response.success, response.message, response.detection = True, "found", message
                    return response
            # The result of a fresh image is more useful than the age of a later one.
            refusal = refusal or late or self._camera.problem()
            refusal = refusal or "no image arrived in time; allow more than one image period"
        response.message = f"{refusal} ({images} images in {limit:.1f} s, {old} of them too old)"
        return response

    def _age_problem(self, shot: Shot) -> str:
        """Return why an image is too old or in the future; '' if it is current."""
        old = clock.age(self.get_clock(), 1e-9 * shot.stamp)
        oldest = self._given.image_age_max
        if -_FUTURE <= old <= oldest:
            return ""
        self._tally.stale += 1
        when = f"{old:.2f} s old" if old > 0.0 else f"stamped {-old:.2f} s in the future"
        return f"the image is {when} (image_age_max {oldest} s): check load, driver and clocks"

    def _examine(self, shot: Shot, deadline: float = math.inf) -> tuple[ElectrodeDetection | None, str]:
        """Detect, publish and return the electrodes of one image, or a reason; wait for tf until `deadline` at most."""
        with self._looking:
            started = time.perf_counter()
            try:
                image = shot.image()
                found = self._detector.detect(image)
            except errors.VisionError as error:
                return None, str(error)
            except Exception as error:  # no image of a stranger's camera may end the node
                self._log.error(f"the detector failed: {traceback.format_exc()}", pause=60.0)
                return None, f"the detector failed ({error!r}): report this with the node's log and the image"
            self._tally.milliseconds = 1e3 * (time.perf_counter() - started)
        self._tally.examined += 1
        self._show(image, found, shot)
        if found is None:
            return None, "no electrodes in the image: turn the robot toward the target, clear the view, check the light"
        self._tally.found += 1
        header = shot.color.header
        try:
            placed = self._mounted(header, deadline).place(found)
        except (TransformError, errors.MountError) as error:
            return None, f"the electrodes were found, but the camera's pose is unknown: {error}"
        message = detection_message(
            placed, header.stamp, found.confidence, found.range, self._charger_base, found.source
        )
        self._detections.publish(message)
        return message, ""

    def _mounted(self, header: Any, deadline: float = math.inf) -> mount.Mount:
        """Return the mount of an image's camera; wait for tf until `deadline` (s, monotonic) at most.

        Raises:
            TransformError: tf is in use and does not provide it.
        """
        if self._tf is None:
            return self._mount
        timeout = max(0.0, min(self._transform_timeout, deadline - time.monotonic()))
        found = self._tf.lookup(self._charger_base, header.frame_id, header.stamp, timeout)
        return mount.Mount.from_numbers(found)

    def _show(self, image: RgbdImage, found: Any, shot: Shot) -> None:
        if self._pictures.get_subscription_count():
            header = shot.color.header
            self._pictures.publish(color_message(annotated(image, found), header.stamp, header.frame_id))

    def _watch(self, period: float, stopping: threading.Event) -> None:
        """Detect at `rate` while there are subscribers."""
        while not stopping.wait(period):
            if not self._wanted():
                continue
            number = self._camera.shots
            with self._camera.watching():
                while self._wanted() and not stopping.is_set():
                    started = time.monotonic()
                    shot = self._camera.after(number, started + 0.5)
                    if shot is not None:
                        number = shot.number
                        if refusal := self._age_problem(shot) or self._examine(shot)[1]:
                            self._log.warning(refusal, pause=5.0)
                    stopping.wait(max(0.0, started + period - time.monotonic()))

    def _wanted(self) -> bool:
        if self._missing:
            return False
        return bool(self._detections.get_subscription_count() or self._pictures.get_subscription_count())

    def _diagnose(self) -> None:
        if not self.context.ok():
            return
        watched, problem = self._camera.watched, self._missing or self._camera.problem()
        took = texts.quantity(self._tally.milliseconds, ".1f", "ms")
        values = {**vars(self._tally), "milliseconds": took, "images": self._camera.shots}
        level = diagnostics.OK if not problem else diagnostics.ERROR if watched or self._missing else diagnostics.WARN
        text = problem or ("detecting" if watched else "idle; detects on request")
        self._diagnostics.report(level, text, values, "detector", self._camera.names[0])


def _mount(node: Node, given: DetectorNodeParameters) -> mount.Mount:
    """Return the camera's mount."""
    try:
        return mount.Mount.load(given.mount_file) if given.mount_file else mount.Mount.default()
    except (OSError, errors.MountError) as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error


def _tf(node: Node, given: DetectorNodeParameters, transforms: frames.TransformParameters) -> TfTree:
    """Return the tf tree for the camera's pose."""
    if given.mount_file:
        problem = "mount_from_tf and mount_file both define the camera's pose; give only one"
    elif not installed():
        problem = "mount_from_tf needs tf2_ros, which is part of a ROS installation; give mount_file"
    else:
        return TfTree(node, transforms)
    raise node_support.StartupError(f"{node.get_name()}: {problem}")


def _missing_library() -> str:
    """Load and set up OpenCV; return why that failed, or ''."""
    try:
        import cv2
    except ImportError as error:
        why = "is not installed" if isinstance(error, ModuleNotFoundError) else f"cannot be loaded ({error})"
        return f"OpenCV {why}: install it with pip install 'deltacharger[vision]', or python3-opencv"
    cv2.setNumThreads(1)  # one core for the camera; servos and pads need the others
    return ""


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(ElectrodeDetectorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
