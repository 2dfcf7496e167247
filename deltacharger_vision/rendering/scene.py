# SPDX-License-Identifier: Apache-2.0
"""The simulated camera's scene: a terminal on its plate, a wall, and boxes; its and the camera's parameters."""

from __future__ import annotations

from collections.abc import Iterator
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
