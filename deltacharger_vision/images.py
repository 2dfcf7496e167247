# SPDX-License-Identifier: Apache-2.0
"""An RGB-D image and its camera, checked once on input: the lens, and pairs of images by their stamps.

Conversion between pixels and rays with lens distortion; it undistorts points, never images.
The distortion models are those of OpenCV and ROS (plumb_bob and rational_polynomial), both ways, in numpy alone. For a
direction x/z, y/z in the optical frame, with r² = x² + y²:
radial = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶);
x' = x radial + 2 p1 x y + p2 (r² + 2 x²), y' = y radial + p1 (r² + 2 y²) + 2 p2 x y.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, files
from deltacharger_vision.errors import CameraInfoError, ImageError

COLOR, DEPTH, INFO = "color", "depth", "info"
"""Contents of a camera's topics."""
_CODE = np.arange(256) / 255.0
LIGHT = np.where(_CODE <= 0.04045, _CODE / 12.92, ((_CODE + 0.055) / 1.055) ** 2.4)
"""Light, 0–1, of each level 0–255 in sRGB (IEC 61966-2-1), the cameras' encoding."""
SMALLEST, LARGEST = 16, 16384
"""Limits of an image's width and height, px."""
_FOCAL = (1.0, 1e5)
_COEFFICIENT = 1e4
_MILLIMETRE = 1e-3  # m, unit of 16-bit depth (REP 118)
STAMP_TOLERANCE = 15_000_000
"""ns between the stamps of colour and depth: less than half of an image period at 30 Hz."""
NEAREST_DEPTH = 0.174
"""m, from which an OAK-D measures depth at 640 × 400 with extended disparity."""
DEPTH_BIAS = 0.01
"""Standard deviation of the relative error of all depth; makers of stereo cameras allow twice as much."""
_SATURATED = 0xFFFF  # written by some drivers where depth is unknown or too far
_MILLIMETRES_ABOVE = 20.0
"""No docking camera has a larger median depth, m."""


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera with lens distortion; everything in pixels, the centre of the first pixel at (0, 0).

    Attributes:
        width: of the image.
        height: of the image.
        fx: focal length along x (right).
        fy: focal length along y (down).
        cx: principal point, x.
        cy: principal point, y.
        distortion: () none, 5 plumb_bob (k1, k2, p1, p2, k3) or 8 rational_polynomial (and k4, k5, k6) coefficients.

    Raises:
        CameraInfoError: a value is out of bounds or not a number.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, (low, high) in {
            "width": (SMALLEST, LARGEST),
            "height": (SMALLEST, LARGEST),
            "fx": _FOCAL,
            "fy": _FOCAL,
            "cx": (-self.width, 2 * self.width),
            "cy": (-self.height, 2 * self.height),
        }.items():
            found = getattr(self, name)
            if not _is_number(found) or not low <= found <= high:
                raise CameraInfoError(
                    "intrinsics",
                    f"{name} = {files.brief(found)} is outside {low:g}…{high:g} px; calibrate the camera again",
                )
        if not float(self.width).is_integer() or not float(self.height).is_integer():
            raise CameraInfoError("intrinsics", f"{self.width} × {self.height} is no whole number of pixels")
        if len(self.distortion) not in (0, 5, 8):
            raise CameraInfoError(
                "intrinsics",
                f"{len(self.distortion)} distortion coefficients; give none, 5 (plumb_bob) or 8 (rational_polynomial)",
            )
        for coefficient in self.distortion:
            if not _is_number(coefficient) or not abs(coefficient) <= _COEFFICIENT:
                raise CameraInfoError(
                    "intrinsics", f"distortion coefficient {files.brief(coefficient)}; calibrate again"
                )

    def matrix(self) -> arrays.Array:
        """Return (3, 3) px: maps a direction (x, y, 1) in the optical frame to an undistorted pixel (u, v, 1)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def cropped(self, left: int, top: int, width: int, height: int) -> Intrinsics:
        """Return the intrinsics of width × height px of the image, from a corner (left, top) px.

        Raises:
            CameraInfoError: a size is out of bounds.
        """
        return dataclasses.replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def binned(self, across: int, down: int) -> Intrinsics:
        """Return the intrinsics of the image with across × down px combined into one; a rest at the border is cut off.

        Raises:
            CameraInfoError: a size is out of bounds.
        """
        width, height = self.width // across, self.height // down
        return self.cropped(0, 0, width * across, height * down).scaled(width, height)

    def scaled(self, width: int, height: int) -> Intrinsics:
        """Return the intrinsics of the image resampled to width × height px.

        Raises:
            CameraInfoError: a size is out of bounds.
        """
        across, down = width / self.width, height / self.height
        return Intrinsics(
            width,
            height,
            self.fx * across,
            self.fy * down,
            (self.cx + 0.5) * across - 0.5,
            (self.cy + 0.5) * down - 0.5,
            self.distortion,
        )


def _is_number(found: Any) -> bool:
    return isinstance(found, int | float | np.integer | np.floating) and not isinstance(found, bool)


@dataclass(frozen=True)
class RgbdImage:
    """Colour and depth of the same pixels. `make` checks arrays from elsewhere.

    Attributes:
        color: (H, W, 3) uint8 RGB.
        depth: (H, W) float32 m along the optical axis, NaN = unknown.
        intrinsics: of both, W × H px.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: Intrinsics

    @staticmethod
    def make(color: NDArray[Any], depth: NDArray[Any], intrinsics: Intrinsics) -> RgbdImage:
        """Check and convert the arrays of a camera or a file.

        Args:
            color: see `rgb8`.
            depth: (H, W) or (H, W, 1); uint16 mm (REP 118) with 0 and 65535 = unknown, or float32/float64 m
                with 0, ±inf or NaN = unknown.
            intrinsics: of this image.

        Raises:
            ImageError: an array has another shape or type, sizes differ, or the depth is negative or float
                millimetres.
        """
        rgb, metres = rgb8(np.asarray(color)), _depth(np.asarray(depth))
        if rgb.shape[:2] != metres.shape:
            raise ImageError(
                "depth",
                f"its size {_size(metres)} is not the colour's {_size(rgb)}; use the depth aligned to the colour image",
            )
        height, width = metres.shape
        if not SMALLEST <= width <= LARGEST or not SMALLEST <= height <= LARGEST:
            raise ImageError("color", f"{_size(rgb)} px; an image has {SMALLEST}…{LARGEST} px each way")
        # A cut-out and a smaller copy of one size have other intrinsics, and nothing in the image tells them apart.
        if (width, height) != (intrinsics.width, intrinsics.height):
            raise ImageError(
                "intrinsics",
                f"for {intrinsics.width} × {intrinsics.height} px, but the image has {_size(rgb)}: give the "
                "calibration of this image; a driver that cuts or bins states it in camera_info (roi, binning)",
            )
        return RgbdImage(rgb, metres, intrinsics)


