# SPDX-License-Identifier: Apache-2.0
"""Simulated RGB-D images without graphics hardware: a ray-caster of boxes, image defects, stereo depth."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Array32, Mask
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.rendering.ray_caster import Piece, Rays, brushed
from deltacharger_vision.rendering.scene import Box, CameraParameters, RenderedScene

_LEVELS = 4096
_KNOTS = (6, 9)


def developed(
    light: Array32, exposure: float, shot_noise: float, read_noise: float, random: np.random.Generator
) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 sRGB of light (3, H, W): exposed, with noise, saturated at 1. Modifies `light`.

    The noise's variance is read_noise² + shot_noise² · light, relative to full scale.
    """
    image = np.empty((*light.shape[1:], 3), dtype=np.uint8)
    encoding, spread = _encoding(), np.empty_like(light[0])
    # One colour at a time, so that arrays stay in the processor's cache.
    for channel, plane in enumerate(light):
        if exposure != 1.0:
            plane *= np.float32(exposure)
        if shot_noise or read_noise:
            np.clip(plane, 0.0, 1.0, out=spread)
            spread *= np.float32(shot_noise**2)
            spread += np.float32(read_noise**2)
            np.sqrt(spread, out=spread)
            spread *= white(plane.shape, random)
            plane += spread
        plane *= np.float32(_LEVELS - 1)
        plane += np.float32(0.5)
        np.clip(plane, 0, _LEVELS - 1, out=plane)
        image[:, :, channel] = encoding[plane.astype(np.uint16)]
    return image


@cache
def _encoding() -> NDArray[np.uint8]:
    """sRGB (IEC 61966-2-1) of light 0…1 in `_LEVELS` steps."""
    light = np.arange(_LEVELS) / (_LEVELS - 1)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * encoded), dtype=np.uint8)


def blurred(light: Array32, defocus: float, motion_x: float, motion_y: float) -> Array32:
    """Return light (3, H, W) blurred by a Gaussian of `defocus` px and a straight movement (px)."""
    if not defocus and not motion_x and not motion_y:
        return light
    margin = math.ceil(3 * defocus + max(abs(motion_x), abs(motion_y))) + 1
    wide = np.pad(light, ((0, 0), (margin, margin), (margin, margin)), mode="edge")
    down = np.fft.fftfreq(wide.shape[1])[:, None]
    across = np.fft.rfftfreq(wide.shape[2])[None, :]
    transfer = np.exp(-2 * (np.pi * defocus) ** 2 * (across**2 + down**2)) * np.sinc(
        motion_x * across + motion_y * down
    )
    found = np.fft.irfft2(np.fft.rfft2(wide) * transfer.astype(np.float32), s=wide.shape[1:])
    return np.maximum(found[:, margin:-margin, margin:-margin], 0.0).astype(np.float32)


def white(shape: tuple[int, ...], random: np.random.Generator) -> Array32:
    """Return independent noise (shape) of mean 0 and variance 1.

    Each value is a sum of four uniform numbers: normal up to 3.4 standard deviations, in less than half the time.
    """
    count = math.prod(shape)
    words = random.integers(0, 2**64, size=count, dtype=np.uint64).view(np.uint16).reshape(4, count)
    found: Array32 = words[0].astype(np.float32)
    for part in words[1:]:
        found += part
    found -= np.float32(4 * 32767.5)
    found *= np.float32(1.0 / math.sqrt(4 * (65536**2 - 1) / 12))
    return np.asarray(found.reshape(shape))


def slow_field(shape: tuple[int, int], spread: float, random: np.random.Generator) -> Array32:
    """Return (H, W) slowly varying factors 1 ± spread."""
    knots = random.uniform(1.0 - spread, 1.0 + spread, _KNOTS)
    down, across = (_hats(count, size) for count, size in zip(_KNOTS, shape, strict=True))
    return np.asarray(down @ knots.astype(np.float32) @ across.T, dtype=np.float32)


def _hats(count: int, size: int) -> Array32:
    """Return (size, count) weights of linear interpolation between `count` knots."""
    place = np.linspace(0.0, count - 1.0, size)[:, None]
    return np.maximum(0.0, 1.0 - np.abs(place - np.arange(count))).astype(np.float32)


_LOGISTIC = 1.702
"""1 / (1 + exp(−1.702 x)) is the normal distribution within 0.01."""
_TOLERANCE = 0.5
"""Distance in front of a pixel, as disparity, from which something hides it, px."""


