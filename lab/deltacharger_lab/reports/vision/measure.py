# SPDX-License-Identifier: Apache-2.0
"""Results of the detector on images of one kind, image by image, and its run time."""

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_lab.mujoco.camera import MujocoCamera
from deltacharger_lab.reports.vision.conditions import CONDITIONS, MUJOCO, Condition, DrawnView, about, draw_light
from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.mount import Mount, Placed
from deltacharger_vision.rendering.camera import SimulatedCamera
from deltacharger_vision.rendering.scene import CameraParameters, RenderedScene
from deltacharger_vision.terminal import Detection, turn

WRONG_POSITION, WRONG_ROLL = 0.010, math.radians(5.0)
"""A detection with a larger error, m or rad, is wrong."""
_LEANS = ("yaw_deg", "pitch_deg", "yaw_sigma", "pitch_sigma")
FIELDS = ("seed", "found", "wrong", "xy_mm", "z_mm", "roll_deg", "nees", "tilt_deg", *_LEANS, "error_mm", "sure")
"""Fields of one image. found and wrong are 0 or 1. Errors are NaN without a right detection, errors of tilt and lean
also without a normal. Yaw and pitch are in charger_base by an exact mount; *_sigma are their errors in units of the
reported standard deviation. error_mm is the total error of the position; sure is 1 if the answer is wrong and sure."""
SURE_ERROR, SURE_SIGMAS, SURE_TILT = 0.003, 6.0, math.radians(15.0)
"""An answer is wrong and sure if its error exceeds SURE_ERROR (m) and SURE_SIGMAS of its own covariance (Mahalanobis),
or if its normal errs by more than SURE_TILT (rad)."""
_WARM_UP = 5
_RUNS = 3  # of one detection; the least counts, because other work of the machine only adds time

LEVELS = {"exact": (0.0, 0.0), "0.5° / 2 mm": (math.radians(0.5), 0.002), "1° / 3 mm": (math.radians(1.0), 0.003)}
"""Standard deviation of the mount about and along each axis, rad and m, by name."""
MOUNT_FIELDS = ("seed", "found", "camera_mm", "base_mm", "xy_mm", "z_mm", "roll_deg", "nees", *_LEANS)
"""Fields of one image: position error in the camera's frame and in charger_base, there also across and along z."""
_EXACT = Mount(Mount.default().pose, np.zeros((6, 6)))
_ASIDE, _AWAY = 0.010, (0.070, 0.090)  # m, of the target in charger_base
_ROLL, _LEAN = math.radians(6.0), math.radians(2.0)


@dataclass(frozen=True)
class Sample:
    """One image.

    Attributes:
        view: scene before the camera.
        image: with the camera that the detector assumes.
    """

    view: DrawnView
    image: RgbdImage


class Photographer:
    """Takes the images of conditions, each camera made once; `close` releases them."""

    def __init__(self) -> None:
        self._cameras: dict[tuple[Intrinsics, CameraParameters, str], SimulatedCamera | MujocoCamera] = {}

    def take(self, condition: Condition, seed: int) -> Sample:
        """Return the image of a seed: views by stream, so that rows compare; independent noise."""
        view = condition.draw(np.random.default_rng([seed, condition.stream]))
        known = (condition.takes, view.camera, condition.renderer)
        if known not in self._cameras:
            self._cameras[known] = (MujocoCamera if condition.renderer == MUJOCO else SimulatedCamera)(*known[:2])
        random = np.random.default_rng([seed, condition.stream, 1])
        image = self._cameras[known].render(view.scene, view.pose, random, condition.color_only)
        return Sample(view, RgbdImage(image.color, image.depth, condition.assumed))

    def close(self) -> None:
        """Release the cameras."""
        for camera in self._cameras.values():
            if isinstance(camera, MujocoCamera):
                camera.close()
        self._cameras.clear()


def judge(name: str, seeds: Sequence[int]) -> tuple[str, list[list[float]]]:
    """Return a condition's name and a row of FIELDS for each seed."""
    one_thread()
    condition, detector = CONDITIONS[name], ElectrodeDetector()
    with contextlib.closing(Photographer()) as photographer:
        rows = []
        for seed in seeds:
            sample = photographer.take(condition, seed)
            found = detector.detect(sample.image)
            rows.append([float(seed), *errors(found, sample.view.pose, condition.real)])
    return name, rows


def errors(found: Detection | None, pose: Array, real: bool = True) -> list[float]:
    """Return FIELDS without the seed, of a detection of a terminal at (4, 4) `pose`, or without one."""
    nothing = [math.nan] * (len(FIELDS) - 4)
    if found is None:
        return [0.0, 0.0, *nothing, 0.0]
    error, roll = _off(found, pose)
    known = bool(np.all(np.isfinite(found.normal)))
    tilt = math.acos(min(1.0, float(-found.normal @ pose[:3, 2]))) if known else math.nan
    off, nees = float(np.linalg.norm(error)), _nees(error, found)
    sure = float((off > SURE_ERROR and nees > SURE_SIGMAS**2) or tilt > SURE_TILT)
    if not real or off > WRONG_POSITION or abs(roll) > WRONG_ROLL:
        return [1.0, 1.0, *nothing, sure]
    across, away, turned = 1e3 * float(np.hypot(*error[:2])), 1e3 * abs(float(error[2])), math.degrees(abs(roll))
    lean = _lean_errors(_EXACT.place(found), _EXACT.pose @ pose)
    return [1.0, 0.0, across, away, turned, nees, math.degrees(tilt), *lean, 1e3 * off, sure]


