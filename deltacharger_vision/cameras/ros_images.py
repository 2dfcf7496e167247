# SPDX-License-Identifier: Apache-2.0
"""Converts the fields of sensor_msgs/Image to arrays for `RgbdImage.make`. Independent of ROS.

Encodings and the layout of `data` follow sensor_msgs/image_encodings.hpp.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_vision.errors import ImageError

_RGB, _BGR, _RGBA, _BGRA = (0, 1, 2), (2, 1, 0), (0, 1, 2), (2, 1, 0)
_COLORS: dict[str, tuple[type, int, tuple[int, ...]]] = {
    "rgb8": (np.uint8, 3, _RGB),
    "bgr8": (np.uint8, 3, _BGR),
    "rgba8": (np.uint8, 4, _RGBA),
    "bgra8": (np.uint8, 4, _BGRA),
    "rgb16": (np.uint16, 3, _RGB),
    "bgr16": (np.uint16, 3, _BGR),
    "rgba16": (np.uint16, 4, _RGBA),
    "bgra16": (np.uint16, 4, _BGRA),
    "8uc3": (np.uint8, 3, _BGR),  # OpenCV's type names have no order; cv_bridge uses BGR
    "8uc4": (np.uint8, 4, _BGRA),
    "mono8": (np.uint8, 1, (0,)),
    "8uc1": (np.uint8, 1, (0,)),
    "mono16": (np.uint16, 1, (0,)),
    "16uc1": (np.uint16, 1, (0,)),
}
"""Colour encodings: type, channels, and the indices of red, green and blue."""
_DEPTHS: dict[str, type] = {"16uc1": np.uint16, "mono16": np.uint16, "32fc1": np.float32, "64fc1": np.float64}
_QUOTED = 40  # characters of an unknown encoding in errors
_YUV = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}
"""Offset of the first luminance in each group of four bytes; the detector uses only luminance."""


def color_array(image: Any) -> NDArray[Any]:
    """Return (H, W, 3) RGB or (H, W) gray, uint8 or uint16, of a colour image.

    For YUV 4:2:2 images it returns the luminance.

    Args:
        image: sensor_msgs/Image, or an object with its fields.

    Raises:
        ImageError: the encoding is unknown or raw, or the fields are inconsistent.
    """
    name = image.encoding.lower()
    if name in _YUV:
        return np.ascontiguousarray(_rows("color", image, np.uint8, 2)[:, :, _YUV[name]])
    if name not in _COLORS:
        raise ImageError("color", f"encoding {image.encoding[:_QUOTED]!r}; {_advice(name)}")
    kind, channels, order = _COLORS[name]
    rows = _rows("color", image, kind, channels)
    return rows[:, :, 0] if len(order) == 1 else rows[:, :, list(order)] if order != _RGB else rows[:, :, :3]


def depth_array(image: Any) -> NDArray[Any]:
    """Return (H, W) uint16 mm or float m of a depth image, like `color_array`.

    Raises:
        ImageError: the encoding is not 16UC1 (mm) or 32FC1 (m), or the fields are inconsistent.
    """
    name = image.encoding.lower()
    if name not in _DEPTHS:
        needed = "must be 16UC1 in mm or 32FC1 in m: take the depth image aligned to colour"
        raise ImageError("depth", f"encoding {image.encoding[:_QUOTED]!r}; {needed}")
    return _rows("depth", image, _DEPTHS[name], 1)[:, :, 0]


def _rows(what: str, image: Any, kind: type, channels: int) -> NDArray[Any]:
    """Return (H, W, channels) in the machine's byte order."""
    height, width, step = image.height, image.width, image.step
    stored = np.dtype(kind).newbyteorder(">" if image.is_bigendian else "<")
    least = width * channels * stored.itemsize
    if height < 1 or width < 1 or step < least:
        raise ImageError(what, f"{width} × {height} px with {step} bytes a row; a row needs {max(least, 1)}")
    flat = np.frombuffer(image.data, dtype=np.uint8)
    if flat.size < step * (height - 1) + least:
        raise ImageError(what, f"{flat.size} bytes of {step * height}; the image was truncated in transit")
    padded = np.lib.stride_tricks.as_strided(flat, (height, least), (step, 1), writeable=False)
    pixels = np.ascontiguousarray(padded).view(stored).reshape(height, width, channels)
    return pixels.astype(kind, copy=False)


def _advice(name: str) -> str:
    if name.startswith("bayer"):
        return "this is the raw sensor: take the driver's colour topic, or run image_proc's debayer"
    if "jpeg" in name or "png" in name or "compressed" in name:
        return "the image is compressed: take the raw topic, or republish it with image_transport"
    return f"must be one of {', '.join(_COLORS)}"
