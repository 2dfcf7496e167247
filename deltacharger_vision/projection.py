# SPDX-License-Identifier: Apache-2.0
"""Between pixels and rays of the camera, with the lens's distortion: points are undistorted, images never."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.lens import distort, undistort


def rays(pixels: Array, intrinsics: Intrinsics) -> Array:
    """Return x/z and y/z (..., 2) of the rays through pixels (..., 2).

    Raises:
        CameraInfoError: the distortion is no one-to-one map there.
    """
    seen = (pixels - [intrinsics.cx, intrinsics.cy]) / [intrinsics.fx, intrinsics.fy]
    return undistort(seen, intrinsics.distortion)


def check_lens(intrinsics: Intrinsics) -> None:
    """Refuse a lens that shows two directions at one pixel of the image's border.

    Raises:
        CameraInfoError: it does.
    """
    if intrinsics.distortion:
        x, y = np.meshgrid(np.linspace(0.0, intrinsics.width - 1.0, 3), np.linspace(0.0, intrinsics.height - 1.0, 3))
        rays(np.stack([x, y], axis=-1), intrinsics)


def project(points: Array, intrinsics: Intrinsics) -> Array:
    """Return the pixels (..., 2) of points (..., 3) m in the optical frame, in front of the camera."""
    seen = distort(points[..., :2] / points[..., 2:], intrinsics.distortion)
    return np.asarray(seen * [intrinsics.fx, intrinsics.fy] + [intrinsics.cx, intrinsics.cy])
