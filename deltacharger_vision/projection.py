# SPDX-License-Identifier: Apache-2.0
"""Conversion between pixels and rays with lens distortion; it undistorts points, never images.

The distortion models are those of OpenCV and ROS (plumb_bob and rational_polynomial), both ways, in numpy alone. For a
direction x/z, y/z in the optical frame, with r² = x² + y²:
radial = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶);
x' = x radial + 2 p1 x y + p2 (r² + 2 x²), y' = y radial + p1 (r² + 2 y²) + 2 p2 x y.
"""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_vision.errors import CameraInfoError
from deltacharger_vision.images import Intrinsics

_STEPS = 30
_CLOSE = 1e-9


def rays(pixels: Array, intrinsics: Intrinsics) -> Array:
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


def project(points: Array, intrinsics: Intrinsics) -> Array:
    """Return the pixels (..., 2) of points (..., 3) m in the optical frame, in front of the camera."""
    seen = distort(points[..., :2] / points[..., 2:], intrinsics.distortion)
    return np.asarray(seen * [intrinsics.fx, intrinsics.fy] + [intrinsics.cx, intrinsics.cy])


def distort(points: Array, distortion: tuple[float, ...]) -> Array:
    """Return the distorted directions of ideal ones (..., 2)."""
    return _distorted(points, distortion)[0] if distortion else np.array(points, dtype=float)


def undistort(points: Array, distortion: tuple[float, ...]) -> Array:
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


def _distorted(points: Array, distortion: tuple[float, ...]) -> tuple[Array, Array]:
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
