# SPDX-License-Identifier: Apache-2.0
"""The simulated camera's scenes drawn by MuJoCo: a cross-check of geometry and light with OpenGL's rasteriser.

The rasteriser's geom list is refilled for each image, so no MuJoCo model is compiled for a scene. Colour is drawn at
twice the size with four samples per pixel and averaged. 1/z and the box number are taken at the pixel's centre. Depth
is a 32-bit float, 1 at the near plane and 0 at the far one, and so linear in 1/z.
"""

from __future__ import annotations

import math
import os
import sys
import weakref
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Array32, Mask
from deltacharger_vision import errors, images
from deltacharger_vision.rendering.camera import OAK_D, taken
from deltacharger_vision.rendering.ray_caster import Rays, streaks
from deltacharger_vision.rendering.scene import (
    Box,
    CameraParameters,
    RenderedScene,
    SceneParameters,
    shifted,
)

NEAR, FAR = 0.01, 500.0
"""Distance of the clipping planes, m; nearer parts are cut away."""
NONE = -1
"""Box number of a pixel without a box."""
WIDEST = 2.0
"""Largest edge width by averaging, px; the smallest is 1 px, a pixel itself."""
_LARGER = 2
_SAMPLES = 4
_SHADOW_SIDE = 2048  # px of the shadow map
_SHADOW_REACH = 0.3  # m around the middle within which shadows are cast
_LIGHT_AWAY = 1.0  # m; only the shadow map needs a position of a directional light
_GEOMS = 64
_INSTALL = "install libegl1, libegl-mesa0 and libgl1-mesa-dri (Debian, Ubuntu) and set MUJOCO_GL=egl"


class RendererError(errors.VisionError, RuntimeError):
    """A renderer does not work on this machine. Example: MuJoCo without EGL."""


@dataclass(frozen=True)
class Solid:
    """A box to draw.

    Attributes:
        pose: (4, 4) of its centre in the optical frame.
        size: (3,) m.
        color: reflectance of red, green, blue; at most 1 for a light of 1.
        mirror: reflectance of the highlight; at most 1 for a light of 1.
    """

    pose: Array
    size: tuple[float, float, float]
    color: tuple[float, float, float]
    mirror: float = 0.0


@dataclass(frozen=True)
class Lamp:
    """The light of a scene.

    Attributes:
        toward: (3,) unit vector toward the light in the optical frame.
        middle: (3,) m, centre of the shadows.
        ambient: light from everywhere.
        diffuse: light from `toward`.
        sharpness: exponent of the highlight (Blinn, Phong), at most 128.
    """

    toward: Array
    middle: Array
    ambient: float
    diffuse: float
    sharpness: float


