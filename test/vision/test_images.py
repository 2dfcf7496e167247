# SPDX-License-Identifier: Apache-2.0
"""Arrays and files become RGB and metres; intrinsics and lens distortion."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_vision.errors import CameraInfoError, ImageError
from deltacharger_vision.image_files import read_color, read_depth, read_rgbd, write_picture
from deltacharger_vision.images import Intrinsics, RgbdImage, distort, undistort

from .views import DISTORTIONS

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

CAMERA = Intrinsics(64, 40, 44.0, 44.0, 31.5, 19.5)
COLOR = np.arange(40 * 64 * 3, dtype=np.uint32).reshape(40, 64, 3).astype(np.uint8)
DEPTH = np.full((40, 64), 0.3, dtype=np.float32)


def test_every_kind_of_colour_becomes_the_same_rgb() -> None:
    gray, alpha = COLOR[:, :, 0], np.full((40, 64, 1), 7, dtype=np.uint8)
    for given in (COLOR, np.concatenate([COLOR, alpha], axis=2)):
        np.testing.assert_array_equal(RgbdImage.make(given, DEPTH, CAMERA).color, COLOR)
    for given in (gray, gray[:, :, None]):
        np.testing.assert_array_equal(RgbdImage.make(given, DEPTH, CAMERA).color, gray[:, :, None].repeat(3, axis=2))


@pytest.mark.parametrize("unknown", [0.0, np.inf, np.nan])
@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint16])
def test_every_kind_of_depth_becomes_metres_with_nan(kind: type, unknown: float) -> None:
    given = np.full((40, 64), 300 if kind is np.uint16 else 0.3, dtype=kind)
    given[3, 4] = (65535 if unknown else 0) if kind is np.uint16 else unknown
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
        (COLOR.astype(np.uint16), DEPTH, "color", "8 bits"),
        (COLOR[:0], DEPTH[:0], "color", "shape"),
        (COLOR, DEPTH[:0], "depth", "shape"),
        (COLOR, DEPTH * 1000, "depth", "millimetres"),
        (COLOR, -DEPTH, "depth", "negative"),
        (COLOR, DEPTH.astype(np.int32), "depth", "uint16"),
        (COLOR[:, :60], DEPTH[:, :60], "intrinsics", "cuts or bins"),
        (COLOR[:8, :8], DEPTH[:8, :8], "color", "16"),
    ],
)
def test_invalid_arrays_are_refused(color: Any, depth: Any, name: str, words: str) -> None:
    with pytest.raises(ImageError, match=words) as caught:
        RgbdImage.make(color, depth, CAMERA)
    assert caught.value.source == name


def test_a_scaled_or_binned_camera_shows_the_same_point_at_the_same_place() -> None:
    # The corner of the image, half a pixel before the first centre, is the only fixed place.
    large = CAMERA.scaled(128, 80)
    for camera in (CAMERA, large, large.binned(2, 2), large.binned(5, 3)):
        direction = np.linalg.inv(camera.matrix()) @ [-0.5, -0.5, 1.0]
        np.testing.assert_allclose(direction, [-32.0 / 44.0, -20.0 / 44.0, 1.0])


@pytest.mark.parametrize(
    "wrong",
    [
        *({"fx": value} for value in (0.0, math.nan, "44")),
        {"cx": 1e4},
        *({"width": value} for value in (0, 64.5, True)),
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
    points = np.concatenate([GRID, np.ones((*GRID.shape[:2], 1))], axis=-1).reshape(-1, 1, 3)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(distortion))
    np.testing.assert_allclose(distort(GRID, distortion), theirs.reshape(GRID.shape), atol=1e-12)


def noise(kind: type, *shape: int) -> np.ndarray:
    return np.random.default_rng(5).integers(0, np.iinfo(kind).max, shape, dtype=kind)


def encoded(pixels: np.ndarray, suffix: str = ".png") -> bytes:
    """Encode RGB or RGBA with OpenCV."""
    order = [2, 1, 0, 3][: pixels.shape[2]] if pixels.ndim == 3 else None
    return bytes(cv2.imencode(suffix, pixels if order is None else np.ascontiguousarray(pixels[:, :, order]))[1])


def stored(path: Path, pixels: np.ndarray) -> Path:
    path.write_bytes(encoded(pixels, path.suffix))
    return path


@pytest.mark.parametrize("shape", [(40, 64), (40, 64, 3), (40, 64, 4)], ids=["gray", "rgb", "rgba"])
def test_a_png_keeps_its_pixels_and_the_order_of_its_channels(tmp_path: Path, shape: tuple[int]) -> None:
    pixels = noise(np.uint8, *shape)
    np.testing.assert_array_equal(read_color(stored(tmp_path / "a.png", pixels)), pixels)


def test_depth_keeps_its_values_and_an_rgbd_image_has_metres_and_unknowns(tmp_path: Path) -> None:
    millimetres = noise(np.uint16, 40, 64)
    np.testing.assert_array_equal(read_depth(stored(tmp_path / "a.png", millimetres)), millimetres)
    for array in (millimetres, (millimetres * 1e-3).astype(np.float32), millimetres * 1e-3):
        np.save(tmp_path / "a.npy", array)
        found = read_depth(tmp_path / "a.npy")
        assert found.dtype == array.dtype
        np.testing.assert_array_equal(found, array)
    color = stored(tmp_path / "a.png", noise(np.uint8, 40, 64, 3))
    depth = np.full((40, 64), 1234, dtype=np.uint16)
    depth[0, 0] = 0
    image = read_rgbd(color, stored(tmp_path / "d.png", depth), CAMERA)
    assert np.isnan(image.depth[0, 0])
    np.testing.assert_allclose(image.depth.ravel()[1:], 1.234)
    assert np.isnan(read_rgbd(color, None, CAMERA).depth).all()


@pytest.mark.parametrize(
    ("name", "content", "noun"),
    [
        ("d.png", encoded(noise(np.uint8, 40, 64)), "8 bits"),
        ("d.npy", b"no array", "NPY"),
        ("d.npy", np.full((40, 64), 300.0), "metres"),
        ("a.png", b"\x89PNG\r\n", "image"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, name: str, content: Any, noun: str) -> None:
    color, wrong = stored(tmp_path / "a.png", noise(np.uint8, 40, 64, 3)), tmp_path / name
    if isinstance(content, bytes):
        wrong.write_bytes(content)
    else:
        np.save(wrong, content, allow_pickle=True)
    with pytest.raises(ImageError, match=noun) as refused:
        read_rgbd(color, wrong if wrong != color else None, CAMERA)
    assert str(wrong) in str(refused.value)


def test_a_written_picture_reads_back_unchanged(tmp_path: Path) -> None:
    picture = noise(np.uint8, 40, 64, 3)
    write_picture(tmp_path / "out.png", picture)
    np.testing.assert_array_equal(read_color(tmp_path / "out.png"), picture)


def test_a_missing_library_is_named_with_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(ModuleNotFoundError, match=r"\[vision\]"):
        read_color(stored(tmp_path / "a.png", COLOR))
