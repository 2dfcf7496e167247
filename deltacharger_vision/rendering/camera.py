# SPDX-License-Identifier: Apache-2.0
"""Simulated RGB-D images of a terminal without graphics hardware: a ray-caster of boxes in numpy."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array, Array32
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.rendering.image_defects import blurred, developed, slow_field
from deltacharger_vision.rendering.materials import brushed
from deltacharger_vision.rendering.parameters import CameraParameters
from deltacharger_vision.rendering.ray_caster import Piece, Rays
from deltacharger_vision.rendering.scene import Box, RenderedScene, check_pose
from deltacharger_vision.rendering.stereo_depth import measured

OAK_D = Intrinsics(640, 400, 441.0, 441.0, 319.5, 199.5)
"""Colour image of an OAK-D at 640 × 400 px, without lens distortion."""
_LARGER_THAN_ANY = 36
"""Bytes per pixel, more than any array of an image needs."""
_LARGEST_KEPT = 31 << 20
"""Bytes; glibc caches nothing larger (its limit is 32 MiB on 64-bit machines)."""


def taken(
    light: Array32,
    depth: tuple[Array32, Array32] | None,
    intrinsics: Intrinsics,
    parameters: CameraParameters,
    unevenness: float,
    random: np.random.Generator,
) -> RgbdImage:
    """Return the image of a camera with the defects of `parameters`.

    Args:
        light: (3, H, W) linear, modified in place.
        depth: (H, W) 1/m, inverse of the true depth, and (H, W) share of holes; None = all depth unknown.
        intrinsics: of the camera.
        parameters: its defects.
        unevenness: relative range of slow changes of the light over the image.
        random: source of all random values.
    """
    p, shape = parameters, (intrinsics.height, intrinsics.width)
    if unevenness:
        light *= slow_field(shape, unevenness, random)
    light = blurred(light, p.defocus, p.motion_x, p.motion_y)
    image = developed(light, p.exposure, p.shot_noise, p.read_noise, random)
    if depth is None:
        return RgbdImage(image, np.full(shape, np.nan, dtype=np.float32), intrinsics)
    return RgbdImage(image, measured(*depth, intrinsics.fx, p, random), intrinsics)


class SimulatedCamera:
    """An RGB-D camera with the defects of `parameters`: colour, and depth of the same pixels.

    Not simulated: cast shadows, light reflected between surfaces, colour filters over the pixels, rolling shutter, and
    stereo matching itself. Depth is the true depth with typical errors of matching.
    """

    def __init__(self, intrinsics: Intrinsics = OAK_D, parameters: CameraParameters | None = None) -> None:
        self.intrinsics = intrinsics
        self.parameters = parameters or CameraParameters()
        self._rays = Rays(intrinsics)
        # Without this allocation, glibc maps large arrays again for each image: 25 ms instead of 14.
        np.empty(min(_LARGER_THAN_ANY * intrinsics.width * intrinsics.height, _LARGEST_KEPT), dtype=np.uint8)

    def render(
        self,
        scene: RenderedScene,
        camera_T_terminal: Array,  # noqa: N803
        random: np.random.Generator,
        color_only: bool = False,
    ) -> RgbdImage:
        """Return one image; the same generator state gives the same image.

        Args:
            scene: in front of the camera.
            camera_T_terminal: (4, 4), from the terminal's frame to the optical frame (x right, y down, z forward).
            random: draws noise, holes and the streaks of metal.
            color_only: leave all depth unknown, without computing it.

        Raises:
            RenderingError: the pose is not a rigid transform.
        """
        check_pose("camera_T_terminal", camera_T_terminal)
        color, inverse, holes = self._painted(scene, np.asarray(camera_T_terminal, dtype=float), random)
        depth = None if color_only else (inverse, holes)
        return taken(color, depth, self.intrinsics, self.parameters, scene.parameters.unevenness, random)

    def _painted(
        self, scene: RenderedScene, pose: Array, random: np.random.Generator
    ) -> tuple[Array32, Array32, Array32]:
        """Return light (3, H, W), 1/z (H, W) 1/m and the share of holes (H, W)."""
        s, p = scene.parameters, self.parameters
        light = pose[:3, :3] @ (np.asarray(scene.light) / np.linalg.norm(scene.light))
        wall = pose[:3, 2]
        inverse = self._rays.linear(wall / (wall @ pose[:3, 3] + s.wall_distance))
        np.clip(inverse, 1e-6, None, out=inverse)
        lit = s.wall * (s.ambient + s.diffuse * max(0.0, float(-wall @ light)))
        color = np.full((3, *self._rays.shape), lit, dtype=np.float32)
        holes = np.full(self._rays.shape, p.hole_matte, dtype=np.float32)
        for box, placed in scene.painted(pose):
            piece = self._rays.cast(placed, box.size, p.edge_width)
            if piece is not None:
                self._paint(scene, box, placed, piece, light, random, color, inverse, holes)
        return color, inverse, holes

    def _paint(
        self,
        scene: RenderedScene,
        box: Box,
        pose: Array,
        piece: Piece,
        light: Array,
        random: np.random.Generator,
        color: Array32,
        inverse: Array32,
        holes: Array32,
    ) -> None:
        s, p = scene.parameters, self.parameters
        before = piece.inverse * np.float32(1.0 + 1e-4) >= inverse[piece.window]
        covered = piece.covered * before
        lambert = np.maximum(piece.normals @ light, 0.0)
        face_light = (s.ambient + s.diffuse * lambert).astype(np.float32)
        gray: Array32 | np.float32 = np.sum(
            [share * lit for share, lit in zip(piece.shares, face_light, strict=True)], axis=0, dtype=np.float32
        )
        solid = covered >= 0.5
        glare = None
        if box.metal:
            gray, glare = brushed(self._rays, box, pose, piece, gray, light, s, random)
        for channel, reflectance in enumerate(box.color):
            target = color[channel][piece.window]
            shade = gray * np.float32(reflectance)
            if glare is not None:
                shade = shade + glare
            target += (shade - target) * covered
        np.copyto(inverse[piece.window], piece.inverse, where=solid)
        share: Array32 | np.float32 = np.float32(p.hole_matte)
        if box.metal:
            share = np.full(covered.shape, p.hole_metal, dtype=np.float32)
            if glare is not None and s.highlight:
                share += np.float32(p.hole_glare - p.hole_metal) * np.clip(glare / np.float32(s.highlight), 0.0, 1.0)
        np.copyto(holes[piece.window], share, where=solid)
