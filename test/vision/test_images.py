# SPDX-License-Identifier: Apache-2.0
"""Arrays, files and messages become RGB, metres and intrinsics; lens distortion; colour and depth pair by stamp."""

from __future__ import annotations

import itertools
import math
from array import array
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from deltacharger_vision import errors, image_files, images
from deltacharger_vision.cameras.ros_formats import Readout, color_array, depth_array, from_camera_info

from .views import DISTORTIONS

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

CAMERA = images.Intrinsics(64, 40, 44.0, 44.0, 31.5, 19.5)
PIXELS = np.arange(40 * 64 * 3, dtype=np.uint32).reshape(40, 64, 3).astype(np.uint8)
METRES = np.full((40, 64), 0.3, dtype=np.float32)


def test_every_kind_of_colour_becomes_the_same_rgb() -> None:
    gray, alpha = PIXELS[:, :, 0], np.full((40, 64, 1), 7, dtype=np.uint8)
    for each in (PIXELS, np.concatenate([PIXELS, alpha], axis=2)):
        np.testing.assert_array_equal(images.RgbdImage.make(each, METRES, CAMERA).color, PIXELS)
    for each in (gray, gray[:, :, None]):
        np.testing.assert_array_equal(
            images.RgbdImage.make(each, METRES, CAMERA).color, gray[:, :, None].repeat(3, axis=2)
        )


@pytest.mark.parametrize(
    ("kind", "metre", "unknown"), [(np.float32, 1, np.inf), (np.float64, 1, 0), (np.uint16, 1000, 65535)]
)
def test_every_kind_of_depth_becomes_metres_with_nan(kind: type, metre: int, unknown: float) -> None:
    given = np.full((40, 64), 0.3 * metre, dtype=kind)
    given[3, 4] = unknown
    for each in (given, given[:, :, None]):
        got = images.RgbdImage.make(PIXELS, each, CAMERA).depth
        assert got.dtype == np.float32
        assert np.argwhere(np.isnan(got)).tolist() == [[3, 4]]
        np.testing.assert_allclose(np.delete(got.ravel(), 3 * 64 + 4), 0.3, rtol=1e-6)


@pytest.mark.parametrize(
    ("color", "depth", "name", "words"),
    [
        (PIXELS, METRES[:, :50], "depth", "aligned"),
        (PIXELS[:, :, :2], METRES, "color", "RGBA"),
        (PIXELS.astype(np.uint16), METRES, "color", "8 bits"),
        (PIXELS, METRES * 1000, "depth", "millimetres"),
        (PIXELS, -METRES, "depth", "negative"),
        (PIXELS[:, :60], METRES[:, :60], "intrinsics", "cuts or bins"),
        (PIXELS[:8, :8], METRES[:8, :8], "color", "16"),
    ],
)
def test_invalid_arrays_are_refused(color: Any, depth: Any, name: str, words: str) -> None:
    with pytest.raises(errors.ImageError, match=words) as caught:
        images.RgbdImage.make(color, depth, CAMERA)
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
        {"width": 64.5},
        *({"distortion": value} for value in ((0.1, 0.2), (0.1, 0.0, 0.0, 0.0, math.nan))),
    ],
    ids=str,
)
def test_intrinsics_have_bounds(wrong: dict[str, Any]) -> None:
    with pytest.raises(errors.CameraInfoError):
        images.Intrinsics(**{"width": 64, "height": 40, "fx": 44.0, "fy": 44.0, "cx": 31.5, "cy": 19.5} | wrong)


GRID = np.stack(np.meshgrid(np.linspace(-0.73, 0.73, 21), np.linspace(-0.46, 0.46, 15)), axis=-1)


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_distorting_and_undistorting_cancel(distortion: tuple[float, ...]) -> None:
    np.testing.assert_allclose(images.distort(images.undistort(GRID, distortion), distortion), GRID, atol=1e-9)
    np.testing.assert_allclose(images.undistort(images.distort(GRID, distortion), distortion), GRID, atol=1e-8)


@pytest.mark.parametrize("distortion", DISTORTIONS[1:])
def test_the_distortion_matches_opencv(distortion: tuple[float, ...]) -> None:
    points = np.concatenate([GRID, np.ones((*GRID.shape[:2], 1))], axis=-1).reshape(-1, 1, 3)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(distortion))
    np.testing.assert_allclose(images.distort(GRID, distortion), theirs.reshape(GRID.shape), atol=1e-12)


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
    np.testing.assert_array_equal(image_files.read_color(stored(tmp_path / "a.png", pixels)), pixels)
    if shape == (40, 64, 3):
        image_files.write_picture(tmp_path / "b.png", pixels)
        np.testing.assert_array_equal(image_files.read_color(tmp_path / "b.png"), pixels)