def _lean_errors(placed: Placed, target: Array) -> list[float]:
    """Return _LEANS for a terminal at (4, 4) `target` in charger_base."""
    (yaw, pitch, covariance), (x, y, z) = lean(placed), target[:3, 2]
    off = yaw - math.atan2(x, z), pitch - math.atan2(-y, z)
    return [*np.degrees(np.abs(off)).tolist(), *(off / np.sqrt(np.diag(covariance))).tolist()]


def _off(found: Detection | Placed, pose: Array) -> tuple[Array, float]:
    """Return the errors of position (3,) m and roll, rad, of a detection of a terminal at (4, 4) `pose`."""
    return found.position - pose[:3, 3], math.remainder(found.roll - math.atan2(pose[1, 0], pose[0, 0]), math.pi)


def _nees(error: Array, found: Detection | Placed) -> float:
    return float(error @ np.linalg.solve(found.covariance[:3, :3], error))


def judge_mount(level: str, seeds: Sequence[int]) -> tuple[str, list[list[float]]]:
    """Return the level's name and a row of MOUNT_FIELDS for each seed.

    The camera's pose includes the mount's error; detections are transformed by the nominal mount.
    """
    one_thread()
    nominal = Mount.default().pose
    rotation, translation = LEVELS[level]
    mount = Mount(nominal, np.diag([translation**2] * 3 + [rotation**2] * 3))
    camera, detector, rows = SimulatedCamera(), ElectrodeDetector(), []
    for seed in seeds:
        random = np.random.default_rng(seed)  # equal targets and directions of the error for all levels
        scene, target = RenderedScene(light=draw_light(random)), draw_target(random)
        true = nominal.copy()
        true[:3, :3] = turn(rotation * random.standard_normal(3)) @ nominal[:3, :3]
        true[:3, 3] += translation * random.standard_normal(3)
        pose = np.linalg.inv(true) @ target
        found = detector.detect(camera.render(scene, pose, random))
        if found is None:
            rows.append([float(seed), 0.0, *[math.nan] * (len(MOUNT_FIELDS) - 2)])
            continue
        placed = mount.place(found)
        error, roll = _off(placed, target)
        seen = float(np.linalg.norm(found.position - pose[:3, 3]))
        sizes = (seen, float(np.linalg.norm(error)), float(np.hypot(*error[:2])), abs(float(error[2])))
        lean = _lean_errors(placed, target)
        measured = (math.degrees(abs(roll)), _nees(error, placed))
        rows.append([float(seed), 1.0, *(1e3 * each for each in sizes), *measured, *lean])
    return level, rows


def draw_target(random: np.random.Generator) -> Array:
    """Return (4, 4) charger_base_T_terminal of a robot at the dock."""
    pose = np.eye(4)
    pose[:3, :3] = (
        about(0, random.normal(0.0, _LEAN))
        @ about(1, random.normal(0.0, _LEAN))
        @ about(2, random.uniform(-_ROLL, _ROLL))
    )
    pose[:3, 3] = random.uniform(-_ASIDE, _ASIDE), random.uniform(-_ASIDE, _ASIDE), random.uniform(*_AWAY)
    return pose


def times(names: Sequence[str], seeds: Sequence[int]) -> dict[str, dict[str, float]]:
    """Return processor time of one detection and of one image, ms, by condition: median, mean and 95 %.

    Images are made first, so that each part runs without other work. The first detections are not counted. A
    detection's time is the least of three runs.
    """
    one_thread()
    detector, found = ElectrodeDetector(), {}
    with contextlib.closing(Photographer()) as photographer:
        for name in names:
            condition = CONDITIONS[name]
            photographer.take(condition, seeds[0])
            drawn = [_timed(photographer.take, condition, seed) for seed in seeds]
            for _, sample in drawn[:_WARM_UP]:
                detector.detect(sample.image)
            taken = np.array(
                [min(_timed(detector.detect, sample.image)[0] for _ in range(_RUNS)) for _, sample in drawn]
            )
            images = np.array([each for each, _ in drawn])
            found[name] = {
                "median_ms": float(np.median(taken)),
                "mean_ms": float(np.mean(taken)),
                "p95_ms": float(np.percentile(taken, 95)),
                "image_ms": float(np.median(images)),
            }
    return found


def _timed(job: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    started = time.process_time()
    result = job(*arguments)
    return 1e3 * (time.process_time() - started), result


def one_thread() -> None:
    """Limit OpenCV to one core."""
    import cv2

    cv2.setNumThreads(1)


def lean(placed: Placed) -> tuple[float, float, Array]:
    """Return yaw and pitch (rad) of electrodes in charger_base and their first-order covariance; NaN if unknown."""
    if not placed.upright:
        return math.nan, math.nan, np.full((2, 2), math.nan)
    x, _, z = placed.rotation().T
    # dz = dω × z, and dωz follows the roll: dωz = d roll + x_z (x_x dωx + x_y dωy) / (x_x² + x_y²).
    about_z = np.array([*(x[2] * x[:2] / (x[0] ** 2 + x[1] ** 2)), 1.0])
    turning = np.vstack([np.eye(3)[:2], about_z])
    moved = np.array([[0.0, z[2], -z[1]], [-z[2], 0.0, z[0]], [z[1], -z[0], 0.0]]) @ turning
    slope = np.stack(
        [
            (z[2] * moved[0] - z[0] * moved[2]) / (z[0] ** 2 + z[2] ** 2),
            (z[1] * moved[2] - z[2] * moved[1]) / (z[1] ** 2 + z[2] ** 2),
        ]
    )
    return math.atan2(z[0], z[2]), math.atan2(-z[1], z[2]), slope @ placed.covariance[3:, 3:] @ slope.T
