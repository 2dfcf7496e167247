# SPDX-License-Identifier: Apache-2.0
"""The simulated camera's scene: a terminal on its plate, a wall, and boxes; random scenes; the camera's parameters."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_vision.terminal import Terminal, transform


@dataclass(frozen=True)
class CameraParameters:
    """Effects of sensor, lens and stereo matching, like an OAK-D at 640 × 400 px."""

    exposure: float = 1.0  # ratio, factor on the light; above about 1.5 bare metal saturates
    shot_noise: float = 0.01  # standard deviation at full scale; below, by its root (assumed)
    read_noise: float = 0.002  # standard deviation in the dark, of full scale (assumed)
    edge_width: float = 1.4  # px, ramp of an edge by pixel and lens (assumed)
    defocus: float = 0.0  # px, standard deviation of a further Gaussian blur
    motion_x: float = 0.0  # px, movement of the image to the right during exposure
    motion_y: float = 0.0  # px, movement of the image down during exposure
    baseline: float = 0.075  # m, between the stereo cameras, with colour in the middle (OAK-D)
    stereo_focal: float = 441.0  # px, focal length of the stereo cameras (OAK-D at 400P)
    disparities: float = 190.0  # px, largest disparity, so depth starts at 174 mm (extended)
    disparity_noise: float = 0.15  # px, standard deviation of the disparity (assumed)
    noise_width: int = 5  # px, side of the squares with equal noise (assumed)
    disparity_step: float = 0.125  # px, resolution, 1/8 or 1/32 (OAK-D); 0 = continuous
    fattening: int = 2  # px, how far near depth spreads over its surroundings (assumed)
    fattening_step: float = 1.0  # px, least step of disparity that spreads (assumed)
    hole_metal: float = 0.2  # ratio, share of bare metal without depth (assumed)
    hole_glare: float = 0.9  # ratio, share of metal in full glare without depth (assumed)
    hole_matte: float = 0.005  # ratio, share of all else without depth (assumed)
    hole_width: int = 8  # px, size of a hole (assumed)
    farthest: float = 10.0  # m, no depth beyond
    occlusion: bool = True  # no depth where only one of the stereo cameras sees
    whole_millimetres: bool = True  # depth in steps of 1 mm, as in 16UC1


@dataclass(frozen=True)
class SceneParameters:
    """Plate, materials and light; reflectances and light are linear, 1 = full scale at exposure 1. All assumed."""

    plate_width: float = 0.200  # m, of the dark plate along x
    plate_height: float = 0.120  # m, of the dark plate along y
    plate_thickness: float = 0.005  # m, of the dark plate along z
    plate: float = 0.06  # reflectance of the plate
    metal: float = 0.65  # reflectance of bare metal without its highlight
    highlight: float = 0.9  # brightness of the light's reflection in metal
    lobe_along: float = 0.10  # width of the highlight along the brushing (x), as a slope
    lobe_across: float = 0.70  # width of the highlight across the brushing
    streaks: float = 0.06  # relative standard deviation of the brushing's streaks
    mirrored: float = 0.05  # relative standard deviation of mirrored surroundings along x
    ambient: float = 0.45  # light from everywhere
    diffuse: float = 0.60  # light from one direction
    unevenness: float = 0.10  # relative range of slow changes of the light over the image
    wall: float = 0.30  # reflectance of the wall behind
    wall_distance: float = 0.8  # m, of the wall behind the touched faces, parallel to them


Color = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Box:
    """A box of one material.

    Attributes:
        pose: (4, 4) from the box's frame (origin at its centre) to the terminal's, or to the camera's with `in_camera`.
        size: (3,) m along its x, y, z.
        color: reflectance of red, green, blue, linear, 0 to 1.
        metal: whether it mirrors the light, brushed along its x.
        in_camera: whether it moves with the camera, like the charger's own parts.
    """

    pose: Array
    size: tuple[float, float, float]
    color: Color
    metal: bool = False
    in_camera: bool = False


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """A terminal and its surroundings.

    Attributes:
        terminal: geometry of the bars.
        parameters: plate, materials, light.
        light: direction toward the light in the terminal's frame, of any length; −z is the camera's side.
        background: boxes behind the plate.
        foreground: boxes in front of it.
        target: False omits plate and bars.
    """

    terminal: Terminal = field(default_factory=Terminal)
    parameters: SceneParameters = field(default_factory=SceneParameters)
    light: tuple[float, float, float] = (0.4, 0.7, -0.8)
    background: tuple[Box, ...] = ()
    foreground: tuple[Box, ...] = ()
    target: bool = True

    def plate(self) -> Box:
        """Return the dark plate."""
        p = self.parameters
        centre = (0.0, 0.0, self.terminal.bar_thickness + p.plate_thickness / 2)
        return Box(shifted(centre), (p.plate_width, p.plate_height, p.plate_thickness), (p.plate,) * 3)

    def bars(self) -> tuple[Box, Box]:
        """Return the upper and the lower bar."""
        t, metal = self.terminal, self.parameters.metal
        size = (t.bar_length, t.bar_height, t.bar_thickness)
        # Duralumin is a little bluer than white.
        color = (0.97 * metal, 0.99 * metal, metal)
        upper, lower = (shifted((0.0, sign * t.spacing / 2, t.bar_thickness / 2)) for sign in (1, -1))
        return Box(upper, size, color, metal=True), Box(lower, size, color, metal=True)

    def painted(self, camera_T_terminal: Array) -> Iterator[tuple[Box, Array]]:  # noqa: N803
        """Yield every box with its (4, 4) pose in the optical frame, back to front by centres."""
        groups = [self._placed(self.background, camera_T_terminal)]
        if self.target:
            groups += [self._placed((self.plate(),), camera_T_terminal), self._placed(self.bars(), camera_T_terminal)]
        groups.append(self._placed(self.foreground, camera_T_terminal))
        for group in groups:
            yield from sorted(group, key=lambda item: -float(np.linalg.norm(item[1][:3, 3])))

    @staticmethod
    def _placed(boxes: tuple[Box, ...], pose: Array) -> list[tuple[Box, Array]]:
        return [(box, box.pose if box.in_camera else pose @ box.pose) for box in boxes]


def shifted(position: tuple[float, float, float]) -> Array:
    """Return the (4, 4) translation by `position` m."""
    return transform(np.eye(3), position)


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
