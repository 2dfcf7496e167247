# SPDX-License-Identifier: Apache-2.0
"""An OAK-D through depthai 3: found, set up for docking, its images as arrays. No ROS.

Colour comes undistorted, as depth is aligned to ideal pixels; each image tells its own intrinsics, which the device
derives from its calibration. A device whose calibration is too old to undistort says so by its coefficients, which go
along. Exposure and focus are locked: bars must not be over-exposed, and intrinsics hold at one focus only.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from deltacharger_core.parameters import Bounded, ParameterError, number, words
from deltacharger_vision.cameras.camera_info import from_camera_info
from deltacharger_vision.cameras.keeper import CameraUnavailable
from deltacharger_vision.errors import VisionError
from deltacharger_vision.images import COLOR, DEPTH, RgbdImage

_STEREO = (640, 400)
"""px of each stereo image: with extended disparity, depth begins at 0.174 m there."""
_SILENCE, _FIRST_IMAGE = 2.0, 10.0
"""s without an image before it counts as gone: while it runs, and after it was opened."""

Take = Callable[[Any, Any], None]
"""Takes a colour and a depth frame (depthai.ImgFrame) of one instant."""


@dataclass(frozen=True)
class OakSettings(Bounded):
    """How an OAK-D is set up.

    Raises:
        ParameterError: a value is out of bounds, or the exposure takes longer than one image.
    """

    width: int = number(640, 160, 1920, "px", "width of colour and depth")
    height: int = number(400, 100, 1200, "px", "height of colour and depth")
    rate: float = number(15.0, 1.0, 60.0, "Hz", "images per second")
    exposure_us: int = number(10_000, 1, 33_000, "µs", "exposure of the colour camera (assumed)")
    iso: int = number(400, 100, 1600, "", "sensitivity of the colour camera (assumed)")
    lens_position: int = number(-1, -1, 255, "", "focus of the colour camera; -1 = where it was calibrated")
    device_id: str = words("", "id or name of the camera; '' = any")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exposure_us > 1e6 / self.rate:
            longest = f"{self.exposure_us} is outside 1 to {1e6 / self.rate:.0f} µs at this rate"
            raise ParameterError("exposure_us", self.exposure_us, longest)


@dataclass(frozen=True)
class OakImage:
    """One image and when it was taken.

    Attributes:
        time: s by time.monotonic, middle of the exposure; depthai keeps the device's clock aligned to it.
        image: colour and depth.
    """

    time: float
    image: RgbdImage


class OakCamera:
    """An open OAK-D that delivers.

    Args:
        settings: how it is set up.
        wanted: whether anybody wants the next image; the others are not converted.
        take: called with images, from a thread of depthai's.

    Attributes:
        name: id of the device.

    Raises:
        CameraUnavailable: there is none, or it cannot be opened.
    """

    def __init__(self, settings: OakSettings, wanted: Callable[[], bool], take: Callable[[OakImage], None]) -> None:
        info = find_device(settings.device_id)
        self.name = str(info.getDeviceId())
        self._wanted, self._on_image = wanted, take
        self._failure = ""
        self._due = math.inf
        self._device = self._pipeline = None
        try:
            import depthai

            self._device = depthai.Device(info)
            self._device.setMaxReconnectionAttempts(0)  # the keeper looks for it again, and says so
            self._pipeline = depthai.Pipeline(self._device)
            color, depth = _sources(self._pipeline, self._device.readCalibration(), settings)
            attach(self._pipeline, color, depth, settings.rate, self._take)
            self._due = time.monotonic() + _FIRST_IMAGE
            self._pipeline.start()
        except Exception as error:  # depthai raises RuntimeError and kinds of its own
            self.close()
            raise CameraUnavailable(f"OAK camera {self.name} cannot be opened: {error}") from error

    def problem(self) -> str:
        """Return why it delivers no more, '' while it does."""
        if self._failure:
            return f"OAK camera {self.name}: {self._failure}"
        if self._pipeline is None or not self._pipeline.isRunning():
            return f"OAK camera {self.name} is gone: look at its cable and its power"
        if time.monotonic() > self._due:
            return f"OAK camera {self.name} is silent: look at its cable (USB 3) and its power"
        return ""

    def close(self) -> None:
        """Stop the pipeline and release the device."""
        pipeline, device = self._pipeline, self._device
        ends = [*((pipeline.stop, pipeline.wait) if pipeline else ()), *((device.close,) if device else ())]
        for end in ends:  # its threads run Python, so they must have ended before the pipeline is forgotten
            with contextlib.suppress(Exception):  # an unplugged device cannot be told to stop
                end()

    def _take(self, color: Any, depth: Any) -> None:
        self._due = time.monotonic() + _SILENCE
        if not self._wanted():
            return
        try:
            self._on_image(converted(color, depth))
        except VisionError as error:
            self._failure = str(error)


def find_device(device_id: str) -> Any:
    """Return the depthai.DeviceInfo of a device that may be opened.

    Args:
        device_id: id or name; '' = any.

    Raises:
        CameraUnavailable: there is none, which takes 0.5 s, or depthai is not installed or does not work.
    """
    try:
        import depthai

        found = depthai.Device.getAllAvailableDevices()
    except ModuleNotFoundError as error:
        if error.name != "depthai":
            raise CameraUnavailable(f"depthai cannot be loaded: {error}") from error
        raise CameraUnavailable(
            "depthai is not installed: install it with pip install 'deltacharger[oak]', or start your camera's own "
            "driver in place of camera_node"
        ) from error
    except Exception as error:  # depthai raises RuntimeError and kinds of its own; a wrong build, ImportError
        raise CameraUnavailable(f"cameras cannot be looked for: depthai says {error}") from error
    for info in found:
        if not device_id or device_id in (info.getDeviceId(), info.name):
            return info
    which = f"OAK camera {device_id}" if device_id else "OAK camera"
    others = f"; there is {', '.join(info.getDeviceId() for info in found)}" if found else ""
    raise CameraUnavailable(
        f"no {which} found{others}: plug it in and look at its cable, at the udev rule for USB vendor 03e7, and for "
        "another program that uses it"
    )


def attach(pipeline: Any, color: Any, depth: Any, rate: float, take: Take) -> None:
    """Hand colour and depth of one instant to `take`, which is called on the host; of late ones the newest counts.

    Args:
        pipeline: depthai.Pipeline, with or without a device.
        color: output (depthai.Node.Output) of colour frames.
        depth: output of depth frames.
        rate: of both, Hz.
        take: called from a thread of the pipeline's.
    """
    import depthai

    class ImageHost(depthai.node.HostNode):
        """Hands groups of frames to `take`."""

        def process(self, group):  # type: ignore[no-untyped-def]  # depthai reads annotations, and not as text
            take(group[COLOR], group[DEPTH])

    sync = pipeline.create(depthai.node.Sync)
    sync.setRunOnHost(True)
    sync.setSyncThreshold(timedelta(seconds=0.5 / rate))
    for output, name in ((color, COLOR), (depth, DEPTH)):
        output.link(sync.inputs[name])
        sync.inputs[name].setBlocking(False)
        sync.inputs[name].setMaxSize(4)
    host = pipeline.create(ImageHost)
    host.link_args(sync.out)


def converted(color: Any, depth: Any) -> OakImage:
    """Return the image of an RGB888i frame and a RAW16 frame in mm (depthai.ImgFrame).

    Raises:
        VisionError: they do not belong together, or the frame's intrinsics cannot be used.
    """
    import depthai

    seen = color.getTransformation()
    coefficients = seen.getDistortionCoefficients()
    model = "rational_polynomial" if any(coefficients) else "none"
    if any(coefficients) and seen.getDistortionModel() != depthai.CameraModel.Perspective:
        model = str(seen.getDistortionModel().name)
    matrix = np.ravel(seen.getIntrinsicMatrix()).tolist()
    intrinsics = from_camera_info(
        color.getWidth(), color.getHeight(), matrix, coefficients, model, "the device's calibration"
    )
    taken = color.getTimestamp(depthai.CameraExposureOffset.MIDDLE).total_seconds()
    return OakImage(taken, RgbdImage.make(color.getFrame(), depth.getFrame(), intrinsics))


def _sources(pipeline: Any, calibration: Any, settings: OakSettings) -> tuple[Any, Any]:
    """Return the outputs of colour and of depth aligned to it."""
    import depthai

    sockets = depthai.CameraBoardSocket
    camera = pipeline.create(depthai.node.Camera).build(sockets.CAM_A)
    camera.initialControl.setManualExposure(settings.exposure_us, settings.iso)
    lens = calibration.getLensPosition(sockets.CAM_A) if settings.lens_position < 0 else settings.lens_position
    if lens:  # 0 where the focus is fixed
        camera.initialControl.setManualFocus(lens)
    color = camera.requestOutput(
        (settings.width, settings.height), depthai.ImgFrame.Type.RGB888i, fps=settings.rate, enableUndistortion=True
    )
    stereo = pipeline.create(depthai.node.StereoDepth)
    stereo.setExtendedDisparity(True)
    stereo.setSubpixel(True)
    stereo.setLeftRightCheck(True)
    for socket, entry in ((sockets.CAM_B, stereo.left), (sockets.CAM_C, stereo.right)):
        pipeline.create(depthai.node.Camera).build(socket).requestOutput(_STEREO, fps=settings.rate).link(entry)
    color.link(stereo.inputAlignTo)
    return color, stereo.depth
