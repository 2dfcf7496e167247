# SPDX-License-Identifier: Apache-2.0
"""Poses in front of a camera, and expected pixels of points."""

import dataclasses

import numpy as np

from deltacharger_vision.images import Intrinsics, RgbdImage, distort
from deltacharger_vision.rendering.scene import Box, CameraParameters, RenderedScene, SceneParameters, shifted
from deltacharger_vision.terminal import UPPER, Terminal

EVEN = dataclasses.replace(SceneParameters(), highlight=0.0, streaks=0.0, mirrored=0.0, unevenness=0.0)
"""Uniform surfaces: no highlight, streaks, reflections or changes of the light."""
IDEAL = CameraParameters(
    shot_noise=0.0, read_noise=0.0, edge_width=1.0, disparity_noise=0.0, disparity_step=0.0, fattening=0,
    hole_metal=0.0, hole_glare=0.0, hole_matte=0.0, occlusion=False, whole_millimetres=False,
)  # fmt: skip
"""No noise, blur and holes, and continuous depth."""
# Light from straight ahead alone leaves the bars' sides black: only the touched faces are bright.
FACES = RenderedScene(parameters=dataclasses.replace(EVEN, ambient=0.0, diffuse=0.9), light=(0.0, 0.0, -1.0))
DISTORTIONS = ((), (-0.30, 0.12, 0.001, -0.0005, -0.02), (6.5, -3.1, 0.0004, -0.0003, 0.9, 6.7, -2.4, 0.6))


def view(distance: float, pitch: float = 0.0, yaw: float = 0.0, roll: float = 0.0, x: float = 0.0) -> np.ndarray:
    """Return camera_T_terminal: straight ahead at `distance` m and upright, then turned (rad) about x, y, z."""
    found = np.eye(4)
    for axis, angle in enumerate((pitch, yaw, roll)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(4)
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[j, i] = np.sin(angle)
        turn[i, j] = -turn[j, i]
        found = found @ turn
    found = found @ np.diag([-1.0, -1.0, 1.0, 1.0])
    found[:3, 3] = x, 0.0, distance
    return found


VIEWS = [
    view(0.16),
    view(0.23, pitch=0.54),
    view(0.3, pitch=-0.3, yaw=0.4, roll=0.5),
    view(0.6, 0.2, -0.3, -1.2),
    view(0.9, x=0.2),
]


def shown(points: np.ndarray, pose: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Return the pixels (..., 2) of points (..., 3) in the terminal's frame."""
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    ideal = distort(seen[..., :2] / seen[..., 2:], intrinsics.distortion)
    return ideal * [intrinsics.fx, intrinsics.fy] + [intrinsics.cx, intrinsics.cy]


def linear(color: np.ndarray) -> np.ndarray:
    """Return light (H, W) of an sRGB image's green, full scale 1."""
    encoded = color[:, :, 1] / 255.0
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def sampled(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return (N,) values of (H, W) at pixels (N, 2), linear between them."""
    column, row = np.floor(pixels).astype(int).T
    x, y = (pixels - np.floor(pixels)).T
    upper = image[row, column] * (1 - x) + image[row, column + 1] * x
    lower = image[row + 1, column] * (1 - x) + image[row + 1, column + 1] * x
    return upper * (1 - y) + lower * y


def edge_errors(image: RgbdImage, pose: np.ndarray) -> np.ndarray:
    """Return the distance (px) of the light's step outside each edge of the touched faces, at three places each."""
    light, found, reach = linear(image.color), [], np.arange(-2.0, 2.01, 0.05)
    for bar in Terminal().corners():
        middle = shown(bar.mean(axis=0), pose, image.intrinsics)
        for start, end in zip(bar, np.roll(bar, -1, axis=0), strict=True):
            for share in (0.3, 0.5, 0.7):
                place, ahead = shown(
                    start + np.array([[share], [share + 1e-3]]) * (end - start), pose, image.intrinsics
                )
                along = (ahead - place) / np.linalg.norm(ahead - place)
                outward = np.array([along[1], -along[0]])
                outward *= np.sign(outward @ (place - middle))
                profile = sampled(light, place + reach[:, None] * outward)
                found.append(reach[np.flatnonzero(profile > profile[0] / 2)[-1]])
    return np.array(found)


def cover(share: float, bar: int = UPPER, side: int = 1) -> Box:
    """Return a box 1 mm in front of the bars that hides `share` of one bar's length from its end at `side` · x on."""
    terminal = Terminal()
    length, height = share * terminal.bar_length, terminal.bar_height + terminal.gap
    x = side * (terminal.bar_length - length) / 2
    y = (1 if bar == UPPER else -1) * terminal.spacing / 2
    return Box(shifted((x, y, -0.002)), (length, height, 0.002), (0.05, 0.05, 0.055))