def test_a_file_of_depth_is_in_millimetres_as_png_and_in_metres_as_npy(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", METRES)
    np.testing.assert_array_equal(image_files.read_depth(tmp_path / "a.npy"), METRES)
    color = stored(tmp_path / "a.png", noise(np.uint8, 40, 64, 3))
    depth = stored(tmp_path / "d.png", np.full((40, 64), 1234, dtype=np.uint16))
    np.testing.assert_allclose(image_files.read_rgbd(color, depth, CAMERA).depth, 1.234)
    assert np.isnan(image_files.read_rgbd(color, None, CAMERA).depth).all()


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
    with pytest.raises(errors.ImageError, match=noun) as refused:
        image_files.read_rgbd(color, wrong if wrong != color else None, CAMERA)
    assert str(wrong) in str(refused.value)


CALIBRATION = """\
image_width: 640
image_height: 400
camera_name: oak
camera_matrix: {rows: 3, cols: 3, data: [441.0, 0, 320.1, 0, 442.0, 199.2, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.001, -0.002, 0.003]}
"""
ECHOED = """\
height: 400
width: 640
distortion_model: plumb_bob
d: [-0.1, 0.02, 0.001, -0.002, 0.003]
k: [441.0, 0.0, 320.1, 0.0, 442.0, 199.2, 0.0, 0.0, 1.0]
binning_x: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
height: 1
"""
EXPECTED = images.Intrinsics(640, 400, 441.0, 442.0, 320.1, 199.2, (-0.1, 0.02, 0.001, -0.002, 0.003))
K = [441.0, 0.0, 320.1, 0.0, 442.0, 199.2, 0.0, 0.0, 1.0]


def loaded(folder: Path, text: str) -> images.Intrinsics:
    path = folder / "camera.yaml"
    path.write_text(text)
    return image_files.load_camera_info(path)


def test_both_formats_give_the_same_intrinsics(tmp_path: Path) -> None:
    assert [loaded(tmp_path, text) for text in (CALIBRATION, ECHOED)] == [EXPECTED] * 2


def test_no_missing_and_extra_coefficients_are_zero() -> None:
    plain = images.Intrinsics(640, 400, 441.0, 442.0, 320.1, 199.2)
    for d, model in (([], ""), ([], "none"), ([0.0] * 5, "none"), ([0.0] * 5, "plumb_bob"), ([0.0] * 14, "plumb_bob")):
        assert from_camera_info(640, 400, K, d, model) == plain
    four = from_camera_info(640, 400, K, [-0.1, 0.02, 0.001, -0.002], "plumb_bob")
    assert four.distortion == (-0.1, 0.02, 0.001, -0.002, 0.0)
    eight = (1.0, 2.0, 0.0, 0.0, 3.0, 4.0, 5.0, 6.0)
    assert from_camera_info(640, 400, K, [*eight, *[0.0] * 6], "rational_polynomial").distortion == eight


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("441.0, 0, 320.1, 0, 442.0, 199.2, 0, 0, 1", "0, 0, 0, 0, 0, 0, 0, 0, 0", "calibrate the camera first"),
        ("441.0, 0, 320.1", "wide, 0, 320.1", "not a number"),
        ("plumb_bob", "equidistant", "equidistant"),
        ("image_width: 640\n", "", "image_width"),
        ("camera_name: oak", "roi: {x_offset: 10, y_offset: 5, width: 640, height: 400}", "complete image"),
    ],
)
def test_errors_of_a_bad_file_state_what_to_do(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in CALIBRATION
    with pytest.raises(errors.CameraInfoError, match=words) as caught:
        loaded(tmp_path, CALIBRATION.replace(old, new))
    assert str(tmp_path) in caught.value.source


def test_region_and_binning_give_the_intrinsics_of_the_image_that_is_sent() -> None:
    found = from_camera_info(640, 400, K, [], "none", readout=Readout(10, 20, 621, 361, 2, 2))
    assert (found.width, found.height) == (310, 180)
    assert (found.fx, found.fy, found.cx, found.cy) == pytest.approx((220.5, 221.0, 154.8, 89.35))


RGB = np.random.default_rng(3).integers(0, 256, (18, 21, 3), dtype=np.uint8)


def packed(pixels: np.ndarray, padding: int = 0) -> tuple[int, array[int]]:
    """Return step and data of rows with some bytes of padding after each."""
    flat = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
    rows = np.pad(flat, ((0, 0), (0, padding)), constant_values=7)
    return rows.shape[1], array("B", rows.tobytes())


def message(encoding: str, height: int, width: int, step: int, data: Any, big: bool = False) -> SimpleNamespace:
    fields = {"encoding": encoding, "height": height, "width": width, "step": step, "data": data}
    return SimpleNamespace(**fields, is_bigendian=int(big))


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("8UC3", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0])],
)
def test_colour_is_converted_to_rgb(encoding: str, order: list[int]) -> None:
    assert np.array_equal(color_array(message(encoding, 18, 21, *packed(RGB[:, :, order], 5))), RGB)


