# SPDX-License-Identifier: Apache-2.0
"""Random views of a terminal for the detector's tests, from the docked to the approaching robot."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltacharger_vision.detector.detection import Detection
from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.rendering.camera import SimulatedCamera
from deltacharger_vision.rendering.scene import Box, RenderedScene
from deltacharger_vision.terminal import Terminal

Array = NDArray[np.float64]

CAMERA, DETECTOR = SimulatedCamera(), ElectrodeDetector()


def turned(axis: int, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    result = np.eye(3)
    result[a, a], result[a, b], result[b, a], result[b, b] = c, -s, s, c
    return result


def pose_at(
    away: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, x: float = 0.0, y: float = 0.0
) -> Array:
    """camera_T_terminal of a terminal in front of the camera: x and y as tangents of the line of sight."""
    pose = np.eye(4)
    pose[:3, :3] = turned(0, pitch) @ turned(1, yaw) @ turned(2, roll) @ np.diag([-1.0, -1.0, 1.0])
    pose[:3, 3] = away * np.array([x, y, 1.0]) / math.sqrt(1.0 + x * x + y * y)
    return pose


def random_view(random: np.random.Generator, nearest: float, farthest: float) -> tuple[RenderedScene, Array]:
    away = random.uniform(nearest, farthest)
    room = 0.3 if away > 0.22 else 0.15
    pose = pose_at(
        away,
        roll=random.uniform(-0.4, 0.4),
        pitch=random.uniform(-0.1, 0.5),
        yaw=random.normal(0.0, 0.12),
        x=random.uniform(-room, room),
        y=random.uniform(-0.5 * room, 0.5 * room),
    )
    light = (float(random.normal(0.0, 0.5)), float(random.uniform(0.0, 1.0)), float(-random.uniform(0.3, 1.0)))
    return RenderedScene(light=light), pose


class Look(NamedTuple):
    """What the detector found in an image of a terminal at a known pose."""

    found: Detection | None
    pose: Array
    image: RgbdImage

    @property
    def off(self) -> float:
        """Error of the position, m; NaN if nothing was found."""
        return math.nan if self.found is None else float(np.linalg.norm(error(self.found, self.pose)))


def look(pose: Array, seed: int = 5, scene: RenderedScene | None = None, camera: SimulatedCamera = CAMERA) -> Look:
    image = camera.render(scene or RenderedScene(), pose, np.random.default_rng(seed))
    return Look(DETECTOR.detect(image), pose, image)


def looks(
    seeds: Iterable[int],
    nearest: float,
    farthest: float,
    change: Callable[[RenderedScene, np.random.Generator], RenderedScene] = lambda scene, random: scene,
    camera: SimulatedCamera = CAMERA,
) -> Iterator[Look]:
    """Look at random views; `change` alters their scenes."""
    for seed in seeds:
        random = np.random.default_rng(seed)
        scene, pose = random_view(random, nearest, farthest)
        image = camera.render(change(scene, random), pose, random)
        yield Look(DETECTOR.detect(image), pose, image)


def seen_again(look: Look, **changed: Any) -> Look:
    """Detect again in the same image with other depth or intrinsics."""
    image = dataclasses.replace(look.image, **changed)
    return Look(DETECTOR.detect(image), look.pose, image)


def scaled(terminal: Terminal, scale: float) -> Terminal:
    return Terminal(**{item.name: getattr(terminal, item.name) * scale for item in dataclasses.fields(terminal)})


def half_hidden(scene: RenderedScene, bar: float, end: float) -> RenderedScene:
    """A grey plate just in front of one half (end ±1 along x) of one bar (±1 along y)."""
    pose = np.eye(4)
    pose[:3, 3] = [end * 0.03, bar * 0.0107, -0.002]
    return dataclasses.replace(scene, foreground=(Box(pose, (0.06, 0.0164, 0.001), (0.2, 0.2, 0.2)),))


def clutter(random: np.random.Generator) -> RenderedScene:
    """A room without electrodes: boxes of any brightness, bars among them."""
    boxes = []
    for _ in range(14):
        pose = np.eye(4)
        pose[:3, :3] = (
            turned(0, random.normal(0.0, 0.4))
            @ turned(1, random.normal(0.0, 0.4))
            @ turned(2, random.uniform(-3.0, 3.0))
        )
        pose[:3, 3] = [random.uniform(-0.3, 0.3), random.uniform(-0.2, 0.2), random.uniform(-0.05, 0.6)]
        size = (random.uniform(0.02, 0.2), random.uniform(0.005, 0.08), random.uniform(0.005, 0.05))
        shade = float(random.uniform(0.02, 0.9))
        boxes.append(Box(pose, size, (shade, shade, shade), metal=bool(random.random() < 0.4)))
    return RenderedScene(background=tuple(boxes), target=False)


def error(found: Detection, pose: Array) -> Array:
    return np.asarray(found.position - pose[:3, 3])


def roll_error(found: Detection, pose: Array) -> float:
    return math.remainder(found.roll - math.atan2(pose[1, 0], pose[0, 0]), math.pi)


def without_depth(image: RgbdImage) -> RgbdImage:
    return RgbdImage(image.color, np.full_like(image.depth, np.nan), image.intrinsics)


def quarter_turn(image: RgbdImage) -> RgbdImage:
    """The picture turned counter-clockwise: a point at (x, y, z) comes to (y, −x, z)."""
    i = image.intrinsics
    turned_camera = dataclasses.replace(
        i, width=i.height, height=i.width, fx=i.fy, fy=i.fx, cx=i.cy, cy=i.width - 1 - i.cx
    )
    return RgbdImage(
        np.ascontiguousarray(np.rot90(image.color)), np.ascontiguousarray(np.rot90(image.depth)), turned_camera
    )


def mirrored(image: RgbdImage) -> RgbdImage:
    """The picture in a mirror: a point at (x, y, z) comes to (−x, y, z)."""
    i = image.intrinsics
    camera = dataclasses.replace(i, cx=i.width - 1 - i.cx)
    return RgbdImage(np.ascontiguousarray(image.color[:, ::-1]), np.ascontiguousarray(image.depth[:, ::-1]), camera)
