# SPDX-License-Identifier: Apache-2.0
"""Calibration boards of known size: an AprilTag or a ChArUco board, by name."""

from __future__ import annotations

import math
from dataclasses import dataclass

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
    find_markers,
    grayscale,
    marker_cells,
)

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