class BoxRasteriser:
    """Draws boxes for a pinhole camera. Use it in one thread at a time; `close` releases it.

    Args:
        intrinsics: of the camera; its lens must not distort.

    Raises:
        RendererError: MuJoCo or off-screen OpenGL is missing, or the image is too large.
    """

    def __init__(self, intrinsics: images.Intrinsics) -> None:
        if intrinsics.distortion:
            raise RendererError("MuJoCo draws no lens distortion; give intrinsics without, or use SimulatedCamera")
        self._mujoco, self._context = _imported()
        self._shape = (intrinsics.height, intrinsics.width)
        with ExitStack() as opened:
            self._open(opened)
            self._closing = opened.pop_all()
        self._finalizer = weakref.finalize(self, self._closing.close)
        self._scene = self._sized(_GEOMS)
        self._intrinsics = intrinsics

    def close(self) -> None:
        """Release OpenGL's memory. Idempotent."""
        self._finalizer()

    def draw(
        self, solids: Sequence[Solid], lamp: Lamp, edge_width: float
    ) -> tuple[Array32, Array32, NDArray[np.int32]]:
        """Return light (3, H, W) in 0…1, 1/z (H, W) 1/m and the box number (H, W), NONE without a box.

        Args:
            solids: to draw.
            lamp: light.
            edge_width: px of an edge's ramp, 1…WIDEST.

        Raises:
            RendererError: the renderer is closed.
        """
        if not self._finalizer.alive:
            raise RendererError("the renderer was closed; make a new one")
        if len(solids) > self._scene.maxgeom:
            self._scene = self._sized(2 * len(solids))
        self._fill(solids, lamp)
        with self._gl.as_current():
            large = self._read(self._fine, _LARGER, False)[0]
            ids, depth = self._read(self._plain, 1, True)
        found = ids.astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], dtype=np.int32) + NONE
        inverse = depth * np.float32(1.0 / NEAR - 1.0 / FAR) + np.float32(1.0 / FAR)
        inverse[found == NONE] = 1e-6
        return _averaged(large, edge_width), inverse, found

    def _open(self, opened: ExitStack) -> None:
        """Make the OpenGL context and its two buffers; closing `opened` releases them."""
        height, width = self._shape
        try:
            self._gl = self._context(_LARGER * width, _LARGER * height)
        except Exception as error:  # each backend has its own classes
            raise RendererError(f"no off-screen OpenGL ({error}); {_INSTALL}") from error
        opened.callback(self._gl.free)
        with self._gl.as_current():
            self._fine = self._buffer(opened, _LARGER, _SAMPLES, _SHADOW_SIDE)
            self._plain = self._buffer(opened, 1, 0, 0)

    def _buffer(self, opened: ExitStack, larger: int, samples: int, shadow: int) -> Any:
        mujoco = self._mujoco
        height, width = self._shape
        model = self._model = mujoco.MjSpec().compile()
        model.vis.global_.offwidth, model.vis.global_.offheight = larger * width, larger * height
        model.vis.quality.offsamples, model.vis.quality.shadowsize = samples, shadow
        model.stat.extent, model.vis.map.shadowclip = _SHADOW_REACH, 1.0
        try:
            buffer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except mujoco.FatalError as error:
            size = f"{larger * width} × {larger * height} px"
            raise RendererError(f"no OpenGL buffer of {size} ({error}); take a smaller image, or {_INSTALL}") from error
        opened.callback(_release, self._gl, buffer)
        buffer.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        return buffer

    def _sized(self, geoms: int) -> Any:
        scene, flag = self._mujoco.MjvScene(self._model, maxgeom=geoms), self._mujoco.mjtRndFlag
        for off in (flag.mjRND_REFLECTION, flag.mjRND_SKYBOX, flag.mjRND_HAZE):
            scene.flags[off] = False
        scene.flags[flag.mjRND_SHADOW] = True
        return scene

    def _fill(self, solids: Sequence[Solid], lamp: Lamp) -> None:
        mujoco, scene = self._mujoco, self._scene
        for index, solid in enumerate(solids):
            geom, half = scene.geoms[index], np.asarray(solid.size) / 2
            place, turn, rgba = solid.pose[:3, 3], solid.pose[:3, :3].ravel(), np.array([*solid.color, 1.0], np.float32)
            mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, half, place, turn, rgba)
            geom.segid, geom.category = index, mujoco.mjtCatBit.mjCAT_STATIC
            geom.specular, geom.shininess = solid.mirror, lamp.sharpness / 128.0
        scene.ngeom = len(solids)
        # A shadow removes all light of a lamp, so ambient light is a separate lamp.
        scene.nlight = 2
        for light, ambient, diffuse in ((scene.lights[0], lamp.ambient, 0.0), (scene.lights[1], 0.0, lamp.diffuse)):
            light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
            light.pos, light.dir = lamp.middle + _LIGHT_AWAY * lamp.toward, -lamp.toward
            light.attenuation = (1.0, 0.0, 0.0)
            light.ambient, light.diffuse = (ambient,) * 3, (diffuse,) * 3
            light.specular = (1.0 if diffuse else 0.0,) * 3
            light.castshadow = bool(diffuse)
        self._aim()

    def _aim(self) -> None:
        """Set the camera's frustum: pixel centres are integers, so the image begins half a pixel earlier."""
        of = self._intrinsics
        left, right = ((edge - of.cx) / of.fx * NEAR for edge in (-0.5, of.width - 0.5))
        top, bottom = ((of.cy - edge) / of.fy * NEAR for edge in (-0.5, of.height - 0.5))
        for camera in self._scene.camera:
            camera.pos, camera.forward, camera.up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
            camera.frustum_near, camera.frustum_far = NEAR, FAR
            camera.frustum_top, camera.frustum_bottom = top, bottom
            camera.frustum_center, camera.frustum_width = (left + right) / 2, (right - left) / 2

    def _read(self, buffer: Any, larger: int, numbers: bool) -> tuple[NDArray[np.uint8], Array32]:
        """Draw into a buffer; return colours or encoded box numbers (h, w, 3), and depth (h, w)."""
        mujoco, flag = self._mujoco, self._mujoco.mjtRndFlag
        height, width = larger * self._shape[0], larger * self._shape[1]
        self._scene.flags[flag.mjRND_SEGMENT] = self._scene.flags[flag.mjRND_IDCOLOR] = numbers
        color, area = np.empty((height, width, 3), dtype=np.uint8), mujoco.MjrRect(0, 0, width, height)
        depth = np.empty((height, width) if numbers else (0, 0), dtype=np.float32)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, buffer)  # OpenGL draws to one at a time
        mujoco.mjr_render(area, self._scene, buffer)
        mujoco.mjr_readPixels(color, depth if numbers else None, area, buffer)
        return color[::-1], depth[::-1]


