# SPDX-License-Identifier: Apache-2.0
"""electrode_detector_node finds the target's electrodes in the images of any RGB-D camera.

Subscribes while detecting: color/image_raw, depth/image_raw (aligned to colour), color/camera_info.
Publishes: electrode_detection if it finds electrodes, electrode_detection/image (annotated, while it has subscribers),
/diagnostics (1 Hz).
Serves: detect_electrodes, which examines new images until it finds the electrodes or times out.
Parameters: rate (0 = on demand only), timeout and image_age_max may be set while the node runs; stamp_tolerance, the
topics, the depth's properties, the mount and the terminal's lengths may not.
It moves nothing. With a rate, it detects while electrode_detection has subscribers. Without OpenCV it keeps running,
reports the error and keeps trying to load it: a charger can dock to coordinates without a camera.
"""

from __future__ import annotations

import math
import threading
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from deltacharger.msg import ElectrodeDetection
from deltacharger.srv import DetectElectrodes
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image

from deltacharger_core.frames import CHARGER_BASE, TransformParameters
from deltacharger_core.quantity import quantity
from deltacharger_ros import node_support
from deltacharger_ros.clock import age, steady_timer
from deltacharger_ros.diagnostics import ERROR, OK, WARN, Diagnostics
from deltacharger_ros.frames import TfTree, TransformError, installed
from deltacharger_ros.log import Log
from deltacharger_ros.messages import seconds, unknown
from deltacharger_ros.parameters import declare_all, reject_unknown
from deltacharger_ros.qos import SERVICE
from deltacharger_ros.tuning import Regularly, Tuning
from deltacharger_vision.detector.annotate import annotated
from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.detector.electrode_detector_node_io import Camera, Shot
from deltacharger_vision.errors import MountError, VisionError
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.mount import Mount
from deltacharger_vision.parameters import DetectorNodeParameters
from deltacharger_vision.ros.detections import detection_message
from deltacharger_vision.ros.messages import color_message
from deltacharger_vision.terminal import Terminal

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
        self._log = Log(self)
        given, transforms = declare_all(self, DetectorNodeParameters), declare_all(self, TransformParameters)
        terminal = declare_all(self, Terminal)
        reject_unknown(self)
        self._given = given
        topics = [given.color_topic, given.depth_topic, given.camera_info_topic]
        self._charger_base = transforms.named(CHARGER_BASE)
        self._tf = _tf(self, given, transforms) if given.mount_from_tf else None
        self._transform_timeout = transforms.transform_timeout
        self._deviations = given.mount_position_stddev, given.mount_rotation_stddev
        self._mount = _mount(self, given)
        self._detector = ElectrodeDetector(terminal, given.depth_range_min, given.depth_bias)
        self._camera = Camera(self, given.stamp_tolerance, topics)
        self._tally = _Tally()
        self._looking = threading.Lock()
        self._detections = self.create_publisher(ElectrodeDetection, "electrode_detection", 10)
        self._pictures = self.create_publisher(Image, "electrode_detection/image", qos_profile_sensor_data)
        self._diagnostics = Diagnostics(self)
        self._missing = _missing_library()
        if self._missing:
            self._log.error(self._missing)
        group = ReentrantCallbackGroup()
        self.create_service(
            DetectElectrodes, "detect_electrodes", self._on_detect, callback_group=group, qos_profile=SERVICE
        )
        steady_timer(self, 1.0, self._diagnose)
        self._regularly = Regularly(self._watch, "detector")
        self._regularly.start(given.rate)
        Tuning(self, given, self._take)

    def close(self) -> None:
        """Release waiting requests and stop the thread."""
        self._camera.close()
        if self._tf is not None:
            self._tf.close()
        self._regularly.stop()

    def _take(self, given: DetectorNodeParameters) -> str:
        """Use other parameters; pending requests keep their timeout."""
        before, self._given = self._given, given
        if given.rate != before.rate:
            self._regularly.start(given.rate)
        return ""

    def _on_detect(
        self, request: DetectElectrodes.Request, response: DetectElectrodes.Response
    ) -> DetectElectrodes.Response:
        unknown(response)
        limit, usual = seconds(request.timeout), self._given.timeout
        if limit < 0.0:
            response.message = f"timeout is {limit:g} s; give 0 for the default of {usual:g} s, or more"
            return response
        if self._missing:
            response.message = self._missing
            return response
        deadline = time.monotonic() + (limit or usual)
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
        response.message = f"{refusal} ({images} images in {limit or usual:.1f} s, {old} of them too old)"
        return response

    def _age_problem(self, shot: Shot) -> str:
        """Return why an image is too old or in the future; '' if it is current."""
        old = age(self.get_clock(), 1e-9 * shot.stamp)
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
                image = shot.image(self._given.depth_unit)
                found = self._detector.detect(image)
            except VisionError as error:
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
        except (TransformError, MountError) as error:
            return None, f"the electrodes were found, but the camera's pose is unknown: {error}"
        message = detection_message(
            placed, header.stamp, found.confidence, found.range, self._charger_base, found.source
        )
        self._detections.publish(message)
        return message, ""

    def _mounted(self, header: Any, deadline: float = math.inf) -> Mount:
        """Return the mount of an image's camera; wait for tf until `deadline` (s, monotonic) at most.

        Raises:
            TransformError: tf is in use and does not provide it.
        """
        if self._tf is None:
            return self._mount
        timeout = max(0.0, min(self._transform_timeout, deadline - time.monotonic()))
        found = self._tf.lookup(self._charger_base, header.frame_id, header.stamp, timeout)
        return Mount.from_numbers(found, *self._deviations)

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
        if self._missing:
            self._missing = _missing_library()
        watched, problem = self._camera.watched, self._missing or self._camera.problem()
        took = quantity(self._tally.milliseconds, ".1f", "ms")
        values = {**vars(self._tally), "milliseconds": took, "images": self._camera.shots}
        level = OK if not problem else ERROR if watched or self._missing else WARN
        text = problem or ("detecting" if watched else "idle; detects on request")
        self._diagnostics.report(level, text, values, "detector", self._camera.names[0])


def _mount(node: Node, given: DetectorNodeParameters) -> Mount:
    """Return the camera's mount."""
    seven, deviations = given.mount, (given.mount_position_stddev, given.mount_rotation_stddev)
    try:
        return Mount.load(given.mount_file) if given.mount_file else Mount.from_numbers(seven, *deviations)
    except (OSError, MountError) as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error


def _tf(node: Node, given: DetectorNodeParameters, transforms: TransformParameters) -> TfTree:
    """Return the tf tree for the camera's pose."""
    if given.mount_file:
        problem = "mount_from_tf and mount_file both define the camera's pose; give only one"
    elif not installed():
        problem = "mount_from_tf needs tf2_ros, which is part of a ROS installation; give mount_file or mount"
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
