# SPDX-License-Identifier: Apache-2.0
"""The host side of the OAK-D: real depthai without a device, and the keeper with a camera that is replugged."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_vision.cameras import keeper
from deltacharger_vision.cameras.keeper import CameraKeeper, CameraUnavailable
from deltacharger_vision.cameras.oak_pipeline import OakCamera, OakImage, OakSettings, attach, converted, find_device
from deltacharger_vision.errors import CameraInfoError, ImageError
from deltacharger_vision.images import Intrinsics

from ..waiting import DEADLINE, wait_until

NAME = "14442C10D13EABCE00"
MATRIX = [[441.0, 0.0, 319.5], [0.0, 440.0, 199.5], [0.0, 0.0, 1.0]]
RATIONAL = [6.5, -3.1, 0.0004, -0.0003, 0.9, 6.7, -2.4, 0.6]


@pytest.fixture
def depthai() -> Any:
    return pytest.importorskip("depthai", reason="drives an OAK-D with deltacharger[oak]")


class Frames:
    """Frames like those of an OAK-D; `number` is in every pixel."""

    def __init__(self, depthai: Any, width: int = 640, height: int = 400) -> None:
        self._depthai, self._shape = depthai, (height, width)

    def color(self, number: int, taken: Any, distortion: Any = (0.0,) * 14, model: str = "Perspective") -> Any:
        height, width = self._shape
        frame = self._frame("RGB888i", np.full((height, width, 3), (number, 100, 200), dtype=np.uint8), taken)
        kind = getattr(self._depthai.CameraModel, model)
        frame.setTransformation(self._depthai.ImgTransformation(width, height, MATRIX, kind, list(distortion)))
        return frame

    def depth(self, number: int, taken: Any) -> Any:
        return self._frame("RAW16", np.full(self._shape, 300 + number, dtype=np.uint16), taken)

    def _frame(self, kind: str, pixels: Any, taken: Any) -> Any:
        frame = self._depthai.ImgFrame()
        frame.setType(getattr(self._depthai.ImgFrame.Type, kind))
        frame.setHeight(self._shape[0])
        frame.setWidth(self._shape[1])
        frame.setData(pixels.reshape(-1).view(np.uint8))
        frame.setTimestamp(taken)
        frame.setTimestampDevice(taken)
        return frame


@pytest.fixture
def pipeline(depthai: Any) -> Iterator[Any]:
    """A pipeline without a device, stopped at the end."""
    found = depthai.Pipeline(createImplicitDevice=False)
    yield found
    if found.isRunning():
        found.stop()
        found.wait()  # Python nodes need the interpreter to end


def source(depthai: Any, pipeline: Any, count: int, lost: set[int], rate: float) -> Any:
    """A host node that sends `count` pairs, without the depth of the `lost` ones, and then stays alive."""
    frames = Frames(depthai)

    class Source(depthai.node.ThreadedHostNode):
        def __init__(self) -> None:
            super().__init__()
            self.color, self.depth, self.sent = self.createOutput(), self.createOutput(), 0

        def run(self) -> None:
            while self.isRunning():
                if self.sent < count:
                    taken = depthai.Clock.now()
                    self.color.send(frames.color(self.sent, taken))
                    if self.sent not in lost:
                        self.depth.send(frames.depth(self.sent, taken))
                    self.sent += 1
                time.sleep(1.0 / rate)

    return pipeline.create(Source)


def test_simultaneous_frames_become_images_and_late_ones_are_dropped(depthai: Any, pipeline: Any) -> None:
    """Through depthai's own synchronisation and the host node that converts them."""
    images, go_on = list[OakImage](), threading.Event()

    def take(color: Any, depth: Any) -> None:
        images.append(converted(color, depth))
        if len(images) == 5:
            go_on.wait(DEADLINE)

    count, lost, rate, began = 30, {3, 7}, 100.0, time.monotonic()
    node = source(depthai, pipeline, count, lost, rate)
    attach(pipeline, node.color, node.depth, rate, take)
    pipeline.start()
    wait_until(lambda: node.sent == count, "the last one sent")
    go_on.set()
    wait_until(lambda: images[-1].image.color[0, 0, 0] == count - 1, "the newest image")
    numbers = [int(each.image.color[0, 0, 0]) for each in images]
    assert numbers == sorted(set(numbers) - lost)
    assert len(numbers) < 2 * count // 3, "images that came late are not queued"
    for number, each in zip(numbers, images, strict=True):
        assert each.image.color.shape == (400, 640, 3)
        assert each.image.color[5, 9].tolist() == [number, 100, 200]
        np.testing.assert_allclose(each.image.depth, (300 + number) * 1e-3, atol=1e-6)
        assert each.image.intrinsics == Intrinsics(640, 400, 441.0, 440.0, 319.5, 199.5)
        assert began <= each.time <= time.monotonic()


def test_the_lens_matches_the_devices_calibration(depthai: Any) -> None:
    frames, now = Frames(depthai), depthai.Clock.now()
    found = converted(frames.color(1, now, RATIONAL + [0.0] * 6), frames.depth(1, now)).image
    np.testing.assert_allclose(found.intrinsics.distortion, RATIONAL, rtol=1e-6)
    thin, fisheye = (
        frames.color(1, now, [*RATIONAL, 0.1] + [0.0] * 5),
        frames.color(1, now, [0.1] + [0.0] * 3, "Fisheye"),
    )
    for color, depth, kind, noun in (
        (thin, frames.depth(1, now), CameraInfoError, "calibration"),
        (fisheye, frames.depth(1, now), CameraInfoError, "Fisheye"),
        (frames.color(1, now), Frames(depthai, 320, 200).depth(1, now), ImageError, "depth"),
    ):
        with pytest.raises(kind, match=noun):
            converted(color, depth)


