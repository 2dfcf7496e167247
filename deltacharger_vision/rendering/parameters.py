# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulated camera and its scenes; values without a source are assumed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, flag, number


@dataclass(frozen=True)
class CameraParameters(Bounded):
    """Effects of sensor, lens and stereo matching, like an OAK-D at 640 × 400 px.

    Raises:
        ParameterError: a value is out of bounds.
    """

    exposure: float = number(1.0, 0.02, 50.0, "ratio", "factor on the light; above about 1.5 bare metal saturates")
    shot_noise: float = number(0.01, 0.0, 0.2, "", "standard deviation at full scale; below, by its root (assumed)")
    read_noise: float = number(0.002, 0.0, 0.1, "", "standard deviation in the dark, of full scale (assumed)")
    edge_width: float = number(1.4, 0.5, 10.0, "px", "ramp of an edge by pixel and lens (assumed)")
    defocus: float = number(0.0, 0.0, 20.0, "px", "standard deviation of a further Gaussian blur")
    motion_x: float = number(0.0, -50.0, 50.0, "px", "movement of the image to the right during exposure")
    motion_y: float = number(0.0, -50.0, 50.0, "px", "movement of the image down during exposure")
    baseline: float = number(0.075, 0.005, 1.0, "m", "between the stereo cameras, with colour in the middle (OAK-D)")
    stereo_focal: float = number(441.0, 10.0, 1e4, "px", "focal length of the stereo cameras (OAK-D at 400P)")
    disparities: float = number(190.0, 1.0, 1e4, "px", "largest disparity, so depth starts at 174 mm (extended)")
    disparity_noise: float = number(0.15, 0.0, 5.0, "px", "standard deviation of the disparity (assumed)")
    noise_width: int = number(5, 1, 31, "px", "side of the squares with equal noise (assumed)")
    disparity_step: float = number(0.125, 0.0, 1.0, "px", "resolution, 1/8 or 1/32 (OAK-D); 0 = continuous")
    fattening: int = number(2, 0, 10, "px", "how far near depth spreads over its surroundings (assumed)")
    fattening_step: float = number(1.0, 0.01, 100.0, "px", "least step of disparity that spreads (assumed)")
    hole_metal: float = number(0.2, 0.0, 1.0, "ratio", "share of bare metal without depth (assumed)")
    hole_glare: float = number(0.9, 0.0, 1.0, "ratio", "share of metal in full glare without depth (assumed)")
    hole_matte: float = number(0.005, 0.0, 1.0, "ratio", "share of all else without depth (assumed)")
    hole_width: int = number(8, 2, 64, "px", "size of a hole (assumed)")
    farthest: float = number(10.0, 0.1, 65.0, "m", "no depth beyond")
    occlusion: bool = flag(True, "no depth where only one of the stereo cameras sees")
    whole_millimetres: bool = flag(True, "depth in steps of 1 mm, as in 16UC1")

    @property
    def nearest(self) -> float:
        """Smallest depth, m."""
        return self.stereo_focal * self.baseline / self.disparities

    @staticmethod
    def ideal() -> CameraParameters:
        """Return a camera without noise, blur and holes, and with continuous depth from `nearest` on."""
        return CameraParameters(
            shot_noise=0.0,
            read_noise=0.0,
            edge_width=1.0,
            disparity_noise=0.0,
            disparity_step=0.0,
            fattening=0,
            hole_metal=0.0,
            hole_glare=0.0,
            hole_matte=0.0,
            occlusion=False,
            whole_millimetres=False,
        )


@dataclass(frozen=True)
class SceneParameters(Bounded):
    """Plate, materials and light; reflectances and light are linear, 1 = full scale at exposure 1. All assumed.

    Raises:
        ParameterError: a value is out of bounds.
    """

    plate_width: float = number(0.200, 0.01, 2.0, "m", "of the dark plate along x")
    plate_height: float = number(0.120, 0.01, 2.0, "m", "of the dark plate along y")
    plate_thickness: float = number(0.005, 0.0, 0.5, "m", "of the dark plate along z")
    plate: float = number(0.06, 0.0, 1.0, "", "reflectance of the plate")
    metal: float = number(0.65, 0.0, 1.0, "", "reflectance of bare metal without its highlight")
    highlight: float = number(0.9, 0.0, 20.0, "", "brightness of the light's reflection in metal")
    lobe_along: float = number(0.10, 0.01, 2.0, "", "width of the highlight along the brushing (x), as a slope")
    lobe_across: float = number(0.70, 0.01, 2.0, "", "width of the highlight across the brushing")
    streaks: float = number(0.06, 0.0, 1.0, "", "relative standard deviation of the brushing's streaks")
    mirrored: float = number(0.05, 0.0, 1.0, "", "relative standard deviation of mirrored surroundings along x")
    ambient: float = number(0.45, 0.0, 10.0, "", "light from everywhere")
    diffuse: float = number(0.60, 0.0, 10.0, "", "light from one direction")
    unevenness: float = number(0.10, 0.0, 0.9, "", "relative range of slow changes of the light over the image")
    wall: float = number(0.30, 0.0, 1.0, "", "reflectance of the wall behind")
    wall_distance: float = number(0.8, 0.01, 100.0, "m", "of the wall behind the touched faces, parallel to them")

    @staticmethod
    def even() -> SceneParameters:
        """Return a scene of uniform surfaces: no highlight, streaks, reflections or changes of the light."""
        return dataclasses.replace(SceneParameters(), highlight=0.0, streaks=0.0, mirrored=0.0, unevenness=0.0)
