# SPDX-License-Identifier: Apache-2.0
"""Arrays become RGB and metres; intrinsics and lens distortion."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from deltacharger_vision.errors import CameraInfoError, ImageError
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.projection import distort, undistort

from .views import DISTORTIONS

CAMERA = Intrinsics(64, 40, 44.0, 44.0, 31.5, 19.5)
COLOR = np.arange(40 * 64 * 3, dtype=np.uint32).reshape(40, 64, 3).astype(np.uint8)
DEPTH = np.full((40, 64), 0.3, dtype=np.float32)


def test_every_kind_of_colour_becomes_the_same_rgb() -> None:
    gray = COLOR[:, :, 0]
    alpha = np.full((40, 64, 1), 7, dtype=np.uint8)
    for given in (COLOR, np.concatenate([COLOR, alpha], axis=2), COLOR.astype(np.uint16) * 257):
        np.testing.assert_array_equal(RgbdImage.make(given, DEPTH, CAMERA).color, COLOR)
    for given in (gray, gray[:, :, None], gray.astype(np.uint16) << 8):
        got = RgbdImage.make(given, DEPTH, CAMERA).color
        np.testing.assert_array_equal(got, np.repeat(gray[:, :, None], 3, axis=2))


@pytest.mark.parametrize("unknown", [0.0, np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint16])
def test_every_kind_of_depth_becomes_metres_with_nan(kind: type, unknown: float) -> None:
    given = np.full((40, 64), 300 if kind is np.uint16 else 0.3, dtype=kind)
    given[3, 4] = 0 if kind is np.uint16 else unknown
    for each in (given, given[:, :, None]):
        got = RgbdImage.make(COLOR, each, CAMERA).depth
        assert got.dtype == np.float32
        assert np.argwhere(np.isnan(got)).tolist() == [[3, 4]]
        np.testing.assert_allclose(np.delete(got.ravel(), 3 * 64 + 4), 0.3, rtol=1e-6)


@pytest.mark.parametrize(
    ("color", "depth", "name", "words"),
    [
        (COLOR, DEPTH[:, :50], "depth", "aligned"),
        (COLOR[:, :, :2], DEPTH, "color", "RGBA"),
        (COLOR.astype(float), DEPTH, "color", "uint8"),
        (COLOR.astype(np.int16), DEPTH, "color", "uint8"),
        (COLOR[:0], DEPTH[:0], "color", "shape"),
        (COLOR, DEPTH[:0], "depth", "shape"),
        (COLOR, np.stack([DEPTH, DEPTH]), "depth", "shape"),
        (COLOR, DEPTH * 1000, "depth", "millimetres"),
        (COLOR, -DEPTH, "depth", "negative"),
        (COLOR, DEPTH.astype(np.int32), "depth", "uint16"),
        (COLOR, DEPTH.astype(np.uint8), "depth", "uint16"),
        (COLOR[:, :60], DEPTH[:, :60], "intrinsics", "aspect"),
        (COLOR[:8, :8], DEPTH[:8, :8], "color", "16"),
    ],
)
def test_invalid_arrays_are_refused(color: Any, depth: Any, name: str, words: str) -> None:
    with pytest.raises(ImageError, match=words) as caught:
        RgbdImage.make(color, depth, CAMERA)
    assert caught.value.source == name


def test_a_scaled_camera_shows_the_same_point_at_the_same_place() -> None:
    depth = np.zeros((80, 128), np.float32)
    image = RgbdImage.make(np.zeros((80, 128), np.uint8), depth, CAMERA)
    assert np.isnan(image.depth).all()
    assert not depth.any(), "the input is not changed"
    assert image.intrinsics == CAMERA.scaled(128, 80)
    # The corner of the image, half a pixel before the first centre, is the only fixed place.
    for camera in (CAMERA, image.intrinsics, image.intrinsics.scaled(64, 40)):
        direction = np.linalg.inv(camera.matrix()) @ [-0.5, -0.5, 1.0]
        np.testing.assert_allclose(direction, [-32.0 / 44.0, -20.0 / 44.0, 1.0])


@pytest.mark.parametrize(
    "wrong",
    [
        *({"fx": value} for value in (0.0, -44.0, math.nan, "44")),
        *({"cx": value} for value in (math.inf, 1e4)),
        *({"width": value} for value in (0, 64.5, 10**6, True)),
        *({"distortion": value} for value in ((0.1, 0.2), (0.1, 0.0, 0.0, 0.0, math.nan), (1e9, 0.0, 0.0, 0.0, 0.0))),
    ],
    ids=str,
)
def test_intrinsics_have_bounds(wrong: dict[str, Any]) -> None:
    with pytest.raises(CameraInfoError):
        Intrinsics(**{"width": 64, "height": 40, "fx": 44.0, "fy": 44.0, "cx": 31.5, "cy": 19.5} | wrong)


GRID = np.stack(np.meshgrid(np.linspace(-0.73, 0.73, 21), np.linspace(-0.46, 0.46, 15)), axis=-1)


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_distorting_and_undistorting_cancel(distortion: tuple[float, ...]) -> None:
    np.testing.assert_allclose(distort(undistort(GRID, distortion), distortion), GRID, atol=1e-9)
    np.testing.assert_allclose(undistort(distort(GRID, distortion), distortion), GRID, atol=1e-8)


@pytest.mark.parametrize("distortion", DISTORTIONS[1:])
def test_the_distortion_matches_opencv(distortion: tuple[float, ...]) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    points = np.concatenate([GRID, np.ones((*GRID.shape[:2], 1))], axis=-1).reshape(-1, 1, 3)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(distortion))
    np.testing.assert_allclose(distort(GRID, distortion), theirs.reshape(GRID.shape), atol=1e-12)


def test_a_lens_that_folds_the_image_is_refused() -> None:
    with pytest.raises(CameraInfoError, match="calibrate"):
        undistort(GRID, (-3.0, 0.0, 0.0, 0.0, 0.0))
