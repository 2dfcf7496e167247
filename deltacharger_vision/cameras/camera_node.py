# SPDX-License-Identifier: Apache-2.0
"""camera_node publishes an OAK-D on the usual topics of ROS RGB-D drivers.

Publishes: color/image_raw (rgb8), depth/image_raw (16UC1, mm, aligned to colour), color/camera_info, each converted
only while it has subscribers; /diagnostics (1 Hz, and at every change).
Parameters: rate, exposure_us, device_id, frame_prefix.

If the camera is missing or unplugged, or depthai is not installed, the node reports it and keeps searching: a charger
can dock to coordinates without a camera. All three messages of an image have one stamp, the middle of the colour
exposure. depthai aligns the device's clock to this computer's monotonic clock. At publication, the image's age by that
clock is subtracted from ROS time, so steps of ROS time do no harm.
Other cameras have their own drivers and need no camera_node.
"""

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node

from deltacharger_core.frames import CAMERA, FrameParameters
from deltacharger_core.ros import clock, diagnostics, log, node_support, parameters
from deltacharger_vision.cameras.oak_pipeline import CameraKeeper, OakCamera, OakImage
from deltacharger_vision.parameters import OakSettings
from deltacharger_vision.ros.messages import CameraPublishers

_DIAGNOSTICS_PERIOD = 1.0  # s
OpenOak = Callable[[OakSettings, Callable[[], bool], Callable[[OakImage], None]], OakCamera]
"""Opens a camera like `OakCamera`."""


class CameraNode(Node):
    """See the module's docstring. Images are published from threads of depthai.

    Args:
        open_camera: None = an OAK-D.
    """

    def __init__(self, open_camera: OpenOak | None = None, **kwargs: Any) -> None:
        super().__init__("camera_node", **kwargs)
        self._log = log.Log(self)
        self._given = parameters.declare_all(self, OakSettings)
        frames = parameters.declare_all(self, FrameParameters)
        parameters.reject_unknown(self)
        self._images = CameraPublishers(self, frames.named(CAMERA))
        self._diagnostics = diagnostics.Diagnostics(self)
        opener = open_camera or OakCamera
        self._keeper = CameraKeeper(lambda: opener(self._given, self._images.wanted, self._publish), self._report)
        clock.steady_timer(self, _DIAGNOSTICS_PERIOD, self._diagnose)
        self._keeper.start()

    def close(self) -> None:
        """Release the camera. Idempotent."""
        self._keeper.close()

    def _publish(self, taken: OakImage) -> None:
        self._images.image(taken.image, taken.time)

    def _report(self) -> None:
        """Log a change; runs in the keeper's thread."""
        problem = self._keeper.problem
        if problem:
            self._log.error(problem)
        else:
            self._log.info(f"camera {self._hardware()} connected")
        self._diagnose()

    def _hardware(self) -> str:
        return self._keeper.name or self._given.device_id or "OAK-D"

    def _diagnose(self) -> None:
        if not self.context.ok():
            return
        problem = self._keeper.problem
        idle = not self._images.wanted()
        text = problem or ("no subscribers" if idle else "OK")
        values = {"images": self._images.published}
        self._diagnostics.report(
            diagnostics.ERROR if problem else diagnostics.OK, text, values, "camera", self._hardware()
        )


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(CameraNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
