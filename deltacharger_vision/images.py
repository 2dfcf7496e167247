# SPDX-License-Identifier: Apache-2.0
"""An RGB-D image and its camera, checked once on input."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.bounded_file import brief
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
MILLIMETRE = 1e-3
"""Usual unit of 16-bit depth, m (REP 118)."""
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
        for name, low, high in (
            ("width", SMALLEST, LARGEST),
            ("height", SMALLEST, LARGEST),
            ("fx", *_FOCAL),
            ("fy", *_FOCAL),
        ):
            self._check(name, low, high)
        self._check("cx", -self.width, 2 * self.width)
        self._check("cy", -self.height, 2 * self.height)
        for name in ("width", "height"):
            if int(getattr(self, name)) != getattr(self, name):
                raise CameraInfoError(
                    "intrinsics", f"{name} = {brief(getattr(self, name))} is not a whole number of pixels"
                )
            object.__setattr__(self, name, int(getattr(self, name)))
        if len(self.distortion) not in (0, 5, 8):
            raise CameraInfoError(
                "intrinsics",
                f"{len(self.distortion)} distortion coefficients; give none, 5 (plumb_bob) or 8 (rational_polynomial)",
            )
        for coefficient in self.distortion:
            if not _is_number(coefficient) or not abs(coefficient) <= _COEFFICIENT:
                raise CameraInfoError("intrinsics", f"distortion coefficient {brief(coefficient)}; calibrate again")
        object.__setattr__(self, "distortion", tuple(float(coefficient) for coefficient in self.distortion))

    def _check(self, name: str, low: float, high: float) -> None:
        found = getattr(self, name)
        if not _is_number(found) or not low <= found <= high:
            raise CameraInfoError(
                "intrinsics", f"{name} = {brief(found)} is outside {low:g}…{high:g} px; calibrate the camera again"
            )

    def matrix(self) -> Array:
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
    def make(
        color: NDArray[Any], depth: NDArray[Any], intrinsics: Intrinsics, depth_unit: float = MILLIMETRE
    ) -> RgbdImage:
        """Check and convert the arrays of a camera or a file.

        Args:
            color: see `rgb8`.
            depth: (H, W) or (H, W, 1); uint16 in units of `depth_unit` with 0 and 65535 = unknown, or float32/float64
                m with 0, ±inf or NaN = unknown.
            intrinsics: of this image.
            depth_unit: m.

        Raises:
            ImageError: an array has another shape or type, sizes differ, or the depth is negative or float
                millimetres.
        """
        rgb, metres = rgb8(np.asarray(color)), _depth(np.asarray(depth), depth_unit)
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
    """Return (H, W, 3) RGB of (H, W) or (H, W, 1) gray, (H, W, 3) RGB or (H, W, 4) RGBA, uint8 or uint16.

    Sensors of 10, 12 and 14 bits store their levels unchanged in uint16, so its brightest level tells the range.

    Raises:
        ImageError: another shape or type.
    """
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if not array.size or not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4))):
        raise ImageError("color", f"shape {array.shape}; must be (H, W) gray, (H, W, 3) RGB or (H, W, 4) RGBA")
    if array.dtype == np.uint16:
        bits = next(bits for bits in (10, 12, 14, 16) if int(array.max()) < 1 << bits)
        array = (array >> (bits - 8)).astype(np.uint8)
    if array.dtype != np.uint8:
        raise ImageError("color", f"type {array.dtype}; must be uint8 or uint16")
    if array.ndim == 2:
        return np.repeat(array[:, :, None], 3, axis=2)
    return np.ascontiguousarray(array[:, :, :3])


def _depth(array: NDArray[Any], unit: float) -> NDArray[np.float32]:
    """Return (H, W) float32 m with NaN where unknown; `unit` (m) of uint16."""
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if not array.size or array.ndim != 2:
        raise ImageError("depth", f"shape {array.shape}; must be (H, W)")
    if array.dtype not in (np.uint16, np.float32, np.float64):
        raise ImageError("depth", f"type {array.dtype}; must be uint16, or float32 or float64 in m")
    if array.dtype == np.uint16:
        metres = array.astype(np.float32) * np.float32(unit)
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
