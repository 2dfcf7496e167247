# SPDX-License-Identifier: Apache-2.0
"""Bright elongated blobs of an image, which may be electrodes or parts of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array

# Grey levels (0–255) above which a pixel is bright; one of them suits the light.
_LEVELS = (25, 40, 60, 90, 125, 160, 195, 230)
_NEIGHBOURHOOD = 61  # px, side of the window for the local mean
_EXCESS = 12  # least excess of a locally bright pixel over the mean, grey levels
_SHORTEST = 12.0  # px, least length of a bar
_THINNEST = 2.0  # px, least width of a bar
_STOUT = 1.4  # least length over width
_SLENDER = 14.0  # largest length over width
_FILL = 0.72  # least share of the enclosing rectangle that a blob covers
# Differences within 3 × 3 px, of 255 in any colour, that separate pieces; one of them suits the light.
_PARTING = (14, 28)
_STUB = 1.1  # least length over width of a piece of a bar
_MOST = 60  # most blobs to examine, the most rectangular first

Image = NDArray[np.uint8]

_LOST = 3.0  # px by which the edges around a piece, with the pixels beside them, narrow it


@dataclass(frozen=True)
class Blobs:
    """Rectangles around N blobs.

    Attributes:
        centre: (N, 2) px.
        direction: (N, 2) unit vector along the long side, toward +x.
        length: (N,) px.
        width: (N,) px.
        fill: (N,) share of the rectangle that is bright.
    """

    centre: Array
    direction: Array
    length: Array
    width: Array
    fill: Array

    def __len__(self) -> int:
        return len(self.length)

    def chosen(self, rows: NDArray[Any]) -> Blobs:
        """Return the blobs of an index or mask."""
        return Blobs(self.centre[rows], self.direction[rows], self.length[rows], self.width[rows], self.fill[rows])


def find_blobs(grey: Image) -> Blobs:
    """Return at most `_MOST` blobs of a grey image (H, W) that may be bars or parts of bars."""
    import cv2

    smooth = cv2.GaussianBlur(grey, (3, 3), 0)
    brightest = int(smooth.max())
    rows: list[tuple[float, ...]] = []
    for level in _LEVELS:
        if level < brightest:
            rows += _rectangles((smooth > level).view(np.uint8))
    mean = cv2.blur(smooth, (_NEIGHBOURHOOD, _NEIGHBOURHOOD))
    rows += _rectangles((cv2.subtract(smooth, mean) > _EXCESS).view(np.uint8))
    return _chosen(rows, _MOST)


def find_pieces(color: Image) -> Blobs:
    """Return the uniform parts of an image (H, W, 3) that may be pieces of bars, even if something covers the bars.

    An equally bright object across a bar merges with it at every grey level. Its edge still separates the two.
    """
    import cv2

    smooth = cv2.GaussianBlur(color, (3, 3), 0)
    change = cv2.morphologyEx(smooth, cv2.MORPH_GRADIENT, np.ones((3, 3), dtype=np.uint8)).max(axis=2)
    rows: list[tuple[float, ...]] = []
    for parting in _PARTING:
        rows += _rectangles((change < parting).view(np.uint8), _LOST)
    return _chosen(rows, _MOST)


def _chosen(rows: list[tuple[float, ...]], most: int) -> Blobs:
    table = np.array(rows, dtype=float).reshape(-1, 6)
    table = table[np.argsort(-table[:, 5])]
    blobs = Blobs(table[:, :2], _direction(table[:, 4]), table[:, 2], table[:, 3], table[:, 5])
    return blobs.chosen(_distinct(blobs, most))


def _rectangles(mask: Image, lost: float = 0.0) -> list[tuple[float, ...]]:
    """Return x, y, length, width, angle of the long side (rad), fill of each blob of a mask that may be a bar.

    If the mask shows everything too narrow by `lost` px, pieces of bars are accepted.
    """
    import cv2

    height, width = mask.shape
    shortest, stout = (_SHORTEST, _STOUT) if not lost else (0.5 * _SHORTEST, _STUB)
    contours, family = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    rows: list[tuple[float, ...]] = []
    for index, contour in enumerate(contours):
        # A hole between pieces is as large as a bar with its edges.
        if len(contour) < 4 or (lost and family[0, index, 3] >= 0):
            continue
        _, _, box_width, box_height = cv2.boundingRect(contour)
        if max(box_width, box_height) + lost < shortest or (box_width > 0.9 * width and box_height > 0.9 * height):
            continue
        (x, y), (first, second), degrees = cv2.minAreaRect(contour)
        first, second = first + 1.0 + lost, second + 1.0 + lost  # the contour runs through pixel centres
        if first < second:
            first, second, degrees = second, first, degrees + 90.0
        if first < shortest or second < _THINNEST:
            continue
        if not stout <= first / second <= _SLENDER:
            continue
        area = cv2.contourArea(contour) + 0.5 * (1.0 + lost) * cv2.arcLength(contour, True) + (1.0 + lost) ** 2
        fill = min(area / (first * second), 1.0)
        if fill >= _FILL:
            rows.append((x, y, first, second, np.radians(degrees), fill))
    return rows


def _direction(angle: Array) -> Array:
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.where(direction[:, :1] < 0.0, -direction, direction)


def _distinct(blobs: Blobs, most: int) -> NDArray[np.int64]:
    """Return the indices of at most `most` blobs that are not nearly the same as an earlier one."""
    kept: list[int] = []
    left = np.arange(len(blobs))
    while len(left) and len(kept) < most:
        first, left = left[0], left[1:]
        kept.append(int(first))
        apart = np.hypot(*(blobs.centre[left] - blobs.centre[first]).T)
        ratio, thickness = blobs.length[left] / blobs.length[first], blobs.width[left] / blobs.width[first]
        alike = (np.abs(ratio - 1.0) < 0.06) & (np.abs(thickness - 1.0) < 0.25)
        left = left[~(alike & (apart < 0.2 * blobs.width[first] + 0.5))]
    return np.array(kept, dtype=np.int64)
