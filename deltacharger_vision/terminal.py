# SPDX-License-Identifier: Apache-2.0
"""A terminal: geometry of two metal bars raised from a dark plate, its poses and its detection in an image.

A pose is (rotation (3, 3), translation (3,) m): terminal coordinates to the optical frame. Inside the detector, the
terminal's frame has its origin at the midpoint of the touched faces, x along the bars and z away from the camera.
The bars' roots on the plate are at z = +bar_thickness.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from deltacharger_core import arrays, machine, parameters, yaml_file
from deltacharger_core.parameters import number
from deltacharger_vision.errors import TerminalError

LOWER, UPPER = 0, 1
"""Rows of `Terminal.corners`."""


@dataclass(frozen=True)
class Terminal(parameters.Bounded):
    """Two equal bars; lengths in m.

    The terminal's frame: origin at the midpoint between the bars on their touched faces, x along the bars, y from the
    lower to the upper bar, z **into the plate**, away from the viewer. If the target stands straight in front of the
    charger, the axes are those of `charger_base` (+z toward the target, +y up, +x to the left when looking along +z).
    The plate's face is at z = bar_thickness.

    Raises:
        ParameterError: a length is out of bounds.
    """

    bar_length: float = number(machine.BAR_LENGTH, 0.005, 1.0, "m", "along x (assumed)")
    bar_height: float = number(machine.BAR_HEIGHT, 0.001, 0.5, "m", "of one bar along y (assumed)")
    gap: float = number(machine.BAR_GAP, 0.0005, 0.5, "m", "between the bars along y (assumed)")
    bar_thickness: float = number(0.006, 0.0, 0.1, "m", "of the bars above the plate (assumed)")

    @property
    def spacing(self) -> float:
        """Distance between the bars' middle lines, m."""
        return self.bar_height + self.gap

    def corners(self) -> arrays.Array:
        """Return (2, 4, 3) m: corners of the touched face of the lower, then the upper bar, in the terminal's frame.

        Order: (−x, −y), (+x, −y), (+x, +y), (−x, +y): counter-clockwise about +z, clockwise in an image of a camera
        that looks along +z with y down and x right.
        """
        x, y = self.bar_length / 2, self.bar_height / 2
        face = np.array([(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)])
        shift = np.array([0.0, self.spacing / 2, 0.0])
        return np.stack([face - shift, face + shift])

    @staticmethod
    def load(path: str | Path) -> Terminal:
        """Read a YAML mapping of any of the four lengths in m; missing ones keep their defaults.

        Raises:
            FileNotFoundError: no such file.
            TerminalError: not such a mapping, an unknown key, or a length out of bounds.
        """
        source = str(path)
        try:
            found = yaml_file.read_yaml(path)
        except yaml_file.YamlError as error:
            raise TerminalError(source, f"{error.problem}; correct it") from error
        try:
            return parameters.from_mapping(found, Terminal)
        except parameters.ParameterError as error:
            raise TerminalError(source, str(error)) from error


@dataclass(frozen=True)
class TerminalPose:
    """Pose of the terminal in the optical frame: rotation (3, 3), translation (3,) m."""

    rotation: arrays.Array
    translation: arrays.Array

    def moved(self, step: arrays.Array) -> TerminalPose:
        """Return the pose after a step (6,): translation (m), then rotation about the optical axes (rad)."""
        return TerminalPose(turn(step[3:]) @ self.rotation, self.translation + step[:3])

    def points(self, terminal_points: arrays.Array) -> arrays.Array:
        """Return points (..., 3) of the terminal in the optical frame, m."""
        return np.asarray(terminal_points @ self.rotation.T + self.translation)


def turn(vector: arrays.Array) -> arrays.Array:
    """Return the rotation matrix of a rotation vector (3,) rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    skew = cross_matrix(vector)
    if angle < 1e-9:
        return np.asarray(np.eye(3) + skew)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * skew + (1.0 - np.cos(angle)) / angle**2 * skew @ skew)


def transform(rotation: arrays.Array, position: ArrayLike) -> arrays.Array:
    """Return the transform (4, 4) of a rotation (3, 3) and a position (3,) m."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return pose


def cross_matrix(vector: arrays.Array) -> arrays.Array:
    """Return [v]× of a vector (3,), so that [v]× w = v × w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def facing(pose: TerminalPose) -> float:
    """Return the cosine between the line of sight and the terminal's z axis: 1 from the front, 0 edge-on."""
    return float(pose.rotation[:, 2] @ pose.translation / np.linalg.norm(pose.translation))


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

    position: arrays.Array
    roll: float
    axis: arrays.Array
    normal: arrays.Array
    covariance: arrays.Array
    confidence: float
    range: float
    bars: arrays.Array
    source: str
