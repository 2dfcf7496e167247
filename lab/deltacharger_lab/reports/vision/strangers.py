# SPDX-License-Identifier: Apache-2.0
"""Cameras and bars unlike the simulated ones: biased, missing and unaligned depth, other pixels, mirrors, dirt, frames.

Each function changes an image after it was taken, or draws another scene. Bounds of depth errors: makers of stereo
cameras allow 2 % of the range. The other numbers are assumed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_lab.reports.vision import views
from deltacharger_lab.reports.vision.views import DrawnView
from deltacharger_vision.cameras.camera_info import Readout
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.poses import turn
from deltacharger_vision.projection import project
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import Box, shifted

Random = np.random.Generator
Change = Callable[[RgbdImage, DrawnView, Random], RgbdImage]

BIAS = 0.02
"""Largest relative error of depth in the middle of the image, and half of its largest change per unit ray."""
_NEAR, _FAR = 0.15, 0.8  # m
_BESIDE = 0.05  # m of the plate around the bars whose depth is changed
_BASELINES, _ZOOMS = (0.015, 0.025, 0.05), (0.7, 1.0, 1.3)  # m, and focal lengths of a depth camera over the colour's


def plain(random: Random) -> DrawnView:
    """Return a terminal at 0.15–0.8 m."""
    return views.plain(random, _NEAR, _FAR)


def leaning(random: Random) -> DrawnView:
    """Return a terminal turned by 28° to 55° about any axis across the view."""
    view = views.plain(random, _NEAR, _FAR)
    while True:
        lean, way, roll = random.uniform((28.0, -180.0, -25.0), (55.0, 180.0, 25.0)) * np.pi / 180.0
        pose = view.pose.copy()
        tilt = turn(lean * np.array([np.cos(way), np.sin(way), 0.0]))
        pose[:3, :3] = tilt @ views.about(2, roll) @ np.diag([-1.0, -1.0, 1.0])
        if views.is_inside(pose, OAK_D):
            return dataclasses.replace(view, pose=pose)


def plate(reflectance: float) -> Callable[[Random], DrawnView]:
    """Return a terminal on a lighter plate."""
    return lambda random: plain(random).changed(scene={"plate": reflectance})


def framed(random: Random) -> DrawnView:
    """Return a terminal with a light frame, as high as the bars, 4 mm beside them."""
    view, width, beside = plain(random), 0.006, 0.004
    t = view.scene.terminal
    x, y = 0.5 * (t.bar_length + width) + beside, t.bar_height + 0.5 * (t.gap + width) + beside
    sides = [((sign * x, 0.0), (width, 2.0 * y + width)) for sign in (-1.0, 1.0)]
    sides += [((0.0, sign * y), (2.0 * x + width, width)) for sign in (-1.0, 1.0)]
    boxes = [
        Box(shifted((*place, 0.5 * t.bar_thickness)), (*size, t.bar_thickness), (0.7, 0.7, 0.7))
        for place, size in sides
    ]
    return view.changed(foreground=tuple(boxes))


def mirrors(random: Random) -> DrawnView:
    """Return a terminal whose bars mirror bright and dark surroundings."""
    return plain(random).changed(scene={"mirrored": 0.6, "streaks": 0.1, "highlight": 2.0})


def unchanged(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Return the image itself."""
    return image