def _size(array: NDArray[Any]) -> str:
    return f"{array.shape[1]} × {array.shape[0]}"


def rgb8(array: NDArray[Any]) -> NDArray[np.uint8]:
    """Return (H, W, 3) RGB of (H, W) or (H, W, 1) gray, (H, W, 3) RGB or (H, W, 4) RGBA, uint8.

    Raises:
        ImageError: another shape or type.
    """
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if not array.size or not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4))):
        raise ImageError("color", f"shape {array.shape}; must be (H, W) gray, (H, W, 3) RGB or (H, W, 4) RGBA")
    if array.dtype != np.uint8:
        raise ImageError("color", f"type {array.dtype}; must be 8 bits per colour")
    if array.ndim == 2:
        return np.repeat(array[:, :, None], 3, axis=2)
    return np.ascontiguousarray(array[:, :, :3])


def _depth(array: NDArray[Any]) -> NDArray[np.float32]:
    """Return (H, W) float32 m with NaN where unknown."""
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if not array.size or array.ndim != 2:
        raise ImageError("depth", f"shape {array.shape}; must be (H, W)")
    if array.dtype not in (np.uint16, np.float32, np.float64):
        raise ImageError("depth", f"type {array.dtype}; must be uint16, or float32 or float64 in m")
    if array.dtype == np.uint16:
        metres = array.astype(np.float32) * np.float32(_MILLIMETRE)
        metres[(array == 0) | (array == _SATURATED)] = np.nan
        return metres
    unknown = ~np.isfinite(array) | (array == 0.0)
    known = array[~unknown]
    if known.size and float(known.min()) < 0.0:
        raise ImageError("depth", f"holds {float(known.min()):g} m; unknown is 0, inf or NaN, never negative")
    if known.size and (middle := float(np.median(known))) > _MILLIMETRES_ABOVE:
        raise ImageError("depth", f"its median is {middle:g} m; float depth is in metres: divide millimetres by 1000")
    with np.errstate(over="ignore"):
        metres = array.astype(np.float32)
    metres[~np.isfinite(metres) | (metres == 0.0)] = np.nan  # also float64 values out of float32's range
    return metres


_STEPS = 30
_CLOSE = 1e-9


def rays(pixels: arrays.Array, intrinsics: Intrinsics) -> arrays.Array:
    """Return x/z and y/z (..., 2) of the rays through pixels (..., 2).

    Raises:
        CameraInfoError: the distortion is not one-to-one there.
    """
    seen = (pixels - [intrinsics.cx, intrinsics.cy]) / [intrinsics.fx, intrinsics.fy]
    return undistort(seen, intrinsics.distortion)


