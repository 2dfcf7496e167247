# SPDX-License-Identifier: Apache-2.0
"""An OAK-D through depthai 3: search, setup for docking, images as arrays; and what keeps any camera running.

Independent of ROS.
Colour is undistorted, because depth is aligned to ideal pixels. Each image carries its own intrinsics, which the device
derives from its calibration. If that calibration is too old to undistort, the image carries distortion coefficients.
Exposure and focus are locked: bars must not be over-exposed, and intrinsics hold at one focus only.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from deltacharger_vision import errors, images, parameters
from deltacharger_vision.cameras.ros_formats import from_camera_info

_SHORTEST_BACKOFF, _LONGEST_BACKOFF = 0.5, 4.0  # s
_LOOK = 0.1  # s between checks of an open camera


class CameraUnavailable(errors.VisionError, RuntimeError):
    """No camera, or one without images; the message names it and states what to do."""


class CameraKeeper:
    """A thread that keeps one camera open, reconnected whenever it returns, until closed.

    Attributes:
        problem: why there are no images; '' while they arrive.
        name: of the open camera, or the last one; '' before.

    Args:
        open_camera: finds and opens it; raises CameraUnavailable on failure.
        on_change: called in the keeper's thread whenever `problem` changes.
    """

    def __init__(self, open_camera: Callable[[], OakCamera], on_change: Callable[[], None]) -> None:
        self.problem = "searching for the camera"
        self.name = ""
        self._open, self._on_change = open_camera, on_change
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)

    def start(self) -> None:
        """Start looking for the camera."""
        self._thread.start()

    def close(self) -> None:
        """Stop the thread and release the camera. Idempotent."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _set_problem(self, problem: str) -> None:
        if problem != self.problem:
            self.problem = problem
            self._on_change()

    def _run(self) -> None:
        backoff = _SHORTEST_BACKOFF
        while not self._stop.is_set():
            try:
                camera = self._open()
            except CameraUnavailable as error:
                self._set_problem(str(error))
            else:
                backoff = _SHORTEST_BACKOFF
                self._watch(camera)
            self._stop.wait(backoff)
            backoff = min(2.0 * backoff, _LONGEST_BACKOFF)

    def _watch(self, camera: OakCamera) -> None:
        """Return when the camera stops delivering; the device is then released."""
        self.name = camera.name
        try:
            self._set_problem("")
            while not (problem := camera.problem()):
                if self._stop.wait(_LOOK):
                    return
            self._set_problem(problem)
        finally:
            camera.close()


_SIZE = (640, 400)
"""px of colour and of each stereo image: with extended disparity, depth starts at 0.174 m."""
_ISO = 400
"""Sensitivity of the colour camera (assumed)."""
_SILENCE, _FIRST_IMAGE = 2.0, 10.0
"""s without an image until the camera counts as silent: while running, and after opening."""

Take = Callable[[Any, Any], None]
"""Receives simultaneous colour and depth frames (depthai.ImgFrame)."""


@dataclass(frozen=True)
class OakImage:
    """One image and its time.

    Attributes:
        time: s by time.monotonic, middle of the exposure; depthai keeps the device's clock aligned to it.
        image: colour and depth.
    """

    time: float
    image: images.RgbdImage


class OakCamera:
    """An open OAK-D.

    Args:
        settings: its setup.
        wanted: whether the next image is needed; others are not converted.
        take: called with images, in a depthai thread.

    Attributes:
        name: id of the device.

    Raises:
        CameraUnavailable: no device, or it cannot be opened.
    """

    def __init__(
        self, settings: parameters.OakSettings, wanted: Callable[[], bool], take: Callable[[OakImage], None]
    ) -> None:
        info = find_device(settings.device_id)
        self.name = str(info.getDeviceId())
        self._wanted, self._on_image = wanted, take
        self._failure = ""
        self._due = math.inf
        self._device = self._pipeline = None
        try:
            import depthai

            self._device = depthai.Device(info)
            self._device.setMaxReconnectionAttempts(0)  # the keeper reconnects and reports it
            self._pipeline = depthai.Pipeline(self._device)
            color, depth = _sources(self._pipeline, self._device.readCalibration(), settings)
            attach(self._pipeline, color, depth, settings.rate, self._take)
            self._due = time.monotonic() + _FIRST_IMAGE
            self._pipeline.start()
        except Exception as error:  # RuntimeError or depthai's own classes
            self.close()
            raise CameraUnavailable(f"OAK camera {self.name} cannot be opened: {error}") from error

    def problem(self) -> str:
        """Return why images stopped; '' while they arrive."""
        if self._failure:
            return f"OAK camera {self.name}: {self._failure}"
        if self._pipeline is None or not self._pipeline.isRunning():
            return f"OAK camera {self.name} is gone: check its cable and its power"
        if time.monotonic() > self._due:
            return f"OAK camera {self.name} is silent: check its cable (USB 3) and its power"
        return ""

    def close(self) -> None:
        """Stop the pipeline and release the device."""
        pipeline, device = self._pipeline, self._device
        ends = [*((pipeline.stop, pipeline.wait) if pipeline else ()), *((device.close,) if device else ())]
        for end in ends:  # its threads run Python, so they must end before the pipeline is deleted
            with contextlib.suppress(Exception):  # an unplugged device cannot be stopped
                end()

    def _take(self, color: Any, depth: Any) -> None:
        self._due = time.monotonic() + _SILENCE
        if not self._wanted():
            return
        try:
            self._on_image(converted(color, depth))
        except errors.VisionError as error:
            self._failure = str(error)


