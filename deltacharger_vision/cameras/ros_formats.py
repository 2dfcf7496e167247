# SPDX-License-Identifier: Apache-2.0
"""What ROS drivers write: fields of Image as arrays, intrinsics from CameraInfo.

Converts the fields of sensor_msgs/Image to arrays for `RgbdImage.make`. Independent of ROS.
Encodings and the layout of `data` follow sensor_msgs/image_encodings.hpp.
"""

import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.files import brief
from deltacharger_vision import errors, images

_NONE = ("", "none")
_LONGEST = {"plumb_bob": 5, "rational_polynomial": 8}


@dataclass(frozen=True)
class Readout:
    """Which pixels of the calibrated image a camera sends, as sensor_msgs/CameraInfo states it.

    Attributes:
        left: `roi.x_offset`, px of the calibrated image.
        top: `roi.y_offset`.
        width: `roi.width`; 0 with a height of 0 = the complete image.
        height: `roi.height`.
        binning_x: columns combined into one; 0 = 1.
        binning_y: rows.
    """

    left: int = 0
    top: int = 0
    width: int = 0
    height: int = 0
    binning_x: int = 0
    binning_y: int = 0

    def of(self, calibrated: images.Intrinsics) -> images.Intrinsics:
        """Return the intrinsics of the image that is sent.

        Raises:
            CameraInfoError: the region does not lie in the calibrated image.
        """
        cut, whole = (self.left, self.top, self.width, self.height), (calibrated.width, calibrated.height)
        if any(cut):
            right, bottom = self.left + self.width, self.top + self.height
            if min(cut) < 0 or not self.width or not self.height or right > whole[0] or bottom > whole[1]:
                raise errors.CameraInfoError(
                    "CameraInfo",
                    f"roi {self.width} × {self.height} px from ({self.left}, {self.top}) is no part of the calibrated "
                    f"{whole[0]} × {whole[1]} px; let the driver state width, height and k of the complete image",
                )
            calibrated = calibrated.cropped(*cut)
        return calibrated.binned(max(1, self.binning_x), max(1, self.binning_y))


def from_camera_info(
    width: int,
    height: int,
    k: Sequence[float],
    d: Sequence[float],
    distortion_model: str,
    source: str = "CameraInfo",
    readout: Readout | None = None,
) -> images.Intrinsics:
    """Convert the fields of sensor_msgs/CameraInfo to the intrinsics of the image that the camera sends.

    Args:
        width: px of the calibrated image.
        height: px.
        k: 9 numbers, (3, 3) row-major, px.
        d: distortion coefficients; missing ones at the end are 0.
        distortion_model: plumb_bob, rational_polynomial, or none or empty.
        source: name for errors.
        readout: the part of the calibrated image that is sent.

    Raises:
        CameraInfoError: the camera is not calibrated, the model is unknown, or a number is out of bounds.
    """
    matrix = _numbers(source, "camera matrix (k)", k)
    coefficients = _numbers(source, "distortion coefficients (d)", d)
    if len(matrix) != 9:
        raise errors.CameraInfoError(source, f"the camera matrix (k) has {len(matrix)} numbers; it must have 9")
    if not any(matrix):
        raise errors.CameraInfoError(source, "the camera matrix (k) is all 0: calibrate the camera first")
    fx, skew, cx, zero, fy, cy, *last = matrix
    if skew or zero or last != [0.0, 0.0, 1.0]:
        raise errors.CameraInfoError(source, "the camera matrix (k) must be fx 0 cx, 0 fy cy, 0 0 1, row by row")
    try:
        calibrated = images.Intrinsics(
            width, height, fx, fy, cx, cy, _distortion(source, coefficients, distortion_model)
        )
        return (readout or Readout()).of(calibrated)
    except errors.CameraInfoError as error:
        raise errors.CameraInfoError(source, error.reason) from error


