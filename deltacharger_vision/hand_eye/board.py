# SPDX-License-Identifier: Apache-2.0
"""A calibration board: its description, and its corners in an image.

Subpixel corners of printed squares: the intersections of their straight edges.
An edge lies where the light is half-way between both sides, found from the area under a profile across it in linear
light. In the encoded values of an image (sRGB), the middle of a blurred edge is displaced.

Common parts of calibration boards: visible corners of a board, and OpenCV's markers.
A board's frame: origin at the centre of the printed pattern, x to the right and y up on the print, z out of the print,
toward the viewer. Corners lie at z = 0.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.errors import BoardError
from deltacharger_vision.images import LIGHT

_PROFILE = 13  # samples across an edge
_ENDS = 2  # of them at either end, for the levels of both sides
_WIDEST, _NARROWEST = 4.0, 1.2  # px to either side
_CONTRAST = 0.25  # of the strongest edge; a weaker sample is no edge
_FEWEST = 4  # samples of an edge
_PASSES = 3


def refined(gray: NDArray[np.uint8], pixels: Array, offsets: Array, free: float) -> Array:
    """Return where edges cross, (K, 2) px; NaN if they are invisible or elsewhere.

    Args:
        gray: (H, W) sRGB.
        pixels: (K, 2) px, corners within one or two pixels.
        offsets: (K, 2, M, 2) px, from each corner to samples on its two edges.
        free: px on either side of the edges without other features.
    """
    light = LIGHT.astype(np.float32)[gray]
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


SMALLEST, LARGEST = 0.002, 1.0
"""Side of a tag or a square, m."""
_SQUARES = (3, 30)  # each way
_CELL = np.ones((10, 10), dtype=bool)  # of a marker, in the drawing
_MARKER = (0.3, 0.95)  # of a square's side
_HINTED = ("36h11", "25h9", "4x4_1000", "5x5_1000", "6x6_1000", "7x7_1000")

__all__ = ["AprilTag", "Board", "BoardError", "Charuco", "Sighting", "markers_in", "parse_board"]


@dataclass(frozen=True)
class AprilTag(Board):
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
            raise BoardError("family", f"'{self.family}' is none of {', '.join(FAMILIES)}")
        count = len(dictionary(self.family).bytesList)
        if not 0 <= self.tag < count:
            raise BoardError("tag", f"{self.tag} is not in {self.family}, which has the tags 0…{count - 1}")
        _check_length("size", self.size)

    @property
    def name(self) -> str:
        """Name for `parse_board`."""
        return f"apriltag:{self.family}:{self.tag}"

    @property
    def length(self) -> float:
        """Side of the black square, m."""
        return self.size

    @property
    def pattern(self) -> tuple[float, float]:
        """Width and height of the black square, m."""
        return self.size, self.size

    @property
    def margin(self) -> float:
        """One cell."""
        return self.size / len(self.cells())

    def corners(self) -> Array:
        """Return (4, 3) m: upper left, upper right, lower right, lower left."""
        half = self.size / 2
        return np.array([(-half, half, 0.0), (half, half, 0.0), (half, -half, 0.0), (-half, -half, 0.0)])

    def cells(self) -> Mask:
        """Return (rows, columns), True = black: the border and the bits."""
        return marker_cells(self.family, self.tag)

    def _find(self, gray: Gray) -> tuple[Array, Array, float] | None:
        quads, numbers = find_markers(self.family, gray)
        if np.count_nonzero(numbers == self.tag) != 1:
            return None
        (pixels,) = quads[numbers == self.tag]
        shortest = float(np.linalg.norm(pixels - np.roll(pixels, 1, axis=0), axis=1).min())
        return self.corners(), pixels, 0.5 * shortest / len(self.cells())

    def _edges(self, corners: Array) -> Array:
        along = self.size * np.linspace(0.1, 0.5, 14)
        inward = -np.sign(corners[:, :2])
        return np.stack([_along_x(along) * inward[:, None], _along_y(along) * inward[:, None]], axis=1)


@dataclass(frozen=True)
class Charuco(Board):
    """A chessboard with markers in its white squares.

    Attributes:
        dictionary: one of `DICTIONARIES`.
        columns: squares along x.
        rows: squares along y.
        square: side of a square, m.
        marker: side of a marker's black square, m.

    Raises:
        BoardError: a value is out of bounds, or the dictionary has too few markers.
    """

    dictionary: str = "4x4_50"
    columns: int = 5
    rows: int = 4
    square: float = 0.012
    marker: float = 0.009

    def __post_init__(self) -> None:
        if self.dictionary not in DICTIONARIES:
            raise BoardError("dictionary", f"'{self.dictionary}' is none of {', '.join(DICTIONARIES)}")
        low, high = _SQUARES
        if not (low <= self.columns <= high and low <= self.rows <= high):
            raise BoardError("squares", f"{self.columns} × {self.rows}; give {low}…{high} each way")
        count = len(dictionary(self.dictionary).bytesList)
        if self.columns * self.rows // 2 > count:
            raise BoardError("dictionary", f"{self.dictionary} has {count} markers, too few for {self.name}")
        _check_length("square", self.square)
        low_share, high_share = _MARKER
        if not low_share * self.square <= self.marker <= high_share * self.square:
            reason = f"{1e3 * self.marker:g} mm; give {low_share:g}…{high_share:g} of the square's"
            raise BoardError("marker", f"{reason} {1e3 * self.square:g} mm")

    @property
    def name(self) -> str:
        """Name for `parse_board`."""
        return f"charuco:{self.dictionary}:{self.columns}x{self.rows}"

    @property
    def length(self) -> float:
        """Side of a square, m."""
        return self.square

    @property
    def pattern(self) -> tuple[float, float]:
        """Width and height of all squares, m."""
        return self.columns * self.square, self.rows * self.square

    @property
    def margin(self) -> float:
        """A third of a square."""
        return self.square / 3

    def corners(self) -> Array:
        """Return the inner corners ((columns − 1)(rows − 1), 3) m, row by row from the upper left."""
        x = self.square * (np.arange(1, self.columns) - self.columns / 2)
        y = self.square * (self.rows / 2 - np.arange(1, self.rows))
        across, down = np.meshgrid(x, y)
        return np.stack([across.ravel(), down.ravel(), np.zeros(across.size)], axis=-1)

    def cells(self) -> Mask:
        """Return (rows, columns), True = black; markers are set in by a whole number of tenths of their cells."""
        places = np.argwhere(self._white())
        markers = [np.kron(marker_cells(self.dictionary, number), _CELL) for number in range(len(places))]
        size = len(markers[0])
        edge = round(size * (self.square / self.marker - 1.0) / 2)
        side = size + 2 * edge
        found = np.kron(~self._white(), np.ones((side, side), dtype=bool))
        for marker, (row, column) in zip(markers, places, strict=True):
            top, left = side * row + edge, side * column + edge
            found[top : top + size, left : left + size] = marker
        return found

    def _white(self) -> Mask:
        """Return (rows, columns), True = white with a marker, numbered row by row; the first square is black.

        So it is in OpenCV since 4.7. An older one begins boards with an even number of rows with a white square.
        """
        return np.asarray(np.indices((self.rows, self.columns)).sum(axis=0) % 2 == 1)

    def _find(self, gray: Gray) -> tuple[Array, Array, float] | None:
        import cv2

        quads, numbers = find_markers(self.dictionary, gray)
        white = np.argwhere(self._white())
        inset = (1.0 - self.marker / self.square) / 2
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=np.float32)
        marker = inset + (1.0 - 2.0 * inset) * square
        # An inner corner lies between two markers, one above and one below it. Both must tell where it is.
        told = np.full((2, self.rows + 1, self.columns + 1, 2), np.nan)
        for quad, number in zip(quads, numbers, strict=True):
            if number < len(white) and np.count_nonzero(numbers == number) == 1:
                row, column = white[number]
                mapping = cv2.getPerspectiveTransform(marker, quad.astype(np.float32))
                upper_left, upper_right, lower_right, lower_left = cv2.perspectiveTransform(square[None], mapping)[0]
                told[1, row, column : column + 2] = upper_left, upper_right
                told[0, row + 1, column : column + 2] = lower_left, lower_right
        pixels = told.mean(axis=0)[1:-1, 1:-1].reshape(-1, 2)
        seen = np.isfinite(pixels).all(axis=1)
        corners, pixels = self.corners()[seen], pixels[seen].astype(np.float32)
        if len(corners) < FEWEST_CORNERS or np.linalg.matrix_rank(corners[:, :2] - corners[0, :2], tol=1e-9) < 2:
            return None
        distance = np.linalg.norm(pixels[:, None] - pixels, axis=-1)
        gap = float(distance[distance > 0].min()) * inset  # px between a corner and the markers beside it
        window = (max(1, int(gap)),) * 2
        cv2.cornerSubPix(gray, pixels, window, (-1, -1), (cv2.TERM_CRITERIA_COUNT, 10, 0.0))
        return corners, pixels.astype(float), 0.6 * gap

    def _edges(self, corners: Array) -> Array:
        half = self.square * np.linspace(0.25, 0.75, 8)
        along = np.concatenate([-half[::-1], half])
        return np.repeat(np.stack([_along_x(along), _along_y(along)])[None], len(corners), axis=0)


def parse_board(text: str, size: float, marker: float | None = None) -> Board:
    """Return the board with the name `text`.

    Args:
        text: `apriltag:FAMILY:NUMBER` or `charuco:DICTIONARY:COLUMNSxROWS`.
        size: side of the tag's black square or of a chessboard square, m.
        marker: side of a ChArUco marker, m; None = three quarters of the square.

    Raises:
        BoardError: unknown name, or a value is out of bounds.
    """
    kind, *parts = text.lower().split(":")
    try:
        if kind == "apriltag" and len(parts) == 2:
            if marker is not None:
                raise BoardError("marker", "an AprilTag has one size; omit the marker's")
            return AprilTag(parts[0], int(parts[1]), size)
        if kind == "charuco" and len(parts) == 2:
            columns, rows = map(int, parts[1].split("x"))
            return Charuco(parts[0], columns, rows, size, 0.75 * size if marker is None else marker)
    except BoardError:
        raise
    except ValueError:
        pass
    raise BoardError("board", f"'{text}' is not a board; write apriltag:36h11:0 or charuco:4x4_50:5x4")


def markers_in(image: NDArray[np.uint8]) -> tuple[str, ...]:
    """Return names of markers of common dictionaries in an image (H, W[, 3]), as a hint at another board."""
    gray = grayscale(image)
    found = []
    for name in _HINTED:
        kind = "apriltag" if name in FAMILIES else "marker"
        found += sorted({f"{kind} {name} {number}" for number in find_markers(name, gray)[1]})
    return tuple(found)


def _check_length(name: str, length: float) -> None:
    if not math.isfinite(length) or not SMALLEST <= length <= LARGEST:
        raise BoardError(name, f"{1e3 * length:g} mm is outside {1e3 * SMALLEST:g}…{1e3 * LARGEST:g} mm")


def _along_x(values: Array) -> Array:
    return np.stack([values, np.zeros_like(values)], axis=-1)


def _along_y(values: Array) -> Array:
    return np.stack([np.zeros_like(values), values], axis=-1)
