# SPDX-License-Identifier: Apache-2.0
"""What is drawn of a charger, independent of drawing libraries: joints, boxes and lines, pads as pictures.

Positions are in charger_base unless a docstring names another frame. Dimensions that kinematics does not use are as in
urdf/deltacharger.urdf.xacro; the paper gives no drawing. Colours are red, green, blue, 0 to 255.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core import arrays, machine
from deltacharger_kinematics.geometry import LIMB_COUNT, LIMB_DIRECTIONS, DeltaGeometry, Limb
from deltacharger_vision.terminal import Terminal

Color = tuple[int, int, int]
Picture = NDArray[np.uint8]

ROD_SPACING = 0.040
"""Distance of a limb's two rods, m (assumed; kinematics does not use it)."""
SIDES = (("left", 0.5), ("right", -0.5))
"""The rods of a limb: name, and position along its tangent in units of ROD_SPACING."""

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

FULL = 9.0
"""Force on a taxel at the end of the scale, N: the range of the published sensor."""
NOISE = 0.25
"""Smaller forces (N) are shown as 0, as for the estimator; else the noise of free air would be transmitted."""
DEAD = (148, 154, 160)
"""Colour of a dead taxel."""
_SHADES = 90  # steps of 0.1 N
_ANCHORS = (  # closer at small forces: a docked pad carries about 2 N on its strongest taxel
    (0.00, (18, 20, 26)),
    (0.05, (46, 24, 92)),
    (0.13, (142, 36, 130)),
    (0.24, (229, 80, 82)),
    (0.50, (252, 165, 74)),
    (1.00, (252, 248, 196)),
)


def motors(geometry: DeltaGeometry) -> arrays.Array:
    """Return the centres of the motor axes (3 limbs, 3) m in charger_base."""
    limbs = [geometry.limb(index) for index in range(LIMB_COUNT)]
    return np.array(
        [
            _around(limb, limb.base_radius + limb.radius_offset, limb.tangential_offset, -limb.motor_height)
            for limb in limbs
        ]
    )


def elbows(geometry: DeltaGeometry, angles: Sequence[float]) -> arrays.Array:
    """Return the centres of the elbow axes (3 limbs, 3) m in charger_base.

    Args:
        geometry: dimensions.
        angles: commanded arm angles, rad.
    """
    found = motors(geometry)
    for index, angle in enumerate(angles):
        limb = geometry.limb(index)
        true = angle + limb.angle_offset
        found[index] += _around(limb, limb.arm * math.cos(true), 0.0, limb.arm * math.sin(true))
    return found


def feet(geometry: DeltaGeometry) -> arrays.Array:
    """Return the centres of the platform's joint axes (3 limbs, 3) m in end_effector."""
    limbs = [geometry.limb(index) for index in range(LIMB_COUNT)]
    return np.array([_around(limb, limb.platform_radius, 0.0, 0.0) for limb in limbs])


def rods(geometry: DeltaGeometry, angles: Sequence[float], position: Sequence[float]) -> arrays.Array:
    """Return both ends, elbow first, of the six rods (6, 2, 3) m in charger_base, limb by limb, left before right.

    Args:
        geometry: dimensions.
        angles: commanded arm angles, rad.
        position: of end_effector, m in charger_base.
    """
    begin, end = elbows(geometry, angles), feet(geometry) + np.asarray(position, dtype=float)
    found = []
    for index in range(LIMB_COUNT):
        for _, share in SIDES:
            aside = _around(geometry.limb(index), 0.0, share * ROD_SPACING, 0.0)
            found.append((begin[index] + aside, end[index] + aside))
    return np.array(found)


def _around(limb: Limb, radial: float, tangential: float, height: float) -> arrays.Array:
    cosine, sine = limb.cosine, limb.sine
    return np.array([radial * cosine - tangential * sine, radial * sine + tangential * cosine, height])


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


def ring(geometry: DeltaGeometry) -> arrays.Array:
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
        boxes.add((side * machine.PAD_DISTANCE, 0.0, -_PAD[2] / 2), _PAD, PAD)
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


def moving(
    geometry: DeltaGeometry, angles: Sequence[float], position: Sequence[float]
) -> tuple[arrays.Array, arrays.Array]:
    """Return arms (3, 2, 3) and rods (6, 2, 3) as lines between their joints, m in charger_base.

    Args:
        geometry: dimensions.
        angles: commanded arm angles, rad.
        position: of end_effector, m in charger_base.
    """
    return np.stack([motors(geometry), elbows(geometry, angles)], axis=1), rods(geometry, angles, position)


def _scale() -> Picture:
    places, colours = zip(*_ANCHORS, strict=True)
    shares = np.linspace(0.0, 1.0, _SHADES + 1)
    channels = [np.interp(shares, places, [colour[each] for colour in colours]) for each in range(3)]
    return np.round(np.stack(channels, axis=1)).astype(np.uint8)


_SCALE = _scale()


def pad_picture(forces: ArrayLike, rows: int, columns: int) -> Picture:
    """Return one pad (rows, columns, 3) as seen along +z at the target: +x to the left, +y up.

    Args:
        forces: (rows · columns,) N, row-major, row 0 at +y, column 0 at +x; NaN = dead taxel.
        rows: of taxels.
        columns: of taxels.

    Raises:
        ValueError: the number of forces differs from rows · columns.
    """
    values = np.asarray(forces, dtype=np.float64).reshape(rows, columns)
    dead = np.isnan(values)
    shown = np.where(values >= NOISE, np.minimum(values, FULL), 0.0)
    shade = np.rint(shown * (_SHADES / FULL)).astype(np.intp)
    picture = _SCALE[shade]
    picture[dead] = DEAD
    return picture
