# SPDX-License-Identifier: Apache-2.0
"""The host side of the OAK-D: real depthai without a device, and the keeper with a camera that is replugged."""

import threading
import time
from functools import partial
from typing import Any
from unittest import mock

import numpy as np
import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_vision.cameras import oak_pipeline
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.parameters import OakSettings

from ..waiting import DEADLINE, wait_until

NAME = "14442C10D13EABCE00"
MATRIX = [[441.0, 0.0, 319.5], [0.0, 440.0, 199.5], [0.0, 0.0, 1.0]]


@pytest.fixture
def depthai() -> Any:
    return pytest.importorskip("depthai", reason="drives an OAK-D with deltacharger[oak]")


def frame(depthai: Any, kind: str, pixels: Any, taken: Any) -> Any:
    made = depthai.ImgFrame()
    made.setType(getattr(depthai.ImgFrame.Type, kind))
    made.setHeight(pixels.shape[0])
    made.setWidth(pixels.shape[1])
    made.setData(pixels.reshape(-1).view(np.uint8))
    made.setTimestamp(taken)
    made.setTimestampDevice(taken)
    return made


def pair(depthai: Any, number: int) -> Any:
    """Simultaneous colour and depth like those of an OAK-D, with `number` in every pixel."""
    taken = depthai.Clock.now()
    color = frame(depthai, "RGB888i", np.full((400, 640, 3), (number, 100, 200), dtype=np.uint8), taken)
    color.setTransformation(depthai.ImgTransformation(640, 400, MATRIX, depthai.CameraModel.Perspective, [0.0] * 14))
    return color, frame(depthai, "RAW16", np.full((400, 640), 300 + number, dtype=np.uint16), taken)


COUNT, LOST = 60, range(1, 60, 3)
"""Pairs that a device sends, and those of them without depth."""
fake = partial(mock.create_autospec, instance=True)
"""A substitute of a node: every name that is called must be one of the real node's."""


class Bench:
    """depthai with a fake device: a host node sends its images at 100 Hz, and its setup is recorded."""

    def __init__(self, depthai: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        class Source(depthai.node.ThreadedHostNode):
            def __init__(self) -> None:
                super().__init__()
                self.color, self.depth, self.sent = self.createOutput(), self.createOutput(), 0
                self.entry = self.createInput(blocking=False, queueSize=1)

            def run(self) -> None:
                while self.isRunning():  # stays alive after the last one
                    if self.sent < COUNT:
                        color, depth = pair(depthai, self.sent)
                        self.color.send(color)
                        if self.sent not in LOST:
                            self.depth.send(depth)
                        self.sent += 1
                    time.sleep(0.01)

        self._depthai = depthai
        self.real = depthai.Pipeline(createImplicitDevice=False)
        self.feed = self.real.create(Source)
        self.cameras: list[Any] = []
        self.stereo, self.device = fake(depthai.node.StereoDepth), fake(depthai.Device)
        self.stereo.depth, self.stereo.inputAlignTo = self.feed.depth, self.feed.entry
        self.calibration = self.device.readCalibration.return_value = fake(depthai.CalibrationHandler)
        self.calibration.getLensPosition.return_value = 130
        self.infos = [depthai.DeviceInfo(NAME)]
        found = mock.Mock(return_value=self.device, getAllAvailableDevices=lambda: self.infos)
        monkeypatch.setattr(depthai, "Device", found)
        monkeypatch.setattr(depthai, "Pipeline", lambda device: self)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.real, name)

    def create(self, kind: Any) -> Any:
        if kind is self._depthai.node.StereoDepth:
            return self.stereo
        if kind is not self._depthai.node.Camera:
            return self.real.create(kind)
        camera = fake(kind)
        camera.build.return_value = camera
        camera.initialControl = fake(self._depthai.CameraControl)
        camera.requestOutput.return_value = self.feed.color if not self.cameras else mock.Mock()
        self.cameras.append(camera)
        return camera