def check_lens(intrinsics: Intrinsics) -> None:
    """Refuse a lens that maps two directions to one pixel of the image's border.

    Raises:
        CameraInfoError: it does so.
    """
    if intrinsics.distortion:
        x, y = np.meshgrid(np.linspace(0.0, intrinsics.width - 1.0, 3), np.linspace(0.0, intrinsics.height - 1.0, 3))
        rays(np.stack([x, y], axis=-1), intrinsics)


def project(points: arrays.Array, intrinsics: Intrinsics) -> arrays.Array:
    """Return the pixels (..., 2) of points (..., 3) m in the optical frame, in front of the camera."""
    seen = distort(points[..., :2] / points[..., 2:], intrinsics.distortion)
    return np.asarray(seen * [intrinsics.fx, intrinsics.fy] + [intrinsics.cx, intrinsics.cy])


def distort(points: arrays.Array, distortion: tuple[float, ...]) -> arrays.Array:
    """Return the distorted directions of ideal ones (..., 2)."""
    return _distorted(points, distortion)[0] if distortion else np.array(points, dtype=float)


def undistort(points: arrays.Array, distortion: tuple[float, ...]) -> arrays.Array:
    """Return the ideal directions of distorted ones (..., 2), by Newton's method.

    Raises:
        CameraInfoError: the distortion is not one-to-one there, as with a wrong calibration.
    """
    ideal = np.array(points, dtype=float)
    if not distortion:
        return ideal
    for _ in range(_STEPS):
        seen, jacobian = _distorted(ideal, distortion)
        error = seen - points
        if np.abs(error).max() < _CLOSE:
            if jacobian[..., 3].min() <= 0.0:
                break
            return ideal
        a, b, c, determinant = np.moveaxis(jacobian, -1, 0)
        step = np.stack([c * error[..., 0] - b * error[..., 1], a * error[..., 1] - b * error[..., 0]], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            ideal -= np.nan_to_num(step / determinant[..., None], posinf=0.0, neginf=0.0)
    raise CameraInfoError("distortion", "two directions fall on one pixel of the image; calibrate the camera again")


def _distorted(points: arrays.Array, distortion: tuple[float, ...]) -> tuple[arrays.Array, arrays.Array]:
    """Return distorted directions (..., 2) and (..., 4): dx'/dx, dx'/dy = dy'/dx, dy'/dy and their determinant."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, 0.0, 0.0, 0.0)[:8]
    x, y = points[..., 0], points[..., 1]
    s = x * x + y * y
    above, below = 1 + s * (k1 + s * (k2 + s * k3)), 1 + s * (k4 + s * (k5 + s * k6))
    radial = above / below
    slope = 2 * (k1 + s * (2 * k2 + s * 3 * k3) - radial * (k4 + s * (2 * k5 + s * 3 * k6))) / below
    seen = np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x),
            y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )
    a = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    b = x * y * slope + 2 * p1 * x + 2 * p2 * y
    c = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    return seen, np.stack([a, b, c, a * c - b * b], axis=-1)


Item = TypeVar("Item")

_JUMP = 1_000_000_000
"""ns; networks do not reorder messages over so long: the clock was set back, or a recording restarted."""
_WAITING = 8
"""Most waiting images of each kind; the oldest is dropped."""


class StampMatcher(Generic[Item]):
    """Pairs each colour image with the depth of the same time, as soon as both have arrived.

    Every image is returned at most once, in order: those older than the last pair are dropped. If an image is more than
    1 s older than an earlier one, the clock was set back, and the order restarts.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Drop all images, for example after a pause."""
        self._waiting: dict[str, dict[int, Item]] = {COLOR: {}, DEPTH: {}}
        self._last = {COLOR: -_JUMP, DEPTH: -_JUMP}

    def add_image(self, kind: str, stamp: int, image: Item) -> tuple[int, Item, Item] | None:
        """Add an image of kind COLOR or DEPTH; return the stamp of the colour, colour and depth if both are there."""
        mine, others = self._waiting[kind], self._waiting[DEPTH if kind == COLOR else COLOR]
        if stamp < max(self._last[kind], *mine, -_JUMP) - _JUMP:
            self.clear()
            return self.add_image(kind, stamp, image)
        if stamp <= self._last[kind]:
            return None
        mine.setdefault(stamp, image)
        other = min(others, key=lambda each: abs(each - stamp), default=None)
        if other is None or abs(other - stamp) > STAMP_TOLERANCE:
            if len(mine) > _WAITING:
                del mine[min(mine)]
            return None
        color, depth = (stamp, other) if kind == COLOR else (other, stamp)
        pair = color, self._waiting[COLOR][color], self._waiting[DEPTH][depth]
        for each, used in ((COLOR, color), (DEPTH, depth)):
            self._last[each] = used
            self._waiting[each] = {at: item for at, item in self._waiting[each].items() if at > used}
        return pair
