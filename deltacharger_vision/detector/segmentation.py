# SPDX-License-Identifier: Apache-2.0
"""Bright elongated blobs of an image: what may be an electrode, or a part of one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.parameters import Bounded, number

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class SegmentationSettings(Bounded):
    """Which blobs may be bars.

    Attributes:
        levels: grey levels (0–255) above which a pixel is bright; one of them suits the light.

    Raises:
        ParameterError: a value is out of bounds.
    """

    levels: tuple[int, ...] = (25, 40, 60, 90, 125, 160, 195, 230)
    neighbourhood: int = number(61, 3, 1001, "px", "side of the window whose mean a locally bright pixel exceeds")
    excess: int = number(12, 1, 254, "", "grey levels by which it does")
    shortest: float = number(12.0, 2.0, 1000.0, "px", "least length of a bar")
    thinnest: float = number(2.0, 1.0, 100.0, "px", "least width of a bar")
    stout: float = number(1.4, 1.0, 10.0, "", "least length over width")
    slender: float = number(14.0, 2.0, 100.0, "", "largest length over width")
    fill: float = number(0.72, 0.3, 1.0, "", "least share of the enclosing rectangle that a blob covers")
    most: int = number(60, 2, 1000, "", "blobs that are looked at, the most rectangular first")


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
        """Return those of an index or mask."""
        return Blobs(self.centre[rows], self.direction[rows], self.length[rows], self.width[rows], self.fill[rows])


def find_blobs(grey: Image, settings: SegmentationSettings) -> Blobs:
    """Return the blobs of a grey image (H, W) that may be bars or parts of bars, at most `settings.most`."""
    import cv2

    smooth = cv2.GaussianBlur(grey, (3, 3), 0)
    brightest = int(smooth.max())
    rows: list[tuple[float, ...]] = []
    for level in settings.levels:
        if level < brightest:
            rows += _rectangles((smooth > level).view(np.uint8), settings)
    mean = cv2.blur(smooth, (settings.neighbourhood, settings.neighbourhood))
    rows += _rectangles((cv2.subtract(smooth, mean) > settings.excess).view(np.uint8), settings)
    table = np.array(rows, dtype=float).reshape(-1, 6)
    order = np.argsort(-table[:, 5])
    table = table[order]
    blobs = Blobs(table[:, :2], _direction(table[:, 4]), table[:, 2], table[:, 3], table[:, 5])
    return blobs.chosen(_distinct(blobs)[: settings.most])


def _rectangles(mask: Image, settings: SegmentationSettings) -> list[tuple[float, ...]]:
    """Return x, y, length, width, angle of the long side (rad), fill of each blob of a mask that may be a bar."""
    import cv2

    height, width = mask.shape
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    rows: list[tuple[float, ...]] = []
    for contour in contours:
        if len(contour) < 4:
            continue
        _, _, box_width, box_height = cv2.boundingRect(contour)
        if max(box_width, box_height) < settings.shortest or (box_width > 0.9 * width and box_height > 0.9 * height):
            continue
        (x, y), (first, second), degrees = cv2.minAreaRect(contour)
        first, second = first + 1.0, second + 1.0  # the contour runs through pixel centres
        if first < second:
            first, second, degrees = second, first, degrees + 90.0
        if first < settings.shortest or second < settings.thinnest:
            continue
        if not settings.stout <= first / second <= settings.slender:
            continue
        area = cv2.contourArea(contour) + 0.5 * cv2.arcLength(contour, True) + 1.0
        fill = min(area / (first * second), 1.0)
        if fill >= settings.fill:
            rows.append((x, y, first, second, np.radians(degrees), fill))
    return rows


def _direction(angle: Array) -> Array:
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.where(direction[:, :1] < 0.0, -direction, direction)


def _distinct(blobs: Blobs) -> NDArray[np.int64]:
    """Return the indices of blobs that are not nearly the same as an earlier one."""
    count = len(blobs)
    apart = np.hypot(*(blobs.centre[:, None] - blobs.centre[None]).transpose(2, 0, 1))
    ratio = blobs.length[:, None] / blobs.length[None]
    thickness = blobs.width[:, None] / blobs.width[None]
    same = (apart < 0.2 * blobs.width[None] + 0.5) & (np.abs(ratio - 1.0) < 0.06) & (np.abs(thickness - 1.0) < 0.25)
    kept: list[int] = []
    for index in range(count):
        if not same[index, kept].any():
            kept.append(index)
    return np.array(kept, dtype=np.int64)
