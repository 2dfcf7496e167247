# SPDX-License-Identifier: Apache-2.0
"""What an error of the camera's mount does to electrodes told in charger_base, at the docking range."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_lab.reports.vision.measure import one_thread
from deltacharger_lab.reports.vision.views import about, draw_light
from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.mount import Mount
from deltacharger_vision.poses import turn
from deltacharger_vision.rendering.camera import SimulatedCamera
from deltacharger_vision.rendering.scene import RenderedScene

LEVELS = {"exact": (0.0, 0.0), "0.5° / 2 mm": (math.radians(0.5), 0.002), "1° / 3 mm": (math.radians(1.0), 0.003)}
"""Standard deviation of the mount about and along each axis, rad and m, by name."""
FIELDS = ("seed", "found", "camera_mm", "base_mm", "xy_mm", "z_mm", "roll_deg", "nees")
"""Of one image: error of the position in the camera's frame and in charger_base, there also across and along z."""
_ASIDE, _AWAY = 0.010, (0.070, 0.090)  # m, of the target in charger_base
_ROLL, _LEAN = math.radians(6.0), math.radians(2.0)


def judge(level: str, seeds: Sequence[int]) -> tuple[str, list[list[float]]]:
    """Return the level's name and a row of FIELDS for each seed.

    The camera sits where the mount's error has put it; what it detects is told by the nominal mount.
    """
    one_thread()
    nominal = Mount.default().pose
    rotation, translation = LEVELS[level]
    mount = Mount(nominal, np.diag([translation**2] * 3 + [rotation**2] * 3))
    camera, detector, rows = SimulatedCamera(), ElectrodeDetector(), []
    for seed in seeds:
        random = np.random.default_rng(seed)  # the levels compare: same targets, same directions of the error
        scene, target = RenderedScene(light=draw_light(random)), draw_target(random)
        true = nominal.copy()
        true[:3, :3] = turn(rotation * random.standard_normal(3)) @ nominal[:3, :3]
        true[:3, 3] += translation * random.standard_normal(3)
        pose = np.linalg.inv(true) @ target
        found = detector.detect(camera.render(scene, pose, random))
        if found is None:
            rows.append([float(seed), 0.0, *[math.nan] * 6])
            continue
        placed = mount.place(found)
        error = placed.position - target[:3, 3]
        roll = math.remainder(placed.roll - math.atan2(target[1, 0], target[0, 0]), math.pi)
        nees = float(error @ np.linalg.solve(placed.covariance[:3, :3], error))
        seen = float(np.linalg.norm(found.position - pose[:3, 3]))
        sizes = (seen, float(np.linalg.norm(error)), float(np.hypot(*error[:2])), abs(float(error[2])))
        rows.append([float(seed), 1.0, *(1e3 * each for each in sizes), math.degrees(abs(roll)), nees])
    return level, rows


def draw_target(random: np.random.Generator) -> Array:
    """Return (4, 4) charger_base_T_terminal of a robot that has come to be charged."""
    pose = np.eye(4)
    pose[:3, :3] = (
        about(0, random.normal(0.0, _LEAN))
        @ about(1, random.normal(0.0, _LEAN))
        @ about(2, random.uniform(-_ROLL, _ROLL))
    )
    pose[:3, 3] = random.uniform(-_ASIDE, _ASIDE), random.uniform(-_ASIDE, _ASIDE), random.uniform(*_AWAY)
    return pose
