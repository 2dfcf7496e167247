# SPDX-License-Identifier: Apache-2.0
"""Random scenes for a simulated camera, and the charger's own parts before it. The ranges are assumed.

Frames: the terminal's (x along the bars, y up, z into the plate) and `charger_base` (+z toward the target, +y up, +x to
the left when looking along +z).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_vision.rendering.scene import Box, Color, RenderedScene, SceneParameters, shifted
from deltacharger_vision.terminal import Terminal, transform

Random = np.random.Generator

REACH = 0.45
"""Largest |x| and |y| of things around a random terminal, m."""
DARK: Color = (0.05, 0.05, 0.055)
_BASE_RADIUS, _ARM, _Z_OFFSET, _PLATFORM_RADIUS = 0.055, 0.100, 0.095, 0.050
"""Dimensions of the delta, m: the kinematics' defaults."""
_PLATFORM = (0.125, 0.045, 0.020)
"""Outline of the platform, m (assumed)."""


def draw_scene(random: Random, clutter: int = 0, target: bool = True) -> RenderedScene:
    """Return a scene with random light, materials, wall, panel behind the plate and surroundings.

    Args:
        random: source of all random values.
        clutter: number of boxes around.
        target: False omits plate and bars.
    """
    terminal = Terminal()
    parameters = dataclasses.replace(
        SceneParameters(),
        plate=random.uniform(0.03, 0.12),
        metal=random.uniform(0.5, 0.75),
        highlight=random.uniform(0.2, 1.5),
        streaks=random.uniform(0.02, 0.12),
        mirrored=random.uniform(0.0, 0.2),
        ambient=random.uniform(0.35, 0.55),
        diffuse=random.uniform(0.2, 0.7),
        wall=random.uniform(0.08, 0.6),
        wall_distance=random.uniform(0.4, 2.5),
    )
    light = (random.uniform(-1.0, 1.0), random.uniform(0.1, 1.0), random.uniform(-1.0, -0.2))
    background: list[Box] = [_panel(random, terminal, parameters)] if target and random.random() < 0.5 else []
    behind = terminal.bar_thickness + parameters.plate_thickness + 0.01
    background += [_clutter(random, behind, parameters.wall_distance) for _ in range(clutter)]
    return RenderedScene(terminal, parameters, light, tuple(background), target=target)


def charger_parts(
    charger_base_T_camera: Array,  # noqa: N803
    platform: tuple[float, float, float],
    arm_angles: Sequence[float] = (0.5, 0.5, 0.5),
) -> list[Box]:
    """Return the charger's platform, arms and rods as dark boxes that move with the camera.

    Args:
        charger_base_T_camera: (4, 4).
        platform: (3,) m in charger_base, centre of the platform's front.
        arm_angles: of the three arms, from radially outward toward +z, rad.
    """
    to_camera = np.linalg.inv(charger_base_T_camera)
    boxes = [Box(shifted((platform[0], platform[1], platform[2] - 0.01)), _PLATFORM, DARK)]
    for azimuth, angle in zip(np.radians((0.0, 120.0, 240.0)), arm_angles, strict=True):
        outward = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        motor = _BASE_RADIUS * outward + (0.0, 0.0, -_Z_OFFSET)
        elbow = motor + _ARM * (math.cos(angle) * outward + (0.0, 0.0, math.sin(angle)))
        joint = np.asarray(platform) + _PLATFORM_RADIUS * outward
        boxes += [_stick(motor, elbow, 0.018), _stick(elbow, joint, 0.008)]
    return [dataclasses.replace(box, pose=to_camera @ box.pose, in_camera=True) for box in boxes]


def _stick(start: Array, end: Array, width: float) -> Box:
    """Return a square bar from start to end (m)."""
    along = end - start
    length = float(np.linalg.norm(along))
    x = along / length
    y = np.cross(x, (0.0, 0.0, 1.0) if abs(x[2]) < 0.9 else (1.0, 0.0, 0.0))
    y /= np.linalg.norm(y)
    pose = transform(np.column_stack([x, y, np.cross(x, y)]), (start + end) / 2)
    return Box(pose, (length, width, width), DARK)


def place_behind(random: Random, near: float, far: float) -> Array:
    """Return a random (4, 4) pose behind the plate, turned mainly about z."""
    z = random.uniform(near, max(near, far))
    pose = shifted((random.uniform(-REACH, REACH), random.uniform(-REACH, REACH), z))
    pose[:3, :3] = _turn(2, random.uniform(-math.pi, math.pi)) @ _turn(0, random.normal(0.0, 0.3))
    return pose


def _turn(axis: int, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    found = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    found[i, i], found[i, j], found[j, i], found[j, j] = c, -s, s, c
    return found


def _panel(random: Random, terminal: Terminal, parameters: SceneParameters) -> Box:
    """Return the front panel of the robot that carries the plate."""
    depth = min(0.2, max(0.01, parameters.wall_distance - 0.1))
    z = terminal.bar_thickness + parameters.plate_thickness + depth / 2
    size = (random.uniform(0.25, 0.6), random.uniform(0.2, 0.5), depth)
    return Box(shifted((random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05), z)), size, _tint(random, 0.03, 0.7))


def _clutter(random: Random, near: float, far: float) -> Box:
    size = tuple(random.uniform(0.02, 0.25, 3))
    return Box(place_behind(random, near + size[2] / 2, far), (size[0], size[1], size[2]), _tint(random, 0.02, 0.8))


def _tint(random: Random, low: float, high: float) -> Color:
    red, green, blue = np.clip(random.uniform(low, high) * random.uniform(0.6, 1.4, 3), 0.0, 1.0)
    return float(red), float(green), float(blue)