@pytest.mark.parametrize(("big", "kind"), [(False, "<u2"), (True, ">u2")])
def test_sixteen_bits_are_read_in_either_byte_order(big: bool, kind: str) -> None:
    wide = RGB[:, :, 0].astype(np.uint16) * 256 + 3
    assert np.array_equal(depth_array(message("16UC1", 18, 21, *packed(wide.astype(kind), 4), big)), wide)


def test_gray_yuv_and_metres_keep_their_values() -> None:
    gray, metres = RGB[:, :20, 0], np.array([[0.5, np.nan], [np.inf, 0.25]], dtype=np.float32)
    yuyv = np.stack([gray, np.full((18, 20), 128, np.uint8)], axis=2)
    for encoding, pixels in (("mono8", gray), ("yuv422_yuy2", yuyv), ("yuv422", yuyv[:, :, ::-1])):
        assert np.array_equal(color_array(message(encoding, 18, 20, *packed(pixels))), gray)
    assert np.array_equal(depth_array(message("32FC1", 2, 2, *packed(metres))), metres, equal_nan=True)


@pytest.mark.parametrize(
    ("read", "encoding", "height", "step", "size", "noun"),
    [
        (color_array, "bayer_rggb8", 18, 63, 900, "raw"),
        (depth_array, "rgb8", 18, 63, 18 * 63, "16UC1"),
        (color_array, "rgb8", 18, 62, 18 * 63, "color"),
        (color_array, "x" * 1_000_000, 18, 63, 18 * 63, "color"),
    ],
    ids=range(4),
)
def test_another_encoding_and_contradictory_fields_are_refused(
    read: Any, encoding: str, height: int, step: int, size: int, noun: str
) -> None:
    with pytest.raises(errors.ImageError, match=noun) as refused:
        read(message(encoding, height, 21, step, bytes(size)))
    assert len(str(refused.value)) < 1000


PERIOD = 33_333_333  # ns, of 30 images a second
MS = 1_000_000

Arrival = tuple[str, int]

arrivals = st.lists(st.tuples(st.sampled_from((images.COLOR, images.DEPTH)), st.integers(0, 400)), max_size=120)


def paired(items: Iterable[Arrival], matcher: images.StampMatcher[Arrival] | None = None) -> list[tuple[int, int]]:
    """Return the stamps of the colours and depths that are paired; each item is its own image."""
    matcher, found = matcher or images.StampMatcher(), []
    for kind, stamp in items:
        pair = matcher.add_image(kind, stamp, (kind, stamp))
        if pair is not None:
            assert pair[1] == (images.COLOR, pair[0])
            found.append((pair[0], pair[2][1]))
    return found


@given(items=arrivals)
def test_pairs_are_near_and_in_order_and_memory_is_bounded(items: list[Arrival]) -> None:
    matcher: images.StampMatcher[Arrival] = images.StampMatcher()
    found = paired([(kind, stamp * MS) for kind, stamp in items], matcher)
    assert all(abs(color - depth) <= images.STAMP_TOLERANCE for color, depth in found)
    for one, two in itertools.pairwise(found):  # strictly: so nothing is returned twice
        assert one[0] < two[0]
        assert one[1] < two[1]
    assert all(len(waiting) <= 8 for waiting in matcher._waiting.values())


@given(st.integers(-7, 7), st.sets(st.integers(0, 39)), st.sets(st.integers(0, 39)), st.integers(0, 14))
def test_simultaneous_images_are_paired_despite_losses(lead: int, lost: set[int], missed: set[int], apart: int) -> None:
    """One kind arrives up to seven images after the other."""
    colors = [(each, images.COLOR, each * PERIOD) for each in range(40) if each not in lost]
    depths = [(each + lead, images.DEPTH, each * PERIOD + apart * MS) for each in range(40) if each not in missed]
    both = [(each * PERIOD, each * PERIOD + apart * MS) for each in range(40) if each not in lost | missed]
    assert paired((kind, stamp) for _, kind, stamp in sorted(colors + depths)) == both


def test_setting_back_the_clock_begins_again() -> None:
    again = [(kind, stamp * PERIOD) for stamp in range(3) for kind in (images.DEPTH, images.COLOR)]
    found = paired([*((kind, 10**12 + stamp) for kind, stamp in again), (images.DEPTH, 10**18), *again])
    assert found[3:] == [(stamp * PERIOD, stamp * PERIOD) for stamp in range(3)]