class Bench:
    """depthai with a fake device: a host node sends its images, and its setup is recorded.

    Every name that is called on a node must be one of the real node's.
    """

    def __init__(self, depthai: Any, monkeypatch: pytest.MonkeyPatch, rate: float, count: int = 10_000) -> None:
        class Sink(depthai.node.ThreadedHostNode):
            def __init__(self) -> None:
                super().__init__()
                self.entry = self.createInput(blocking=False, queueSize=1)

            def run(self) -> None:
                pass

        self._depthai = depthai
        self.real = depthai.Pipeline(createImplicitDevice=False)
        self.feed = source(depthai, self.real, count, set(), rate)
        self._sink = self.real.create(Sink)
        self.cameras: list[Any] = []
        self.stereo = self._node(depthai.node.StereoDepth)
        self.stereo.depth, self.stereo.inputAlignTo = self.feed.depth, self._sink.entry
        self.device = self._node(depthai.Device)
        self.calibration = self.device.readCalibration.return_value = self._node(depthai.CalibrationHandler)
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
        camera = self._node(kind)
        camera.build.return_value = camera
        camera.initialControl = self._node(self._depthai.CameraControl)
        camera.requestOutput.return_value = self.feed.color if not self.cameras else mock.Mock()
        self.cameras.append(camera)
        return camera

    @staticmethod
    def _node(kind: Any) -> Any:
        return mock.create_autospec(kind, instance=True)


def test_the_camera_is_set_up_for_docking_and_reports_silence_and_loss(
    depthai: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deltacharger_vision.cameras.oak_pipeline._SILENCE", 0.2)
    bench, images, wanted = Bench(depthai, monkeypatch, 100.0, 30), [], [False]
    camera = OakCamera(OakSettings(rate=50.0, exposure_us=7000, iso=200), lambda: wanted[0], images.append)
    try:
        assert camera.name == NAME
        color, left, right = bench.cameras
        sockets = depthai.CameraBoardSocket
        assert [each.build.call_args.args[0] for each in bench.cameras] == [sockets.CAM_A, sockets.CAM_B, sockets.CAM_C]
        color.initialControl.setManualExposure.assert_called_once_with(7000, 200)
        color.initialControl.setManualFocus.assert_called_once_with(130)
        assert color.requestOutput.call_args.args == ((640, 400), depthai.ImgFrame.Type.RGB888i)
        assert color.requestOutput.call_args.kwargs == {"fps": 50.0, "enableUndistortion": True}
        left.requestOutput.return_value.link.assert_called_once_with(bench.stereo.left)
        right.requestOutput.return_value.link.assert_called_once_with(bench.stereo.right)
        for name in ("setExtendedDisparity", "setSubpixel", "setLeftRightCheck"):
            getattr(bench.stereo, name).assert_called_once_with(True)
        wait_until(lambda: bench.feed.sent > 10, "unwanted images")
        assert not images
        wanted[0] = True
        wait_until(lambda: images, "an image")
        assert images[-1].image.color.shape == (400, 640, 3)
        wait_until(lambda: f"{NAME} is silent" in camera.problem(), "the silence")
        bench.real.stop()
        wait_until(lambda: f"{NAME} is gone" in camera.problem(), "the loss")
    finally:
        camera.close()
    bench.device.close.assert_called_once_with()


def test_a_camera_that_cannot_be_opened_is_released_and_named(depthai: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(depthai, monkeypatch, 50.0)
    bench.device.readCalibration.side_effect = RuntimeError("no EEPROM")
    with pytest.raises(CameraUnavailable, match=f"{NAME} .* no EEPROM"):
        OakCamera(OakSettings(), lambda: True, lambda image: None)
    bench.device.close.assert_called_once_with()
    with pytest.raises(CameraUnavailable, match=f"other .* {NAME}"):
        OakCamera(OakSettings(device_id="other"), lambda: True, lambda image: None)
    bench.infos.clear()
    with pytest.raises(CameraUnavailable, match="no OAK camera found"):
        find_device("")


@pytest.mark.parametrize(
    "wrong", [{"rate": 0.5}, {"iso": 50}, {"width": 8}, {"exposure_us": 0}, {"lens_position": 256}], ids=str
)
def test_settings_have_bounds(wrong: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        OakSettings(**wrong)
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
        monkeypatch.setattr(keeper, name, 0.01)
    script: list[Camera | str] = ["none found", "none found", Camera("oak 1"), "none found", Camera("oak 2")]
    cameras = [each for each in script if isinstance(each, Camera)]
    changes: list[tuple[str, str]] = []

    def open_camera() -> Camera:
        next_one = script.pop(0)
        if isinstance(next_one, str):
            raise CameraUnavailable(next_one)
        return next_one

    CameraKeeper(open_camera, lambda: None).close()  # one that never started
    kept = CameraKeeper(open_camera, lambda: changes.append((kept.name, kept.problem)))
    assert kept.problem
    kept.start()
    wait_until(lambda: len(changes) == 2, "the camera")
    cameras[0].trouble = "oak 1 is gone"
    wait_until(lambda: len(changes) == 5, "the second camera")
    lost = [("", "none found"), ("oak 1", ""), ("oak 1", "oak 1 is gone"), ("oak 1", "none found"), ("oak 2", "")]
    assert changes == lost
    assert [each.closed for each in cameras] == [True, False]
    for _ in range(2):
        kept.close()
    assert cameras[1].closed
    assert len(changes) == 5
