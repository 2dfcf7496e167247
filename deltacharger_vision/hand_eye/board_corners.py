# SPDX-License-Identifier: Apache-2.0
"""Common parts of calibration boards: visible corners of a board, and OpenCV's markers.

A board's frame: origin at the centre of the printed pattern, x to the right and y up on the print, z out of the print,
toward the viewer. Corners lie at z = 0.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.errors import BoardError
from deltacharger_vision.hand_eye.corner_refinement import refined

Gray = NDArray[np.uint8]

FAMILIES = ("16h5", "25h9", "36h10", "36h11")
"""AprilTag families."""
DICTIONARIES = tuple(f"{bits}x{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000))
"""Marker dictionaries of ChArUco boards."""
FEWEST_CORNERS = 4
"""Fewest visible corners of a detected board."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """Visible corners of a board in an image.

    Attributes:
        corners: (K, 3) m in the board's frame, K ≥ 4.
        pixels: (K, 2) px, their positions in the image; the centre of the first pixel is (0, 0).
        white: 0 to 255, value reached by the brightest twentieth of the pixels between them.
    """

    corners: Array
    pixels: Array
    white: float = 0.0


class Board(ABC):
    """Common base of both kinds of board."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name for `parse_board`."""

    @property
    @abstractmethod
    def length(self) -> float:
        """Side of the tag's black square, or of a chessboard square, m."""

    @property
    @abstractmethod
    def pattern(self) -> tuple[float, float]:
        """Width and height of the printed pattern without its white margin, m."""

    @property
    @abstractmethod
    def margin(self) -> float:
        """Width of the white margin around the pattern, m."""

    @abstractmethod
    def corners(self) -> Array:
        """Return all detectable corners (K, 3) m."""

    @abstractmethod
    def cells(self) -> Mask:
        """Return (rows, columns) of the pattern's equal rectangles, True = black, first row on top."""

    @abstractmethod
    def _find(self, gray: Gray) -> tuple[Array, Array, float] | None:
        """Return corners (K, 3) m, their pixels (K, 2) within about a pixel, and the free px around them."""

    @abstractmethod
    def _edges(self, corners: Array) -> Array:
        """Return (K, 2, M, 2) m: from each corner to samples on its two edges."""

    def detect(self, image: NDArray[np.uint8]) -> Sighting | None:
        """Return the visible corners; None if the board is not visible, or visible twice.

        Args:
            image: (H, W) gray or (H, W, 3) RGB.

        Raises:
            BoardError: the image has another shape or type.
        """
        gray = grayscale(image)
        found = self._find(gray)
        if found is None or len(found[0]) < FEWEST_CORNERS:
            return None
        corners, pixels, free = found
        return _refined(gray, corners, pixels, self._edges(corners), free)


@cache
def dictionary(name: str) -> Any:
    """Return OpenCV's dictionary with a name of `FAMILIES` or `DICTIONARIES`.

    Raises:
        ModuleNotFoundError: this OpenCV has no markers; states what to install.
    """
    import cv2

    if not hasattr(cv2, "aruco"):
        raise ModuleNotFoundError(
            f"OpenCV {cv2.__version__} has no markers (cv2.aruco): install OpenCV 4.7 or newer, or its contrib modules "
            "(apt: python3-opencv, pip: opencv-contrib-python-headless)",
            name="cv2",
        )
    kind = f"APRILTAG_{name}" if name in FAMILIES else name.upper()
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{kind}"))


def find_markers(name: str, gray: Gray) -> tuple[Array, NDArray[np.int64]]:
    """Return the markers of a dictionary: their outer corners (K, 4, 2) px from the upper left on, and numbers (K,)."""
    import cv2

    known = dictionary(name)
    markers: Any = cv2.aruco
    is_new = hasattr(markers, "ArucoDetector")  # since OpenCV 4.7
    parameters = markers.DetectorParameters() if is_new else markers.DetectorParameters_create()
    parameters.minMarkerDistanceRate = 0.03  # at 0.05, until 4.8, the outline of its white margin hid a tag
    if is_new:
        found = markers.ArucoDetector(known, parameters).detectMarkers(gray)
    else:
        found = markers.detectMarkers(gray, known, parameters=parameters)
    quads, numbers = found[:2]
    return np.array(quads, dtype=float).reshape(-1, 4, 2), np.array([] if numbers is None else numbers, int).ravel()


def marker_cells(name: str, number: int) -> Mask:
    """Return (n, n) cells of a marker with its border, True = black."""
    family = dictionary(name)
    bits = family.getBitsFromByteList(family.bytesList[number : number + 1], family.markerSize)
    return np.pad(bits == 0, 1, constant_values=True)


def grayscale(image: NDArray[np.uint8]) -> Gray:
    """Return (H, W) gray of an image (H, W) or (H, W, 3) RGB; raises BoardError for any other shape."""
    import cv2

    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise BoardError("image", f"shape {image.shape} of {image.dtype}; give (H, W) gray or (H, W, 3) RGB in uint8")
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def _refined(gray: Gray, corners: Array, pixels: Array, offsets: Array, free: float) -> Sighting | None:
    """Return the corners (K, 3) m with visible edges; `offsets` (K, 2, M, 2) m lead to samples on those edges."""
    import cv2

    homography, _ = cv2.findHomography(np.ascontiguousarray(corners[:, :2]), np.ascontiguousarray(pixels))
    if homography is None:
        return None
    flat = corners[:, None, None, :2] + offsets
    mapped, origin = (_mapped(homography, points) for points in (flat, corners[:, None, None, :2]))
    found = refined(gray, pixels, mapped - origin, free)
    seen = np.isfinite(found).all(axis=1)
    if np.count_nonzero(seen) < FEWEST_CORNERS:
        return None
    (left, top), (right, bottom) = (found[seen].min(axis=0).astype(int), found[seen].max(axis=0).astype(int) + 1)
    return Sighting(corners[seen], found[seen], float(np.percentile(gray[top:bottom, left:right], 95.0)))


def _mapped(homography: Array, points: Array) -> Array:
    """Return pixels (..., 2) of points (..., 2) on the board."""
    found = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(found[..., :2] / found[..., 2:])
