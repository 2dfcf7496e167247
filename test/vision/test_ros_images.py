# SPDX-License-Identifier: Apache-2.0
"""Image messages of every usual encoding give the same picture; unreadable ones raise named errors."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deltacharger_vision.cameras.ros_images import color_array, depth_array
from deltacharger_vision.errors import ImageError

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


@pytest.mark.parametrize("big", [False, True])
def test_sixteen_bits_are_read_in_either_byte_order(big: bool) -> None:
    wide = RGB.astype(np.uint16) * 256 + 3
    step, data = packed(wide.astype(">u2" if big else "<u2"))
    found = color_array(image("rgb16", 18, 21, step, data, big))
    assert found.dtype == np.uint16
    assert np.array_equal(found, wide)
    step, data = packed(wide[:, :, 0].astype(">u2" if big else "<u2"), 4)
    assert np.array_equal(depth_array(image("16UC1", 18, 21, step, data, big)), wide[:, :, 0])


def test_gray_stays_gray_and_yuv_gives_its_luminance() -> None:
    step, data = packed(RGB[:, :, 0])
    assert np.array_equal(color_array(image("mono8", 18, 21, step, data)), RGB[:, :, 0])
    yuyv = np.stack([RGB[:, :20, 0], np.full((18, 20), 128, np.uint8)], axis=2)
    step, data = packed(yuyv)
    assert np.array_equal(color_array(image("yuv422_yuy2", 18, 20, step, data)), RGB[:, :20, 0])
    step, data = packed(yuyv[:, :, ::-1])
    assert np.array_equal(color_array(image("yuv422", 18, 20, step, data)), RGB[:, :20, 0])


def test_depth_in_metres_keeps_unknown_values() -> None:
    metres = np.array([[0.5, np.nan], [np.inf, 0.25]], dtype=np.float32)
    step, data = packed(metres)
    assert np.array_equal(depth_array(image("32FC1", 2, 2, step, data)), metres, equal_nan=True)


@pytest.mark.parametrize(
    ("encoding", "advice"), [("bayer_rggb8", "raw sensor"), ("jpeg", "compressed"), ("32FC3", "must be one of")]
)
def test_another_colour_encoding_is_refused_with_advice(encoding: str, advice: str) -> None:
    with pytest.raises(ImageError, match=advice):
        color_array(image(encoding, 18, 21, 63, bytes(18 * 63)))


def test_a_colour_image_is_refused_as_depth() -> None:
    with pytest.raises(ImageError, match="16UC1 in mm or 32FC1 in m"):
        depth_array(image("rgb8", 18, 21, 63, bytes(18 * 63)))


@pytest.mark.parametrize(
    ("height", "width", "step", "size"), [(18, 21, 62, 18 * 63), (18, 21, 63, 900), (0, 21, 63, 0)]
)
def test_contradictory_fields_are_refused(height: int, width: int, step: int, size: int) -> None:
    with pytest.raises(ImageError, match="color"):
        color_array(image("rgb8", height, width, step, bytes(size)))


@pytest.mark.parametrize("read", [color_array, depth_array])
def test_a_very_long_encoding_name_is_cut(read: Callable[[Any], Any]) -> None:
    with pytest.raises(ImageError) as refusal:
        read(image("x" * 1_000_000, 1, 1, 3, bytes(3)))
    assert len(str(refusal.value)) < 1000
