# SPDX-License-Identifier: Apache-2.0
"""camera_node publishes an OAK-D, or a recording, on the usual topics of ROS RGB-D drivers.

Publishes: color/image_raw (rgb8), depth/image_raw (16UC1, mm, aligned to colour), color/camera_info, each converted
only while it has subscribers; /diagnostics (1 Hz, and at every change).
Parameters: rate, exposure_us, device_id, frame_prefix; replay.

If the camera is missing or unplugged, or depthai is not installed, the node reports it and keeps searching: a charger
can dock to coordinates without a camera. All three messages of an image have one stamp, the middle of the colour
exposure. depthai aligns the device's clock to this computer's monotonic clock. At publication, the image's age by that
clock is subtracted from ROS time, so steps of ROS time do no harm.
Other cameras have their own drivers and need no camera_node. Executable: `camera_node [--replay FILE]`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args

from deltacharger_core.frames import CAMERA, FrameParameters
from deltacharger_core.mcap_file import RecordingError
from deltacharger_ros import node_support
from deltacharger_ros.clock import steady_timer
from deltacharger_ros.diagnostics import ERROR, OK, Diagnostics
from deltacharger_ros.log import Log
from deltacharger_ros.parameters import declare_all, reject_unknown
from deltacharger_vision.cameras.oak_pipeline import (
    CameraKeeper,
    ImageSource,
    OakCamera,
    OakImage,
)
from deltacharger_vision.errors import VisionError
from deltacharger_vision.images import COLOR, INFO
from deltacharger_vision.parameters import CameraNodeParameters, OakSettings
from deltacharger_vision.ros.messages import CameraPublishers, stamp_ns
from deltacharger_vision.ros.recording import CameraRecording, Recorded, decoded

_DIAGNOSTICS_PERIOD = 1.0  # s
OpenOak = Callable[[OakSettings, Callable[[], bool], Callable[[OakImage], None]], OakCamera]
"""Opens a camera like `OakCamera`."""
_PAUSE = 0.05  # s between checks for subscribers
_JUMP = 1_000_000_000  # ns; a stamp that deviates by more belongs to another clock
_LEAST_GAP = 0.01  # s between passes of a recording whose images all have one time


class RecordingPlayer(ImageSource):
    """Publishes a recording again and again at its own pace, starting with the first subscriber.

    Stamps are shifted to the present and keep their intervals. Each colour image has a camera_info with its stamp.

    Args:
        recording: to publish.
        publishers: of the topics.
        on_change: called in its thread if `problem` changes.
    """

    def __init__(self, recording: CameraRecording, publishers: CameraPublishers, on_change: Callable[[], None]) -> None:
        super().__init__("", on_change)
        self._recording = recording
        self._publishers = publishers
        self._info = next((decoded(recording, each) for each in recording.messages(INFO)), None)

    def _run(self) -> None:
        while not self._publishers.wanted():
            if self._stop.wait(_PAUSE):
                return
        try:
            while not self._stop.is_set():
                self._play()
        except RecordingError as error:
            self._set_problem(str(error))

    def _play(self) -> None:
        """Publish the recording once, or until stopped."""
        started, first, shift = time.monotonic(), None, None
        for each in self._recording.messages():
            first = each.time if first is None else first
            lasted = 1e-9 * (each.time - first)
            if self._stop.wait(max(0.0, started + lasted - time.monotonic())):
                return
            if each.kind == INFO:
                self._info = decoded(self._recording, each)
            elif self._publishers.wanted(each.kind, INFO):
                shift = self._publish(each, shift)
        self._stop.wait(max(_LEAST_GAP, lasted / max(self._recording.images - 1, 1)))

    def _publish(self, each: Recorded, shift: int | None) -> int:
        """Publish an image and return the shift of its stamp, ns."""
        message, now = decoded(self._recording, each), self._publishers.now()
        stamp = stamp_ns(message)
        if shift is None or abs(stamp + shift - now) > _JUMP:
            shift = now - stamp
        if each.kind == COLOR and self._info is not None:
            self._publishers.recorded(INFO, self._info, stamp + shift)
        self._publishers.recorded(each.kind, message, stamp + shift)
        return shift


class CameraNode(Node):
    """See the module's docstring. Images are published from threads of depthai or of the replay.

    Args:
        open_camera: None = an OAK-D.
    """

    def __init__(self, open_camera: OpenOak | None = None, **kwargs: Any) -> None:
        super().__init__("camera_node", **kwargs)
        self._log = Log(self)
        self._given = declare_all(self, CameraNodeParameters)
        frames = declare_all(self, FrameParameters)
        reject_unknown(self)
        self._images = CameraPublishers(self, frames.named(CAMERA))
        self._diagnostics = Diagnostics(self)
        self._source: CameraKeeper | RecordingPlayer = (
            self._replay(Path(self._given.replay)) if self._given.replay else self._keeper(open_camera)
        )
        steady_timer(self, _DIAGNOSTICS_PERIOD, self._diagnose)
        self._source.start()

    def close(self) -> None:
        """Release the camera. Idempotent."""
        self._source.close()

    def _keeper(self, open_camera: OpenOak | None) -> CameraKeeper:
        opener = open_camera or OakCamera
        return CameraKeeper(lambda: opener(self._given, self._images.wanted, self._publish), self._report)

    def _replay(self, path: Path) -> RecordingPlayer:
        try:
            recording = CameraRecording(path)
            if not recording.images:
                raise node_support.StartupError(f"camera_node: {path}: {recording.topics.color} holds no images")
            return RecordingPlayer(recording, self._images, self._report)
        except FileNotFoundError as error:
            raise node_support.StartupError(f"camera_node: replay: {path}: there is no such file") from error
        except (OSError, VisionError, RecordingError) as error:
            raise node_support.StartupError(f"camera_node: replay: {error}") from error

    def _publish(self, taken: OakImage) -> None:
        self._images.image(taken.image, taken.time)

    def _report(self) -> None:
        """Log a change; runs in the source's thread."""
        problem = self._source.problem
        if problem:
            self._log.error(problem)
        else:
            self._log.info(f"camera {self._hardware()} connected")
        self._diagnose()

    def _hardware(self) -> str:
        return self._given.replay or getattr(self._source, "name", "") or self._given.device_id or "OAK-D"

    def _diagnose(self) -> None:
        if not self.context.ok():
            return
        problem = self._source.problem
        idle = not self._images.wanted()
        text = problem or ("no subscribers" if idle else "OK")
        values = {"images": self._images.published}
        self._diagnostics.report(ERROR if problem else OK, text, values, "camera", self._hardware())


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    parser = argparse.ArgumentParser(prog="camera_node", description="Publish the images of an OAK-D or a recording.")
    parser.add_argument("--replay", metavar="REC.mcap", help="publish a recording instead of a camera")
    given = list(sys.argv[1:] if args is None else args)
    try:
        own = remove_ros_args(given)
    except Exception:  # rclpy's own error classes; `run` refuses these
        own = []
    options = parser.parse_args(own)
    overrides = [Parameter("replay", value=options.replay)] if options.replay else []
    return node_support.run(lambda: CameraNode(parameter_overrides=overrides), ["camera_node", *given])


if __name__ == "__main__":
    raise SystemExit(main())
