# SPDX-License-Identifier: Apache-2.0
"""Inputs of a hand-eye calibration: views of a board on the platform, and prior knowledge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import JOINTS
from deltacharger_vision.errors import VisionError
from deltacharger_vision.hand_eye.board import Sighting
from deltacharger_vision.images import Intrinsics, rays

FEWEST = 5
"""Views needed for a calibration, one of them to test the others."""
_FARTHEST = 10.0
"""Largest plausible coordinate of a platform, m."""


class HandEyeError(VisionError, ValueError):
    """The views do not determine the mount. Example: in all, the platform was on one line.

    Args:
        reason: what is missing and what to do.
    """


@dataclass(frozen=True, eq=False)
class View:
    """One image of the board, with the platform at rest.

    Attributes:
        position: (3,) m of end_effector in charger_base, by forward kinematics.
        sighting: the board's corners in the image.
        slope: (3, 3) m/rad, derivative of `position` by each arm angle; 0 if the angles are exact.

    Raises:
        HandEyeError: a number is not finite, or the platform is far outside any workspace.
    """

    position: Array
    sighting: Sighting
    slope: Array

    def __post_init__(self) -> None:
        if np.shape(self.position) != (3,) or np.shape(self.slope) != (3, len(JOINTS)):
            raise HandEyeError("a view needs a position (3,) and its slope (3, 3)")
        numbers = (self.position, self.slope, self.sighting.corners, self.sighting.pixels)
        if not all(np.isfinite(each).all() for each in numbers) or np.abs(self.position).max() > _FARTHEST:
            raise HandEyeError(f"a view at {np.asarray(self.position)} m; give finite numbers in metres")


@dataclass(frozen=True)
class Beliefs:
    """Knowledge before the views. Standard deviations without a source are assumed.

    Attributes:
        offset: (3,) m, origin of the board in end_effector.
    """

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset_stddev: float = 0.0005  # m, of each coordinate of `offset`, measured by hand
    joint_stddev: float = 0.001745  # rad, of each arm's constant angle error (0.1°)
    arm_stddev: float = 0.0001  # m, scatter of a position; corrected by the views
    pixel_stddev: float = 0.1  # px, scatter of a corner; corrected by the views

    def __post_init__(self) -> None:
        if len(self.offset) != 3 or not np.isfinite(self.offset).all() or np.abs(self.offset).max() > 1.0:
            raise HandEyeError(f"the board's offset is {self.offset}; give three lengths within ±1 m")


@dataclass(frozen=True, eq=False)
class Corners:
    """The M corners of N views, one row each, view after view.

    Attributes:
        view: (M,) index of the view.
        points: (M, 3) m in the board's frame.
        seen: (M, 2) px without lens distortion: focal length times ray, from the principal point.
        positions: (N, 3) m.
        slopes: (N, 3, 3) m/rad.
        focal: (2,) px.
    """

    view: NDArray[np.int64]
    points: Array
    seen: Array
    positions: Array
    slopes: Array
    focal: Array

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.positions)

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """The rows of each view."""
        ends = np.cumsum(np.bincount(self.view, minlength=self.views)).tolist()
        return tuple(slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True))

    @staticmethod
    def of(views: Sequence[View], intrinsics: Intrinsics) -> Corners:
        """Gather the corners of `views` and undistort them.

        Raises:
            CameraInfoError: the lens's distortion is not one-to-one at a corner.
        """
        focal = np.array([intrinsics.fx, intrinsics.fy])
        pixels = np.concatenate([view.sighting.pixels for view in views])
        return Corners(
            np.repeat(np.arange(len(views)), [len(view.sighting.pixels) for view in views]),
            np.concatenate([view.sighting.corners for view in views]),
            focal * rays(pixels, intrinsics),
            np.stack([view.position for view in views]),
            np.stack([view.slope for view in views]),
            focal,
        )
