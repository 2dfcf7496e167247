# SPDX-License-Identifier: Apache-2.0
"""The charger as boxes and lines in charger_base, for the live view; independent of drawing libraries.

Shapes as in urdf/deltacharger.urdf.xacro; the paper gives no drawing. Colours are red, green, blue, 0 to 255.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import PAD_DISTANCE
from deltacharger_kinematics.geometry import LIMB_COUNT, LIMB_DIRECTIONS, DeltaGeometry
from deltacharger_records.view.mechanism import ROD_SPACING, SIDES, elbows, feet, motors, rods
from deltacharger_vision.terminal import Terminal

Color = tuple[int, int, int]

ORANGE: Color = (242, 130, 33)
ALUMINIUM: Color = (170, 178, 190)
DARK: Color = (74, 84, 99)
BLACK: Color = (36, 40, 46)
ELECTRODE: Color = (237, 196, 92)
PAD: Color = (26, 153, 140)
GIVEN: Color = (120, 170, 255)
SEEN: Color = (80, 220, 110)
TRAIL: Color = (230, 90, 160)

ARM_RADIUS, ROD_RADIUS = 0.0075, 0.003
"""Radius of the lines for arms and rods, m."""
_MOTOR = (0.0611, 0.0402, 0.041)  # MX-64 along radius, tangent and z
_MOTOR_BACK = 0.0105  # of its centre behind its axis, inward
_RING = 0.0255  # of the setup ring behind the motors' plane
_PAD = (0.024, 0.024, 0.006)
_POST_BACK = 0.0105  # of the posts behind the joints that they carry, inward, where no rod leans
_CAMERA = (0.036, 0.036, 0.025)  # assumed; limb 1 leaves no room for a wide one at the usual mount
_TARGET_PLATE = (0.200, 0.120, 0.005)


@dataclass
class Boxes:
    """Boxes of one frame.

    Attributes:
        centres: (n, 3) m.
        sizes: (n, 3) m.
        turns: (n, 4) quaternions x, y, z, w.
        colours: (n, 3).
    """

    centres: list[Sequence[float]] = field(default_factory=list)
    sizes: list[Sequence[float]] = field(default_factory=list)
    turns: list[Sequence[float]] = field(default_factory=list)
    colours: list[Color] = field(default_factory=list)

    def add(self, centre: Sequence[float], size: Sequence[float], colour: Color, about_z: float = 0.0) -> None:
        """Append a box, turned about z by `about_z` rad."""
        self.centres.append(tuple(float(value) for value in centre))
        self.sizes.append(tuple(float(value) for value in size))
        self.turns.append((0.0, 0.0, math.sin(0.5 * about_z), math.cos(0.5 * about_z)))
        self.colours.append(colour)


def base(geometry: DeltaGeometry) -> Boxes:
    """Return the static parts in charger_base: motors and the wings that carry them."""
    boxes = Boxes()
    for index, middle in enumerate(motors(geometry)):
        azimuth = 2.0 * math.pi * index / LIMB_COUNT
        outward = np.array([*LIMB_DIRECTIONS[index], 0.0])
        boxes.add(middle - _MOTOR_BACK * outward, _MOTOR, DARK, azimuth)
        boxes.add(middle - 0.022 * outward - (0.0, 0.0, _RING), (0.054, 0.030, 0.008), ALUMINIUM, azimuth)
    return boxes


def ring(geometry: DeltaGeometry) -> Array:
    """Return the setup ring's line (n, 3) m in charger_base."""
    radius = geometry.base_radius + 0.002
    turn = np.linspace(0.0, 2.0 * math.pi, 49)
    height = np.full_like(turn, -geometry.z_offset - _RING)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])


def platform(geometry: DeltaGeometry) -> Boxes:
    """Return the platform with electrodes, pads and joint posts, in end_effector."""
    boxes, terminal = Boxes(), Terminal()
    boxes.add((0.0, 0.0, -0.013), (0.074, 0.045, 0.014), DARK)
    boxes.add((0.0, 0.0, -0.008), (0.120, 0.012, 0.004), DARK)
    post = geometry.platform_radius - _POST_BACK
    for index, foot in enumerate(feet(geometry)):
        azimuth = 2.0 * math.pi * index / LIMB_COUNT
        outward = foot / geometry.platform_radius
        boxes.add(0.5 * post * outward - (0.0, 0.0, 0.022), (post, 0.044, 0.004), ALUMINIUM, azimuth)
        for _, share in SIDES:
            joint = foot + share * ROD_SPACING * np.array([-outward[1], outward[0], 0.0])
            boxes.add(joint - _POST_BACK * outward - (0.0, 0.0, 0.012), (0.006, 0.006, 0.024), ALUMINIUM, azimuth)
            boxes.add(joint - 0.5 * _POST_BACK * outward, (_POST_BACK, 0.004, 0.004), DARK, azimuth)
    for side in (1.0, -1.0):
        bar = (terminal.bar_length, terminal.bar_height, terminal.bar_thickness)
        boxes.add((0.0, side * terminal.spacing / 2, -terminal.bar_thickness / 2), bar, ELECTRODE)
        boxes.add((side * PAD_DISTANCE, 0.0, -_PAD[2] / 2), _PAD, PAD)
    return boxes


def target(colour: Color) -> Boxes:
    """Return the terminal on its plate; origin midway between the bars on their contact faces, z into the plate."""
    boxes, terminal = Boxes(), Terminal()
    boxes.add((0.0, 0.0, terminal.bar_thickness + _TARGET_PLATE[2] / 2), _TARGET_PLATE, colour)
    for side in (1.0, -1.0):
        bar = (terminal.bar_length, terminal.bar_height, terminal.bar_thickness)
        boxes.add((0.0, side * terminal.spacing / 2, terminal.bar_thickness / 2), bar, colour)
    return boxes


def camera() -> Boxes:
    """Return the camera's body in camera_color_optical_frame."""
    boxes = Boxes()
    boxes.add((0.0, 0.0, -_CAMERA[2] / 2), _CAMERA, ALUMINIUM)
    boxes.add((0.0, 0.0, 0.001), (0.014, 0.014, 0.002), BLACK)
    return boxes


def moving(geometry: DeltaGeometry, angles: Sequence[float], position: Sequence[float]) -> tuple[Array, Array]:
    """Return arms (3, 2, 3) and rods (6, 2, 3) as lines between their joints, m in charger_base.

    Args:
        geometry: dimensions.
        angles: commanded arm angles, rad.
        position: of end_effector, m in charger_base.
    """
    return np.stack([motors(geometry), elbows(geometry, angles)], axis=1), rods(geometry, angles, position)