def find_device(device_id: str) -> Any:
    """Return the depthai.DeviceInfo of an available device.

    Args:
        device_id: id or name; '' = any.

    Raises:
        CameraUnavailable: no device (after 0.5 s), or depthai is missing or does not work.
    """
    try:
        import depthai

        found = depthai.Device.getAllAvailableDevices()
    except ModuleNotFoundError as error:
        if error.name != "depthai":
            raise CameraUnavailable(f"depthai cannot be loaded: {error}") from error
        raise CameraUnavailable(
            "depthai is not installed: install it with pip install 'deltacharger[oak]', or start your camera's own "
            "driver instead of camera_node"
        ) from error
    except Exception as error:  # RuntimeError or depthai's own classes; a wrong build raises ImportError
        raise CameraUnavailable(f"cameras cannot be listed: depthai reports {error}") from error
    for info in found:
        if not device_id or device_id in (info.getDeviceId(), info.name):
            return info
    which = f"OAK camera {device_id}" if device_id else "OAK camera"
    others = f"; there is {', '.join(info.getDeviceId() for info in found)}" if found else ""
    raise CameraUnavailable(
        f"no {which} found{others}: plug it in; check its cable, the udev rule for USB vendor 03e7, and whether "
        "another program uses it"
    )


def attach(pipeline: Any, color: Any, depth: Any, rate: float, take: Take) -> None:
    """Pass simultaneous colour and depth frames to `take` on the host; if it is slow, only the newest.

    Args:
        pipeline: depthai.Pipeline, with or without a device.
        color: output (depthai.Node.Output) of colour frames.
        depth: output of depth frames.
        rate: of both, Hz.
        take: called in a thread of the pipeline.
    """
    import depthai

    class ImageHost(depthai.node.HostNode):
        """Passes groups of frames to `take`."""

        def process(self, group):  # type: ignore[no-untyped-def]  # depthai evaluates annotations, not strings
            take(group[images.COLOR], group[images.DEPTH])

    sync = pipeline.create(depthai.node.Sync)
    sync.setRunOnHost(True)
    sync.setSyncThreshold(timedelta(seconds=0.5 / rate))
    for output, name in ((color, images.COLOR), (depth, images.DEPTH)):
        output.link(sync.inputs[name])
        sync.inputs[name].setBlocking(False)
        sync.inputs[name].setMaxSize(4)
    host = pipeline.create(ImageHost)
    host.link_args(sync.out)


def converted(color: Any, depth: Any) -> OakImage:
    """Return the image of an RGB888i frame and a RAW16 frame in mm (depthai.ImgFrame).

    Raises:
        VisionError: the frames do not match, or their intrinsics are unusable.
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
    return OakImage(taken, images.RgbdImage.make(color.getFrame(), depth.getFrame(), intrinsics))


def _sources(pipeline: Any, calibration: Any, settings: parameters.OakSettings) -> tuple[Any, Any]:
    """Return the outputs of colour and aligned depth."""
    import depthai

    sockets = depthai.CameraBoardSocket
    camera = pipeline.create(depthai.node.Camera).build(sockets.CAM_A)
    camera.initialControl.setManualExposure(settings.exposure_us, _ISO)
    if lens := calibration.getLensPosition(sockets.CAM_A):  # 0 if the focus is fixed
        camera.initialControl.setManualFocus(lens)
    color = camera.requestOutput(_SIZE, depthai.ImgFrame.Type.RGB888i, fps=settings.rate, enableUndistortion=True)
    stereo = pipeline.create(depthai.node.StereoDepth)
    stereo.setExtendedDisparity(True)
    stereo.setSubpixel(True)
    stereo.setLeftRightCheck(True)
    for socket, entry in ((sockets.CAM_B, stereo.left), (sockets.CAM_C, stereo.right)):
        pipeline.create(depthai.node.Camera).build(socket).requestOutput(_SIZE, fps=settings.rate).link(entry)
    color.link(stereo.inputAlignTo)
    return color, stereo.depth
