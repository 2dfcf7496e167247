# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from deltacharger_vision.errors import CameraInfoError, ImageError
from deltacharger_vision.images import Intrinsics, RgbdImage

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


def test_every_kind_of_depth_becomes_metres_with_nan() -> None:
    millimetres = np.full((40, 64), 300, dtype=np.uint16)
    millimetres[3, 4] = 0
    for kind in (np.float32, np.float64):
        for unknown in (0.0, np.inf, -np.inf, np.nan):
            metres = np.full((40, 64), 0.3, dtype=kind)
            metres[3, 4] = unknown
            for given in (metres, millimetres, metres[:, :, None]):
                got = RgbdImage.make(COLOR, given, CAMERA).depth
                assert got.dtype == np.float32
                assert np.isnan(got[3, 4])
                assert np.isnan(got).sum() == 1
                np.testing.assert_allclose(np.delete(got.ravel(), 3 * 64 + 4), 0.3, rtol=1e-6)


def test_all_depth_may_be_unknown() -> None:
    for nothing in (np.zeros((40, 64), np.uint16), np.zeros((40, 64)), np.full((40, 64), np.nan)):
        assert np.isnan(RgbdImage.make(COLOR, nothing, CAMERA).depth).all()


def test_the_input_is_not_changed() -> None:
    depth = np.zeros((40, 64), dtype=np.float32)
    RgbdImage.make(COLOR, depth, CAMERA)
    assert (depth == 0).all()


def test_intrinsics_follow_the_size_of_the_image() -> None:
    color, depth = np.zeros((80, 128), np.uint8), np.zeros((80, 128), np.uint16)
    assert RgbdImage.make(color, depth, CAMERA).intrinsics == CAMERA.scaled(128, 80)


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
    twice = CAMERA.scaled(128, 80)
    # The corner of the image, half a pixel before the first centre, is the only fixed place.
    for camera in (CAMERA, twice):
        direction = np.linalg.inv(camera.matrix()) @ [-0.5, -0.5, 1.0]
        np.testing.assert_allclose(direction, [-32.0 / 44.0, -20.0 / 44.0, 1.0])
    back = twice.scaled(64, 40)
    assert (back.fx, back.cx, back.cy) == pytest.approx((CAMERA.fx, CAMERA.cx, CAMERA.cy))


@pytest.mark.parametrize(
    "wrong",
    [
        {"fx": 0.0},
        {"fy": -44.0},
        {"fx": float("nan")},
        {"cx": float("inf")},
        {"cy": 1e4},
        {"width": 0},
        {"width": 64.5},
        {"height": 10**6},
        {"fx": "44"},
        {"width": True},
        {"distortion": (0.1, 0.2)},
        {"distortion": (0.1, 0.0, 0.0, 0.0, float("nan"))},
        {"distortion": (1e9, 0.0, 0.0, 0.0, 0.0)},
    ],
    ids=str,
)
def test_intrinsics_have_bounds(wrong: dict[str, Any]) -> None:
    given = {"width": 64, "height": 40, "fx": 44.0, "fy": 44.0, "cx": 31.5, "cy": 19.5} | wrong
    with pytest.raises(CameraInfoError):
        Intrinsics(**given)
