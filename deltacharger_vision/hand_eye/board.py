# SPDX-License-Identifier: Apache-2.0
"""A calibration board, one printed AprilTag: its description, and its corners in an image.

The corners are the intersections of the black square's straight edges. An edge lies where the light is half-way between
both sides, found from the area under a profile across it in linear light. In the encoded values of an image (sRGB), the
middle of a blurred edge is displaced.

The board's frame: origin at the centre of the black square, x to the right and y up on the print, z out of the print,
toward the viewer. Corners lie at z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision import errors, images

_PROFILE = 13  # samples across an edge
_ENDS = 2  # of them at either end, for the levels of both sides
_WIDEST, _NARROWEST = 4.0, 1.2  # px to either side
_CONTRAST = 0.25  # of the strongest edge; a weaker sample is no edge
_FEWEST = 4  # samples of an edge
_PASSES = 3

Gray = NDArray[np.uint8]

FAMILIES = ("16h5", "25h9", "36h10", "36h11")
"""AprilTag families."""
SMALLEST, LARGEST = 0.002, 1.0
"""Side of a tag, m."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """Visible corners of a board in an image.

    Attributes:
        corners: (K, 3) m in the board's frame.
        pixels: (K, 2) px, their positions in the image; the centre of the first pixel is (0, 0).
        white: 0 to 255, value reached by the brightest twentieth of the pixels between them.
    """

    corners: Array
    pixels: Array
    white: float = 0.0


@dataclass(frozen=True)
class Board:
    """One AprilTag.

    Attributes:
        family: one of `FAMILIES`.
        tag: its number in the family.
        size: side of its black square, m.

    Raises:
        BoardError: no such tag, or the size is out of bounds.
    """

    family: str = "36h11"
    tag: int = 0
    size: float = 0.040

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise errors.BoardError("family", f"'{self.family}' is none of {', '.join(FAMILIES)}")
        count = len(dictionary(self.family).bytesList)
        if not 0 <= self.tag < count:
            raise errors.BoardError("tag", f"{self.tag} is not in {self.family}, which has the tags 0…{count - 1}")
        if not SMALLEST <= self.size <= LARGEST:
            raise errors.BoardError(
                "size", f"{1e3 * self.size:g} mm is outside {1e3 * SMALLEST:g}…{1e3 * LARGEST:g} mm"
            )

    @staticmethod
    def named(text: str, size: float) -> Board:
        """Return the board with the name `apriltag:FAMILY:NUMBER`, and a black square of `size` m.

        Raises:
            BoardError: unknown name, or the size is out of bounds.
        """
        kind, *parts = text.lower().split(":")
        if kind != "apriltag" or len(parts) != 2 or not parts[1].isdecimal():
            raise errors.BoardError("board", f"'{text}' is not a board; write apriltag:36h11:0")
        return Board(parts[0], int(parts[1]), size)

    @property
    def name(self) -> str:
        """Name for `named`."""
        return f"apriltag:{self.family}:{self.tag}"

    @property
    def margin(self) -> float:
        """Width of the white margin around the black square: one cell, m."""
        return self.size / len(self.cells())

    def corners(self) -> Array:
        """Return (4, 3) m: upper left, upper right, lower right, lower left."""
        half = self.size / 2
        return np.array([(-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0), (-half, -half, 0.0)])

    def cells(self) -> Mask:
        """Return (n, n) cells with the border, True = black, first row on top."""
        family = dictionary(self.family)
        bits = family.getBitsFromByteList(family.bytesList[self.tag : self.tag + 1], family.markerSize)
        return np.pad(bits == 0, 1, constant_values=True)

    def detect(self, image: NDArray[np.uint8]) -> Sighting | None:
        """Return the corners; None if the board is not completely visible, or visible twice.

        Args:
            image: (H, W) gray or (H, W, 3) RGB.
        """
        import cv2

        gray = image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
        quads, numbers = find_markers(self.family, gray)
        if np.count_nonzero(numbers == self.tag) != 1:
            return None
        (pixels,) = quads[numbers == self.tag]
        shortest = float(np.linalg.norm(pixels - np.roll(pixels, 1, axis=0), axis=1).min())
        found = self._refined(gray, pixels, 0.5 * shortest / len(self.cells()))
        if not np.isfinite(found).all():
            return None
        (left, top), (right, bottom) = found.min(axis=0).astype(int), found.max(axis=0).astype(int) + 1
        return Sighting(self.corners(), found, float(np.percentile(gray[top:bottom, left:right], 95.0)))

    def _refined(self, gray: Gray, pixels: Array, free: float) -> Array:
        """Return where the edges cross (4, 2) px, NaN if invisible; `free` px beside them have no other features."""
        import cv2

        corners = self.corners()[:, :2]
        homography, _ = cv2.findHomography(np.ascontiguousarray(corners), np.ascontiguousarray(pixels))
        if homography is None:
            return np.full((4, 2), np.nan)
        # From each corner to samples on its two edges.
        along = self.size * np.linspace(0.1, 0.5, 14)
        inward = -np.sign(corners)[:, None, :, None] * np.eye(2)[None, :, :, None] * along
        offsets = np.moveaxis(inward, 2, 3)
        origin = corners[:, None, None]
        mapped, start = (_mapped(homography, points) for points in (origin + offsets, origin))
        return _crossings(gray, pixels, mapped - start, free)


@cache
def dictionary(name: str) -> Any:
    """Return OpenCV's dictionary of an AprilTag family.

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
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{name}"))


