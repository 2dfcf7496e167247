# SPDX-License-Identifier: Apache-2.0
"""Calibrations and image messages of every usual format give the same values; others are refused with a reason."""

from __future__ import annotations

from array import array
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deltacharger_vision.cameras.ros_formats import Readout, color_array, depth_array, from_camera_info
from deltacharger_vision.errors import CameraInfoError, ImageError
from deltacharger_vision.image_files import load_camera_info
from deltacharger_vision.images import Intrinsics

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
EXPECTED = Intrinsics(640, 400, 441.0, 442.0, 320.1, 199.2, (-0.1, 0.02, 0.001, -0.002, 0.003))
K = [441.0, 0.0, 320.1, 0.0, 442.0, 199.2, 0.0, 0.0, 1.0]


def load(folder: Path, text: str) -> Intrinsics:
    path = folder / "camera.yaml"
    path.write_text(text)
    return load_camera_info(path)


def test_both_formats_give_the_same_intrinsics(tmp_path: Path) -> None:
    assert [load(tmp_path, text) for text in (CALIBRATION, ECHOED)] == [EXPECTED] * 2


def test_no_missing_and_extra_coefficients_are_zero() -> None:
    plain = Intrinsics(640, 400, 441.0, 442.0, 320.1, 199.2)
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
        ("441.0, 0, 320.1", "441.0, 320.1", "has 8 numbers"),
        ("441.0, 0, 320.1", "wide, 0, 320.1", "not a number"),
        ("plumb_bob", "equidistant", "equidistant"),
        ("plumb_bob", "none", "without a model"),
        ("0.003]", "0.003, 0.5]", "rational_polynomial|plumb_bob"),
        ("image_width: 640\n", "", "image_width"),
        ("camera_name: oak", "binning_x: two", "roi or binning"),
        ("camera_name: oak", "roi: {x_offset: 10, y_offset: 5, width: 640, height: 400}", "complete image"),
    ],
)
def test_errors_of_a_bad_file_state_what_to_do(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in CALIBRATION
    with pytest.raises(CameraInfoError, match=words) as caught:
        load(tmp_path, CALIBRATION.replace(old, new))
    assert str(tmp_path) in caught.value.source


@pytest.mark.parametrize(
    ("readout", "seen"),
    [
        (Readout(), Intrinsics(640, 400, 441.0, 442.0, 320.1, 199.2)),
        (Readout(10, 20, 621, 361, 2, 2), Intrinsics(310, 180, 220.5, 221.0, 154.8, 89.35)),
    ],
)
def test_region_and_binning_give_the_intrinsics_of_the_image_that_is_sent(readout: Readout, seen: Intrinsics) -> None:
    found = from_camera_info(640, 400, K, [], "none", readout=readout)
    wanted = {name: value if name == "distortion" else pytest.approx(value) for name, value in vars(seen).items()}
    assert vars(found) == wanted


RGB = np.random.default_rng(3).integers(0, 256, (18, 21, 3), dtype=np.uint8)


def packed(pixels: np.ndarray, padding: int = 0) -> tuple[int, array[int]]:
    """Return step and data of rows with some bytes of padding after each."""
    flat = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
    rows = np.pad(flat, ((0, 0), (0, padding)), constant_values=7)
    return rows.shape[1], array("B", rows.tobytes())


def image(encoding: str, height: int, width: int, step: int, data: Any, big: bool = False) -> SimpleNamespace:
    fields = {"encoding": encoding, "height": height, "width": width, "step": step, "data": data}
    return SimpleNamespace(**fields, is_bigendian=int(big))


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("8UC3", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 0])],
)
def test_colour_is_converted_to_rgb(encoding: str, order: list[int], padding: int) -> None:
    step, data = packed(RGB[:, :, order], padding)
    assert np.array_equal(color_array(image(encoding, 18, 21, step, data)), RGB)


@pytest.mark.parametrize(("big", "kind"), [(False, "<u2"), (True, ">u2")])
def test_sixteen_bits_are_read_in_either_byte_order(big: bool, kind: str) -> None:
    wide = RGB[:, :, 0].astype(np.uint16) * 256 + 3
    assert np.array_equal(depth_array(image("16UC1", 18, 21, *packed(wide.astype(kind), 4), big)), wide)


def test_gray_yuv_and_metres_keep_their_values() -> None:
    gray, metres = RGB[:, :20, 0], np.array([[0.5, np.nan], [np.inf, 0.25]], dtype=np.float32)
    yuyv = np.stack([gray, np.full((18, 20), 128, np.uint8)], axis=2)
    for encoding, pixels in (("mono8", gray), ("yuv422_yuy2", yuyv), ("yuv422", yuyv[:, :, ::-1])):
        assert np.array_equal(color_array(image(encoding, 18, 20, *packed(pixels))), gray)
    assert np.array_equal(depth_array(image("32FC1", 2, 2, *packed(metres))), metres, equal_nan=True)


@pytest.mark.parametrize(
    ("read", "encoding", "height", "step", "size", "noun"),
    [
        (color_array, "bayer_rggb8", 18, 63, 18 * 63, "raw"),
        (depth_array, "rgb8", 18, 63, 18 * 63, "16UC1"),
        (color_array, "rgb8", 18, 62, 18 * 63, "color"),
        (color_array, "rgb8", 18, 63, 900, "color"),
        (color_array, "x" * 1_000_000, 18, 63, 18 * 63, "color"),
    ],
    ids=range(5),
)
def test_another_encoding_and_contradictory_fields_are_refused(
    read: Any, encoding: str, height: int, step: int, size: int, noun: str
) -> None:
    with pytest.raises(ImageError, match=noun) as refused:
        read(image(encoding, height, 21, step, bytes(size)))
    assert len(str(refused.value)) < 1000