def _distortion(source: str, coefficients: list[float], model: str) -> tuple[float, ...]:
    if model in _NONE:
        if any(coefficients):
            raise errors.CameraInfoError(
                source, f"distortion coefficients without a model; write {' or '.join(_LONGEST)}"
            )
        return ()
    if model not in _LONGEST:
        raise errors.CameraInfoError(
            source,
            f"distortion model {brief(model)}; known: {', '.join(_LONGEST)}, none: rectify the image or recalibrate",
        )
    longest = _LONGEST[model]
    if any(coefficients[longest:]):
        raise errors.CameraInfoError(
            source, f"{len(coefficients)} distortion coefficients; {model} has {longest}: recalibrate with {model}"
        )
    kept = coefficients[:longest] + [0.0] * (longest - len(coefficients))
    return tuple(kept) if any(kept) else ()


def _numbers(source: str, name: str, found: Any) -> list[float]:
    try:
        items = list(found)
    except TypeError as error:
        raise errors.CameraInfoError(source, f"the {name} must be a list of numbers, not {brief(found)}") from error
    wrong = [item for item in items if isinstance(item, bool) or not isinstance(item, numbers.Real)]
    if wrong:
        raise errors.CameraInfoError(source, f"the {name} contains {brief(wrong[0])}, which is not a number")
    return [float(item) for item in items]


_COLORS: dict[str, tuple[int, tuple[int, ...]]] = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "8uc3": (3, (2, 1, 0)),  # OpenCV's type names have no order; cv_bridge uses BGR
    "mono8": (1, (0,)),
}
"""Colour encodings: channels, and the indices of red, green and blue."""
_DEPTHS: dict[str, type] = {"16uc1": np.uint16, "mono16": np.uint16, "32fc1": np.float32}
_QUOTED = 40  # characters of an unknown encoding in errors
_YUV = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}
"""Offset of the first luminance in each group of four bytes; the detector uses only luminance."""


def color_array(image: Any) -> NDArray[Any]:
    """Return (H, W, 3) RGB or (H, W) gray, uint8, of a colour image.

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
        raise errors.ImageError("color", f"encoding {image.encoding[:_QUOTED]!r}; {_advice(name)}")
    channels, order = _COLORS[name]
    rows = _rows("color", image, np.uint8, channels)
    return rows[:, :, 0] if len(order) == 1 else np.ascontiguousarray(rows[:, :, order])


def depth_array(image: Any) -> NDArray[Any]:
    """Return (H, W) uint16 mm or float m of a depth image, like `color_array`.

    Raises:
        ImageError: the encoding is not 16UC1 (mm) or 32FC1 (m), or the fields are inconsistent.
    """
    name = image.encoding.lower()
    if name not in _DEPTHS:
        needed = "must be 16UC1 in mm or 32FC1 in m: take the depth image aligned to colour"
        raise errors.ImageError("depth", f"encoding {image.encoding[:_QUOTED]!r}; {needed}")
    return _rows("depth", image, _DEPTHS[name], 1)[:, :, 0]


def _rows(what: str, image: Any, kind: type, channels: int) -> NDArray[Any]:
    """Return (H, W, channels) in the machine's byte order."""
    height, width, step = image.height, image.width, image.step
    stored = np.dtype(kind).newbyteorder(">" if image.is_bigendian else "<")
    least = width * channels * stored.itemsize
    if height < 1 or width < 1 or step < least:
        raise errors.ImageError(what, f"{width} × {height} px with {step} bytes a row; a row needs {max(least, 1)}")
    flat = np.frombuffer(image.data, dtype=np.uint8)
    if flat.size < step * (height - 1) + least:
        raise errors.ImageError(what, f"{flat.size} bytes of {step * height}; the image was truncated in transit")
    padded = np.lib.stride_tricks.as_strided(flat, (height, least), (step, 1), writeable=False)
    pixels = np.ascontiguousarray(padded).view(stored).reshape(height, width, channels)
    return pixels.astype(kind, copy=False)


def _advice(name: str) -> str:
    if name.startswith("bayer"):
        return "this is the raw sensor: take the driver's colour topic, or run image_proc's debayer"
    if "jpeg" in name or "png" in name or "compressed" in name:
        return "the image is compressed: take the raw topic, or republish it with image_transport"
    return f"must be one of {', '.join(_COLORS)}"