def _imported() -> tuple[Any, Any]:
    """Return MuJoCo and the class of its OpenGL contexts: EGL on Linux, unless MUJOCO_GL states another.

    MuJoCo chooses its class on import. If it was imported earlier, for mechanics alone, it has chosen GLFW, which
    provides no buffers without a display.
    """
    backend = os.environ.setdefault("MUJOCO_GL", "egl") if sys.platform == "linux" else ""
    try:
        import mujoco

        if backend == "egl":
            from mujoco.egl import GLContext

            return mujoco, GLContext
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise RendererError(f"MuJoCo lacks {error.name}; {_INSTALL}") from error
        raise RendererError("MuJoCo is not installed; install deltacharger-lab[sim]") from error
    except Exception as error:  # a missing library may raise anything
        raise RendererError(f"no off-screen OpenGL ({error}); {_INSTALL}") from error
    if not hasattr(mujoco, "GLContext"):
        raise RendererError(f"MuJoCo's OpenGL is switched off (MUJOCO_GL={os.environ.get('MUJOCO_GL')}); {_INSTALL}")
    return mujoco, mujoco.GLContext


def _release(gl: Any, buffer: Any) -> None:
    with gl.as_current():
        buffer.free()


def _averaged(large: NDArray[np.uint8], edge_width: float) -> Array32:
    """Return (3, H, W) in 0…1 of colours (2H, 2W, 3): weighted means of four pixels; the outer weights widen edges.

    Half pixels at ±1/4 px, and with weight `outer` each at ±3/4 px, spread an edge by a variance of 1/12 + outer px²;
    a ramp of width w has w²/12.
    """
    outer = np.float32((np.clip(edge_width, 1.0, WIDEST) ** 2 - 1.0) / 12.0)
    inner = np.float32(0.5) - outer
    halved: NDArray[Any] = large
    for axis in (0, 1):
        wide = np.pad(halved, [(1, 1) if i == axis else (0, 0) for i in range(3)], mode="edge")
        size, kind = halved.shape[axis], np.uint16 if halved.dtype == np.uint8 else np.float32
        part = [wide[(slice(None),) * axis + (slice(start, start + size - 1, 2),)] for start in range(4)]
        halved = inner * np.add(part[1], part[2], dtype=kind) + outer * np.add(part[0], part[3], dtype=kind)
    planes: Array32 = np.multiply(np.moveaxis(halved, 2, 0), np.float32(1.0 / 255.0), order="C")
    return planes


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

    def __init__(self, intrinsics: images.Intrinsics = OAK_D, parameters: CameraParameters | None = None) -> None:
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
    ) -> images.RgbdImage:
        """Return one image; the same generator state gives the same image on one machine.

        Args:
            scene: in front of the camera.
            camera_T_terminal: (4, 4), from the terminal's frame to the optical frame (x right, y down, z forward).
            random: draws noise, holes and the streaks of metal.
            color_only: leave all depth unknown.

        Raises:
            RendererError: the camera is closed.
        """
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
