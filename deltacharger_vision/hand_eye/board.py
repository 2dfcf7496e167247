# SPDX-License-Identifier: Apache-2.0
"""Calibration boards of known size: an AprilTag or a ChArUco board, by name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.errors import BoardError
from deltacharger_vision.hand_eye.board_corners import (
    DICTIONARIES,
    FAMILIES,
    FEWEST_CORNERS,
    Board,
    Gray,
    Sighting,
    dictionary,
    grayscale,
    marker_detector,
)

SMALLEST, LARGEST = 0.002, 1.0
"""Side of a tag or a square, m."""
_SQUARES = (3, 30)  # each way
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
        family = dictionary(self.family)
        return np.asarray(family.generateImageMarker(self.tag, int(family.markerSize) + 2) == 0)

    def _find(self, gray: Gray) -> tuple[Array, Array, float] | None:
        quads, numbers, _ = marker_detector(self.family).detectMarkers(gray)
        if numbers is None or np.count_nonzero(numbers == self.tag) != 1:
            return None
        pixels = np.asarray(quads[int(np.argmax(np.ravel(numbers) == self.tag))], dtype=float).reshape(4, 2)
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
        """Return (rows, columns), True = black; the marker's size is rounded to a 60th of a square."""
        side = 60
        image = self._board.generateImage((self.columns * side, self.rows * side), marginSize=0, borderBits=1)
        return np.asarray(image < 128)

    @cached_property
    def _board(self) -> Any:
        import cv2

        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(size, self.square, self.marker, dictionary(self.dictionary))

    @cached_property
    def _detector(self) -> Any:
        import cv2

        return cv2.aruco.CharucoDetector(self._board)

    def _find(self, gray: Gray) -> tuple[Array, Array, float] | None:
        found, numbers, _, _ = self._detector.detectBoard(gray)
        if numbers is None or len(numbers) < FEWEST_CORNERS:
            return None
        corners = self.corners()[np.ravel(numbers)]
        pixels = np.asarray(found, dtype=float).reshape(-1, 2)
        if np.linalg.matrix_rank(corners[:, :2] - corners[0, :2], tol=1e-9) < 2:
            return None
        distance = np.linalg.norm(pixels[:, None] - pixels, axis=-1)
        shortest = float(distance[distance > 0].min())
        return corners, pixels, 0.6 * shortest * (1.0 - self.marker / self.square) / 2

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
        numbers = marker_detector(name).detectMarkers(gray)[1]
        kind = "apriltag" if name in FAMILIES else "marker"
        found += [] if numbers is None else sorted({f"{kind} {name} {number}" for number in np.ravel(numbers)})
    return tuple(found)


def _check_length(name: str, length: float) -> None:
    if not math.isfinite(length) or not SMALLEST <= length <= LARGEST:
        raise BoardError(name, f"{1e3 * length:g} mm is outside {1e3 * SMALLEST:g}…{1e3 * LARGEST:g} mm")


def _along_x(values: Array) -> Array:
    return np.stack([values, np.zeros_like(values)], axis=-1)


def _along_y(values: Array) -> Array:
    return np.stack([np.zeros_like(values), values], axis=-1)