def find_markers(name: str, gray: Gray) -> tuple[Array, NDArray[np.int64]]:
    """Return the tags of a family: their outer corners (K, 4, 2) px from the upper left on, and numbers (K,)."""
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


def _mapped(homography: Array, points: Array) -> Array:
    """Return pixels (..., 2) of points (..., 2) on the board."""
    found = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(found[..., :2] / found[..., 2:])


def _crossings(gray: NDArray[np.uint8], pixels: Array, offsets: Array, free: float) -> Array:
    """Return where edges cross, (K, 2) px; NaN if they are invisible or elsewhere.

    Args:
        gray: (H, W) sRGB.
        pixels: (K, 2) px, corners within one or two pixels.
        offsets: (K, 2, M, 2) px, from each corner to samples on its two edges.
        free: px on either side of the edges without other features.
    """
    light = images.LIGHT.astype(np.float32)[gray]
    width = float(np.clip(free, _NARROWEST, _WIDEST))
    found = np.array(pixels, dtype=float)
    along = offsets[:, :, -1] - offsets[:, :, 0]
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    for _ in range(_PASSES):
        place, weight = _edges(light, found[:, None, None] + offsets, across, width)
        # The edge is the line across·(x − found) = level + slope along·(x − found).
        level, slope = _fitted(np.einsum("kemi,kei->kem", offsets, along), place, weight)
        normals = across - slope[..., None] * along
        with np.errstate(invalid="ignore"):
            step = np.linalg.solve(_invertible(normals), level[..., None])[..., 0]
        found = found + step
    return np.asarray(np.where(np.abs(found - pixels).max(axis=1, keepdims=True) <= width, found, np.nan))


def _edges(light: NDArray[np.float32], points: Array, across: Array, width: float) -> tuple[Array, Array]:
    """Return the edge's position (K, 2, M) px along `across` from points (K, 2, M, 2), and the weight of each."""
    import cv2

    steps = np.linspace(-width, width, _PROFILE)
    samples = (points[..., None, :] + steps[:, None] * across[:, :, None, None]).astype(np.float32)
    flat = np.nan_to_num(samples.reshape(len(samples), -1, 2), nan=-1.0)
    seen = cv2.remap(light, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    profile = np.asarray(seen, dtype=float).reshape(samples.shape[:-1])
    first, last = profile[..., :_ENDS].mean(axis=-1), profile[..., -_ENDS:].mean(axis=-1)
    contrast = last - first
    strong = np.abs(contrast) > _CONTRAST * np.abs(contrast).max()
    height, width_px = light.shape
    x, y = samples[..., 0], samples[..., 1]
    inside = ((x >= 0) & (y >= 0) & (x <= width_px - 1) & (y <= height - 1)).all(axis=-1)
    share = (profile - first[..., None]) / np.where(strong, contrast, 1.0)[..., None]
    # The trapezoid's area under the share of the far side.
    area = (share[..., 1:-1].sum(axis=-1) + 0.5 * (share[..., 0] + share[..., -1])) / (_PROFILE - 1)
    return width * (1.0 - 2.0 * area), (strong & inside).astype(float)


def _fitted(along: Array, place: Array, weight: Array) -> tuple[Array, Array]:
    """Return level and slope (K, 2) of place = level + slope · along (K, 2, M); NaN with too few samples."""
    with np.errstate(invalid="ignore", divide="ignore"):
        total = weight.sum(axis=-1)
        middle, mean = ((weight * values).sum(axis=-1) / total for values in (along, place))
        centred = along - middle[..., None]
        slope = (weight * centred * place).sum(axis=-1) / (weight * centred**2).sum(axis=-1)
    enough = total >= _FEWEST
    return np.where(enough, mean - slope * middle, np.nan), np.where(enough, slope, np.nan)


def _invertible(matrices: Array) -> Array:
    """Return matrices (K, 2, 2) with NaN for edges that hardly cross."""
    crossing = np.abs(np.linalg.det(np.nan_to_num(matrices))) > 0.1
    return np.where(crossing[:, None, None], matrices, np.nan)
