# SPDX-License-Identifier: Apache-2.0
"""Result of the detector for one image."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_core.arrays import Array


@dataclass(frozen=True)
class Detection:
    """Pose of a terminal's electrodes, in the camera's optical frame (x right, y down, z forward).

    Attributes:
        position: (3,) m, midpoint between the bars' touched faces.
        roll: rad in (−π/2, π/2], from +x to the projection of the bars' long axis on the x–y plane.
        axis: (3,) unit vector along the bars; its projection on the x–y plane has the angle `roll`.
        normal: (3,) unit normal of the touched faces, toward the camera; NaN if unreliable.
        covariance: (6, 6) of position (m) and of a small rotation about the frame's x, y, z (rad).
        confidence: 0 to 1: visible share of the bars' outlines, reduced if image and depth disagree.
        range: m, from the camera's centre to `position`.
        bars: (2, 4, 2) px, corners of the touched faces in the image, in order around each bar.
        source: "both" image and depth, or "image" alone, as in ElectrodeDetection.
    """

    position: Array
    roll: float
    axis: Array
    normal: Array
    covariance: Array
    confidence: float
    range: float
    bars: Array
    source: str
