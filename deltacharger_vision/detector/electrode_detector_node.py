# SPDX-License-Identifier: Apache-2.0
"""electrode_detector_node: where the target's electrodes are, from the images of any RGB-D camera.

Subscribes, only while it looks: color/image_raw, depth/image_raw (aligned to colour), color/camera_info.
Publishes: electrode_detection when it found something, electrode_detection/image (what it saw, annotated, while
somebody listens), /diagnostics (1 Hz).
Serves: detect_electrodes, which looks at fresh images until the electrodes are found or its time is over.
Parameters: rate (0 = on demand only), timeout and image_age_max, which may be set while the node runs;
stamp_tolerance, the topics, the mount, the terminal's lengths.
It drives nothing. With a rate it looks while somebody subscribes to electrode_detection. Without OpenCV it lives, says
so and looks for it again: a charger docks to coordinates without it.
"""

from __future__ import annotations

import math
import threading
import time
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
from deltacharger_ros.clock import steady_timer
from deltacharger_ros.diagnostics import ERROR, OK, WARN, Diagnostics
from deltacharger_ros.log import Log
from deltacharger_ros.messages import seconds
from deltacharger_ros.parameters import declare_all, reject_unknown
from deltacharger_ros.qos import SERVICE
from deltacharger_ros.regularly import Regularly
from deltacharger_ros.tf_tree import TfTree, TransformError, installed
from deltacharger_ros.tuning import Tuning
from deltacharger_ros.unknown import unknown
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

_FUTURE = 0.05  # s by which a stamp may be ahead of this computer's clock


@dataclass
class _Tally:
    """What became of the images so far."""

    looked: int = 0
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
        self._detector = ElectrodeDetector(terminal)
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
        """Release waiting requests and end the thread."""
        self._camera.close()
        if self._tf is not None:
            self._tf.close()
        self._regularly.stop()

    def _take(self, given: DetectorNodeParameters) -> str:
        """Look with other parameters; requests under way go on with the timeout that they began with."""
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
            while not images or time.monotonic() < deadline:  # looks may be slower than images come
                if (shot := self._camera.after(number, deadline)) is None:
                    break
                number, images = shot.number, images + 1
                if problem := self._age_problem(shot):
                    late, old = problem, old + 1
                    continue
                message, refusal = self._look(shot, deadline)
                if message is not None:
                    response.success, response.message, response.detection = True, "found", message
                    return response
            # What a fresh image shows says more than that another one came late.
            refusal = refusal or late or self._camera.problem()
            refusal = refusal or "no image came in time; allow more than one image's time"
        response.message = f"{refusal} ({images} images in {limit or usual:.1f} s, {old} of them too old)"
        return response

    def _age_problem(self, shot: Shot) -> str:
        """Return why an image is of another time than now; empty = it is not."""
        age = 1e-9 * (self.get_clock().now().nanoseconds - shot.stamp)
        oldest = self._given.image_age_max
        if -_FUTURE <= age <= oldest:
            return ""
        self._tally.stale += 1
        when = f"{age:.2f} s old" if age > 0.0 else f"stamped {-age:.2f} s in the future"
        return f"the image is {when} (image_age_max {oldest} s): check load, driver and clocks"

    def _look(self, shot: Shot, deadline: float = math.inf) -> tuple[ElectrodeDetection | None, str]:
        """Return what one image shows, published, or why it shows nothing; tf is waited for until then at most."""
        with self._looking:
            started = time.perf_counter()
            try:
                image = shot.image()
                found = self._detector.detect(image)
            except VisionError as error:
                return None, str(error)
            self._tally.milliseconds = 1e3 * (time.perf_counter() - started)
        self._tally.looked += 1
        self._show(image, found, shot)
        if found is None:
            return None, "no electrodes in the image: turn the robot toward the target, clear the view, check the light"
        self._tally.found += 1
        header = shot.color.header
        try:
            placed = self._mounted(header, deadline).place(found)
        except (TransformError, MountError) as error:
            return None, f"the electrodes are seen, but not where the camera is: {error}"
        message = detection_message(placed, header.stamp, found.confidence, found.range, self._charger_base)
        self._detections.publish(message)
        return message, ""

    def _mounted(self, header: Any, deadline: float = math.inf) -> Mount:
        """Return where the camera of an image is; tf is waited for until `deadline` (s, monotonic) at most.

        Raises:
            TransformError: tf, where it is asked, does not know it now.
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
        """Look at `rate` while somebody wants to know."""
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
                        if refusal := self._age_problem(shot) or self._look(shot)[1]:
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
        text = problem or ("looking" if watched else "idle; looks when asked")
        self._diagnostics.tell(level, text, values, "detector", self._camera.names[0])


def _mount(node: Node, given: DetectorNodeParameters) -> Mount:
    """Return where the camera is."""
    seven, deviations = given.mount, (given.mount_position_stddev, given.mount_rotation_stddev)
    try:
        return Mount.load(given.mount_file) if given.mount_file else Mount.from_numbers(seven, *deviations)
    except (OSError, MountError) as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error


def _tf(node: Node, given: DetectorNodeParameters, transforms: TransformParameters) -> TfTree:
    """Return the transforms that tell where the camera is."""
    if given.mount_file:
        problem = "mount_from_tf and mount_file both say where the camera is; give one of them"
    elif not installed():
        problem = "mount_from_tf needs tf2_ros, which comes with a ROS installation; give mount_file or mount"
    else:
        return TfTree(node, transforms)
    raise node_support.StartupError(f"{node.get_name()}: {problem}")


def _missing_library() -> str:
    """Return why no image can be looked at; '' where OpenCV is there, which is then set up."""
    try:
        import cv2
    except ImportError as error:
        why = "is not installed" if isinstance(error, ModuleNotFoundError) else f"cannot be loaded ({error})"
        return f"OpenCV {why}: install it with pip install 'deltacharger[vision]', or python3-opencv"
    cv2.setNumThreads(1)  # one core for the camera; the others belong to servos and pads
    return ""


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(ElectrodeDetectorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
