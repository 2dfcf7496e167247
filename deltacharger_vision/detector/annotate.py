# SPDX-License-Identifier: Apache-2.0
"""Draws the detector's result into a copy of the colour image."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_vision.detector.detection import Detection
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.projection import project

_GREEN, _RED, _WHITE = (60, 220, 60), (230, 60, 60), (255, 255, 255)
_FRACTION = 4  # binary digits after the point of drawn coordinates
_ARROW = 0.03  # m


def annotated(image: RgbdImage, found: Detection | None) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 RGB: the bars' outlines, their midpoint, the normal if known, and the figures.

    The image itself is not changed.
    """
    import cv2

    picture = np.ascontiguousarray(image.color).copy()
    if found is None:
        _write(picture, ["no electrodes found"])
        return picture
    outlines = [np.round(bar * 2**_FRACTION).astype(np.int32) for bar in found.bars]
    cv2.polylines(picture, outlines, True, _GREEN, 1, cv2.LINE_AA, _FRACTION)
    middle = _pixel(found.position, image.intrinsics)
    cv2.drawMarker(picture, middle, _RED, cv2.MARKER_CROSS, 11, 1, cv2.LINE_AA)
    if np.all(np.isfinite(found.normal)):
        tip = _pixel(found.position + _ARROW * found.normal, image.intrinsics)
        cv2.arrowedLine(picture, middle, tip, _RED, 1, cv2.LINE_AA)
    spread = 1e3 * np.sqrt(np.diag(found.covariance)[:3])
    x, y, z = 1e3 * found.position
    lines = [
        f"x {x:.1f}  y {y:.1f}  z {z:.1f} mm",
        f"+- {spread[0]:.2f}  {spread[1]:.2f}  {spread[2]:.2f} mm",
        f"roll {math.degrees(found.roll):.2f} deg  confidence {found.confidence:.2f}  {found.source}",
    ]
    _write(picture, lines)
    return picture


def _pixel(point: Array, intrinsics: Intrinsics) -> tuple[int, int]:
    x, y = np.clip(np.round(project(point, intrinsics)), -(2**15), 2**15)
    return int(x), int(y)


def _write(picture: NDArray[np.uint8], lines: list[str]) -> None:
    """Write lines of text into the upper left corner, on a dark strip."""
    import cv2

    scale = max(0.35, picture.shape[0] / 900.0)
    height = round(36 * scale)
    width = max(cv2.getTextSize(line, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0] for line in lines)
    strip = picture[: height * len(lines) + height // 2, : width + height]
    strip[:] = strip // 3
    for row, line in enumerate(lines):
        place = (height // 3, height * (row + 1))
        cv2.putText(picture, line, place, cv2.FONT_HERSHEY_SIMPLEX, scale, _WHITE, 1, cv2.LINE_AA)