def measured(
    inverse: Array32, holes: Array32, focal: float, parameters: CameraParameters, random: np.random.Generator
) -> Array32:
    """Return depth (H, W) m, NaN = unknown.

    Args:
        inverse: (H, W) 1/m, one over the true depth.
        holes: (H, W) share of holes.
        focal: px of this image along x.
        parameters: of the camera.
        random: draws noise and holes.
    """
    p = parameters
    per_inverse = p.stereo_focal * p.baseline
    disparity = inverse * np.float32(per_inverse)
    unknown = disparity > p.disparities
    if p.occlusion:
        unknown |= _hidden(inverse, focal * p.baseline)
    if p.fattening:
        disparity = _fattened(disparity, p.fattening, p.fattening_step)
    if p.disparity_noise:
        disparity += np.float32(p.disparity_noise) * blotches(disparity.shape, p.noise_width, random)
    if p.disparity_step:
        disparity *= np.float32(1.0 / p.disparity_step)
        np.rint(disparity, out=disparity)
        disparity *= np.float32(p.disparity_step)
    unknown |= ~((disparity <= p.disparities) & (disparity >= per_inverse / p.farthest))
    if p.hole_metal or p.hole_glare or p.hole_matte:
        unknown |= _holes(holes, p.hole_width, random)
    np.maximum(disparity, np.float32(1e-6), out=disparity)
    depth = np.float32(per_inverse) / disparity
    if p.whole_millimetres:
        depth = np.rint(depth * np.float32(1e3)) * np.float32(1e-3)
    depth[unknown] = np.nan
    return depth


def blotches(shape: tuple[int, ...], width: int, random: np.random.Generator) -> Array32:
    """Return normal noise (H, W) of variance 1, correlated over `width` px: white noise averaged over squares."""
    rows, columns = shape
    single = white((rows + width - 1, columns + width - 1), random)
    down = single[:rows].copy()
    for shift in range(1, width):
        down += single[shift : shift + rows]
    found = down[:, :columns].copy()
    for shift in range(1, width):
        found += down[:, shift : shift + columns]
    found *= np.float32(1.0 / width)
    return found


def _hidden(inverse: Array32, per_inverse: float) -> Mask:
    """Return the pixels that one of the two cameras, half a baseline on either side of this image, cannot see.

    The right camera sees column x at x − d/2. Something further right hides x if it appears left of that place; for the
    left camera, the reverse. Pixels outside a camera's image are also invisible.
    """
    columns = np.arange(inverse.shape[1], dtype=np.float32)
    half = inverse * np.float32(0.5 * per_inverse)
    right, left = columns - half, columns + half
    nearest = np.minimum.accumulate(right[:, ::-1], axis=1)[:, ::-1]
    farthest = np.maximum.accumulate(left, axis=1)
    hidden = (right > nearest + np.float32(_TOLERANCE)) | (left < farthest - np.float32(_TOLERANCE))
    last = inverse.shape[1] - 1
    return np.asarray(hidden | (right < -_TOLERANCE) | (left > last + _TOLERANCE))


def _fattened(disparity: Array32, reach: int, step: float) -> Array32:
    """Return disparity with near parts spread by `reach` px over parts farther by more than `step` px."""
    largest = disparity
    for axis in (0, 1):
        padded = np.pad(largest, [(reach, reach) if i == axis else (0, 0) for i in (0, 1)], mode="edge")
        largest = largest.copy()
        size = disparity.shape[axis]
        for shift in range(2 * reach + 1):
            part = padded[shift : shift + size] if axis == 0 else padded[:, shift : shift + size]
            np.maximum(largest, part, out=largest)
    return np.where(largest - disparity > np.float32(step), largest, disparity)


def _holes(share: Array32, width: int, random: np.random.Generator) -> Mask:
    """Return blobs of about `width` px that cover the given share (H, W), drawn at half the resolution."""
    rows, columns = share.shape
    coarse = blotches(((rows + 1) // 2, (columns + 1) // 2), max(1, width // 2), random)
    even = 1.0 / (1.0 + np.exp(np.float32(-_LOGISTIC) * coarse))
    fine = np.repeat(np.repeat(even, 2, axis=0), 2, axis=1)[:rows, :columns]
    return np.asarray(fine < share)


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
        """
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
