# SPDX-License-Identifier: Apache-2.0
"""The simulated camera's scenes drawn by MuJoCo: a cross-check of geometry and light with OpenGL's rasteriser."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Array32, Mask
from deltacharger_lab.mujoco.boxes import WIDEST, BoxRasteriser, Lamp, Solid
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.rendering.camera import OAK_D, taken
from deltacharger_vision.rendering.materials import streaks
from deltacharger_vision.rendering.parameters import CameraParameters, SceneParameters
from deltacharger_vision.rendering.ray_caster import Rays
from deltacharger_vision.rendering.scene import Box, RenderedScene, check_pose, shifted

_WALL_SIDE, _WALL_THICKNESS = 100.0, 0.01
_BRIGHTEST = 2.0
"""Range of light in multiples of the camera's saturation; OpenGL has 256 steps for it."""
_LEAST_SCALE = 1e-6


class MujocoCamera:
    """An RGB-D camera with the scenes, parameters and defects of SimulatedCamera, drawn by MuJoCo.

    Differences from the ray-caster: things cast shadows within 0.3 m of the terminal; highlights are round (Blinn,
    Phong) and as wide as the geometric mean of the scene's lobes; light has 256 linear steps; the wall ends at 50 m.
    Holes in glare follow the light beyond what lit metal can have, instead of the highlight's brightness.
    Use it in one thread at a time. `close`, or the end of a `with` block, releases OpenGL's memory.

    Args:
        intrinsics: without lens distortion.
        parameters: the camera's defects.

    Raises:
        RendererError: MuJoCo or off-screen OpenGL is missing; the lens distorts; the image is too large.
    """

    def __init__(self, intrinsics: Intrinsics = OAK_D, parameters: CameraParameters | None = None) -> None:
        self.intrinsics = intrinsics
        self.parameters = parameters or CameraParameters()
        self._rasteriser = BoxRasteriser(intrinsics)
        self._rays = Rays(intrinsics)

    def __enter__(self) -> MujocoCamera:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Release OpenGL's memory. Idempotent."""
        self._rasteriser.close()

    def render(
        self,
        scene: RenderedScene,
        camera_T_terminal: Array,  # noqa: N803
        random: np.random.Generator,
        color_only: bool = False,
    ) -> RgbdImage:
        """Return one image; the same generator state gives the same image on one machine.

        Args:
            scene: in front of the camera.
            camera_T_terminal: (4, 4), from the terminal's frame to the optical frame (x right, y down, z forward).
            random: draws noise, holes and the streaks of metal.
            color_only: leave all depth unknown.

        Raises:
            RenderingError: the pose is not a rigid transform.
            RendererError: the camera is closed.
        """
        check_pose("camera_T_terminal", camera_T_terminal)
        pose, p = np.asarray(camera_T_terminal, dtype=float), self.parameters
        boxes = [(_wall(scene.parameters), pose @ _wall(scene.parameters).pose), *scene.painted(pose)]
        light, inverse, number = self._drawn(scene, pose, boxes)
        holes = np.full(number.shape, p.hole_matte, dtype=np.float32)
        for index, (box, placed) in enumerate(boxes):
            if box.metal and (window := _window(number == index)):
                self._spoil(scene.parameters, box, placed, light, inverse, holes, number == index, window, random)
        # The blur provides edge width beyond the range of averaging.
        blur = math.sqrt(max(0.0, p.edge_width**2 - WIDEST**2) / 12.0)
        depth = None if color_only else (inverse, holes)
        blurred = replace(p, defocus=min(math.hypot(p.defocus, blur), 20.0)) if blur else p
        return taken(light, depth, self.intrinsics, blurred, scene.parameters.unevenness, random)

    def _drawn(
        self, scene: RenderedScene, pose: Array, boxes: list[tuple[Box, Array]]
    ) -> tuple[Array32, Array32, NDArray[np.int32]]:
        """Return light (3, H, W), 1/z (H, W) 1/m and box numbers (H, W)."""
        s = scene.parameters
        full = max(_LEAST_SCALE, min(_brightest(s, (box for box, _ in boxes)), _BRIGHTEST / self.parameters.exposure))
        lamp = Lamp(
            toward=pose[:3, :3] @ (np.asarray(scene.light) / np.linalg.norm(scene.light)),
            middle=pose[:3, 3],
            ambient=s.ambient / full,
            diffuse=s.diffuse / full,
            sharpness=min(128.0, 2.0 / (s.lobe_along * s.lobe_across)),
        )
        solids = [Solid(placed, box.size, box.color, s.highlight / full if box.metal else 0.0) for box, placed in boxes]
        light, inverse, number = self._rasteriser.draw(solids, lamp, self.parameters.edge_width)
        light *= np.float32(full)
        return light, inverse, number

    def _spoil(
        self,
        parameters: SceneParameters,
        box: Box,
        pose: Array,
        light: Array32,
        inverse: Array32,
        holes: Array32,
        whole: Mask,
        window: tuple[slice, slice],
        random: np.random.Generator,
    ) -> None:
        """Draw streaks into the light (3, H, W) of metal, and its share of holes (H, W)."""
        p, s = self.parameters, parameters
        mask = whole[window]
        share = np.full(mask.shape, p.hole_metal, dtype=np.float32)
        if s.highlight:
            lit = np.float32(box.color[1] * (s.ambient + s.diffuse))
            glare = np.clip((light[1][window] - lit) / np.float32(s.highlight), 0.0, 1.0)
            share += np.float32(p.hole_glare - p.hole_metal) * glare
        np.copyto(holes[window], share, where=mask)
        if s.streaks or s.mirrored:
            along = tuple(self._rays.linear(axis, window) for axis in pose[:3, :3].T)
            factor = streaks(box, pose, inverse[window], along, s, random)
            for plane in light:
                np.multiply(plane[window], factor, out=plane[window], where=mask)


def _wall(parameters: SceneParameters) -> Box:
    centre = (0.0, 0.0, parameters.wall_distance + _WALL_THICKNESS / 2)
    return Box(shifted(centre), (_WALL_SIDE, _WALL_SIDE, _WALL_THICKNESS), (parameters.wall,) * 3)


def _brightest(parameters: SceneParameters, boxes: Iterable[Box]) -> float:
    """Return the largest light that any of the boxes can reflect."""
    lit, highlight = parameters.ambient + parameters.diffuse, parameters.highlight
    return max(lit * max(box.color) + (highlight if box.metal else 0.0) for box in boxes)


def _window(mask: Mask) -> tuple[slice, slice] | None:
    """Return the rows and columns of a mask (H, W); None if it is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