def test_the_camera_is_set_up_for_docking_sends_the_newest_images_and_reports_silence_and_loss(
    depthai: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through depthai's own synchronisation and the host node that converts frames."""
    monkeypatch.setattr("deltacharger_vision.cameras.oak_pipeline._SILENCE", 0.2)
    bench, images, wanted, go_on = (
        Bench(depthai, monkeypatch),
        list[oak_pipeline.OakImage](),
        threading.Event(),
        threading.Event(),
    )

    def take(image: oak_pipeline.OakImage) -> None:
        images.append(image)
        if len(images) == 5:
            go_on.wait(DEADLINE)

    began = time.monotonic()
    camera = oak_pipeline.OakCamera(OakSettings(rate=50.0, exposure_us=7000), wanted.is_set, take)
    try:
        assert camera.name == NAME
        color, left, right = bench.cameras
        sockets = depthai.CameraBoardSocket
        assert [each.build.call_args.args[0] for each in bench.cameras] == [sockets.CAM_A, sockets.CAM_B, sockets.CAM_C]
        color.initialControl.setManualExposure.assert_called_once_with(7000, 400)
        color.initialControl.setManualFocus.assert_called_once_with(130)
        assert color.requestOutput.call_args.args == ((640, 400), depthai.ImgFrame.Type.RGB888i)
        assert color.requestOutput.call_args.kwargs == {"fps": 50.0, "enableUndistortion": True}
        left.requestOutput.return_value.link.assert_called_once_with(bench.stereo.left)
        right.requestOutput.return_value.link.assert_called_once_with(bench.stereo.right)
        for name in ("setExtendedDisparity", "setSubpixel", "setLeftRightCheck"):
            getattr(bench.stereo, name).assert_called_once_with(True)
        wait_until(lambda: bench.feed.sent > 10, "unwanted images")
        assert not images
        wanted.set()
        wait_until(lambda: bench.feed.sent == COUNT, "the last one sent")
        go_on.set()
        wait_until(lambda: images[-1].image.color[0, 0, 0] == COUNT - 1, "the newest image")
        wait_until(lambda: f"{NAME} is silent" in camera.problem(), "the silence")
        bench.real.stop()
        wait_until(lambda: f"{NAME} is gone" in camera.problem(), "the loss")
    finally:
        go_on.set()
        camera.close()
    bench.device.close.assert_called_once_with()
    numbers = [int(each.image.color[0, 0, 0]) for each in images]
    assert numbers == sorted(set(numbers) - set(LOST))
    assert len(numbers) < COUNT // 2, "images that came late are not queued"
    first = images[0]
    assert first.image.color[5, 9].tolist() == [numbers[0], 100, 200]
    np.testing.assert_allclose(first.image.depth, (300 + numbers[0]) * 1e-3, atol=1e-6)
    assert first.image.intrinsics == Intrinsics(640, 400, 441.0, 440.0, 319.5, 199.5)
    assert began <= first.time <= time.monotonic()


def test_a_camera_that_cannot_be_opened_is_released_and_named(depthai: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(depthai, monkeypatch)
    bench.device.readCalibration.side_effect = RuntimeError("no EEPROM")
    with pytest.raises(oak_pipeline.CameraUnavailable, match=f"{NAME} .* no EEPROM"):
        oak_pipeline.OakCamera(OakSettings(), lambda: True, lambda image: None)
    bench.device.close.assert_called_once_with()
    with pytest.raises(oak_pipeline.CameraUnavailable, match=f"other .* {NAME}"):
        oak_pipeline.OakCamera(OakSettings(device_id="other"), lambda: True, lambda image: None)
    bench.infos.clear()
    with pytest.raises(oak_pipeline.CameraUnavailable, match="no OAK camera found"):
        oak_pipeline.find_device("")


def test_the_exposure_fits_into_one_image() -> None:
    with pytest.raises(ParameterError, match="16667"):
        OakSettings(rate=60.0, exposure_us=20_000)


class Camera:
    """Delivers until a problem is set."""

    def __init__(self, name: str) -> None:
        self.name, self.trouble, self.closed = name, "", False

    def problem(self) -> str:
        return self.trouble

    def close(self) -> None:
        self.closed = True


def test_a_replugged_camera_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_SHORTEST_BACKOFF", "_LOOK"):
        monkeypatch.setattr(oak_pipeline, name, 0.01)
    first, second = cameras = Camera("oak 1"), Camera("oak 2")
    script: list[Camera | str] = ["none found", "none found", first, "none found", second]
    changes: list[tuple[str, str]] = []

    def open_camera() -> Camera:
        next_one = script.pop(0)
        if isinstance(next_one, str):
            raise oak_pipeline.CameraUnavailable(next_one)
        return next_one

    kept = oak_pipeline.CameraKeeper(open_camera, lambda: changes.append((kept.name, kept.problem)))
    kept.start()
    wait_until(lambda: len(changes) == 2, "the camera")
    first.trouble = "oak 1 is gone"
    wait_until(lambda: len(changes) == 5, "the second camera")
    lost = [("", "none found"), ("oak 1", ""), ("oak 1", "oak 1 is gone"), ("oak 1", "none found"), ("oak 2", "")]
    assert changes == lost
    assert [each.closed for each in cameras] == [True, False]
    kept.close()
    assert second.closed