def biased(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Scale depth by up to ±2 %, changing by up to ±1 % per unit ray over the image."""
    i, (middle, across, down) = image.intrinsics, random.uniform(-BIAS, BIAS, 3)
    row, column = np.mgrid[: i.height, : i.width]
    scale = 1.0 + middle + 0.5 * across * (column - i.cx) / i.fx + 0.5 * down * (row - i.cy) / i.fy
    return _with_depth(image, image.depth * scale)


def scaled_by(factor: float) -> Change:
    """Return the change that multiplies all depth."""
    return lambda image, view, random: _with_depth(image, factor * image.depth)


def shifted_by(disparity: float) -> Change:
    """Return the change that moves each disparity (px) one way or the other."""

    def change(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
        per_inverse = view.camera.stereo_focal * view.camera.baseline
        return _with_depth(image, per_inverse / (per_inverse / image.depth + random.choice([-1.0, 1.0]) * disparity))

    return change


def only_beyond(nearest: float) -> Change:
    """Return the change to a camera that measures no depth nearer than this, m."""
    return lambda image, view, random: _with_depth(image, np.where(image.depth < nearest, np.nan, image.depth))


def noisy_plate(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Scatter the depth of the plate by 25 %."""
    depth = image.depth.copy()
    plate = _plate(image, view)
    depth[plate] *= np.maximum(0.1, 1.0 + 0.25 * random.standard_normal(int(plate.sum())))
    return _with_depth(image, depth)


def mirrored_depth(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Give the bars, and 5 px around them, the depth of what they mirror."""
    import cv2

    bars = cv2.dilate(_bars(image, view).astype(np.uint8), np.ones((11, 11))) > 0
    return _with_depth(image, np.where(bars, random.uniform(1.3, 2.5) * image.depth, image.depth))


def dirty(share: float) -> Change:
    """Return the change that darkens this share of the bars to a quarter, in blots."""

    def change(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
        import cv2

        bars = _bars(image, view)
        blots = cv2.GaussianBlur(random.standard_normal(bars.shape).astype(np.float32), (0, 0), 3.0)
        dark = bars & (blots < np.quantile(blots[bars], share))
        color = np.where(dark[..., None], image.color // 4, image.color)
        return dataclasses.replace(image, color=np.asarray(color, dtype=np.uint8))

    return change


def unaligned(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Replace depth by that of a camera beside the colour camera, of another focal length."""
    zoom, pose = random.choice(_ZOOMS), view.pose.copy()
    pose[0, 3] -= random.choice(_BASELINES) * random.choice([-1.0, 1.0])
    lens = dataclasses.replace(image.intrinsics, fx=zoom * image.intrinsics.fx, fy=zoom * image.intrinsics.fy)
    return dataclasses.replace(image, depth=SimulatedCamera(lens, view.camera).render(view.scene, pose, random).depth)


def cropped(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Cut off 1 to 25 % at random sides, as the camera_info states."""
    i = image.intrinsics
    width, height = (int(size * random.uniform(0.75, 0.99)) for size in (i.width, i.height))
    left, top = (int(random.integers(room + 1)) for room in (i.width - width, i.height - height))
    part = np.s_[top : top + height, left : left + width]
    return RgbdImage.make(image.color[part], image.depth[part], Readout(left, top, width, height).of(i))


def cropped_untold(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Do the same without a word in the camera_info."""
    cut = cropped(image, view, random)
    return RgbdImage.make(cut.color, cut.depth, image.intrinsics)


def binned(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Combine 2 × 2 pixels, as the camera_info states."""
    small, i = _halved(image), image.intrinsics
    return RgbdImage.make(small.color, small.depth, Readout(binning_x=2, binning_y=2).of(i))


def scaled_untold(image: RgbdImage, view: DrawnView, random: Random) -> RgbdImage:
    """Send an image half as large with the calibration of the large one."""
    small = _halved(image)
    return RgbdImage.make(small.color, small.depth, image.intrinsics)


def _halved(image: RgbdImage) -> RgbdImage:
    import cv2

    color = cv2.resize(image.color, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return RgbdImage(np.asarray(color, dtype=np.uint8), image.depth[::2, ::2], image.intrinsics.binned(2, 2))


def _with_depth(image: RgbdImage, depth: NDArray[Any]) -> RgbdImage:
    return dataclasses.replace(image, depth=depth.astype(np.float32))


def _plate(image: RgbdImage, view: DrawnView) -> Mask:
    """Return where (H, W) the bars and _BESIDE around them are, on the plate's plane."""
    t = view.scene.terminal
    half = np.array([0.5 * t.bar_length, t.bar_height + 0.5 * t.gap]) + _BESIDE
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _filled(image, view, [np.column_stack([signs * half, np.full(4, t.bar_thickness)])])


def _bars(image: RgbdImage, view: DrawnView) -> Mask:
    return _filled(image, view, view.scene.terminal.corners())


def _filled(image: RgbdImage, view: DrawnView, polygons: Array | list[Array]) -> Mask:
    import cv2

    mask = np.zeros(image.depth.shape, dtype=np.uint8)
    for polygon in polygons:
        pixels = project(polygon @ view.pose[:3, :3].T + view.pose[:3, 3], image.intrinsics)
        cv2.fillConvexPoly(mask, np.round(pixels).astype(np.int32), 1)
    return mask > 0
