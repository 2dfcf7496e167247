# SPDX-License-Identifier: Apache-2.0
"""The camera's mount on the charger (hand-eye) with its uncertainty, and detections in `charger_base`.

For a target with axes as the columns of R in charger_base, yaw = atan2(R[0, 2], R[2, 2]) is the lean about +y, and
pitch = atan2(−R[1, 2], R[2, 2]) the lean about +x. The normal toward the camera is −R[:, 2].
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_core import arrays, files, frames, machine, texts, yaml_file
from deltacharger_vision import errors, terminal

_SQUARE = 0.01  # cosine between bars and normal, which are perpendicular: a larger one contradicts the roll
_STEEPEST = 0.1  # least share of a normal along z: a lean of 84°


@dataclass(frozen=True, eq=False)
class Placed:
    """Electrodes in charger_base.

    Attributes:
        position: (3,) m, midpoint between the bars' touched faces.
        roll: rad in (−π/2, π/2], from +x to the projection of the bars' long axis on the x–y plane.
        normal: (3,) unit normal of the touched faces, toward the camera; NaN if unreliable.
        covariance: (6, 6) of position (m), of the rotation about x and y, and of the roll (rad), including the mount's
            error.
    """

    position: arrays.Array
    roll: float
    normal: arrays.Array
    covariance: arrays.Array

    @property
    def upright(self) -> bool:
        """Whether the normal is known."""
        return bool(np.isfinite(self.normal).all())

    def rotation(self) -> arrays.Array:
        """Return (3, 3) charger_base_R_target: z against the normal, x at the roll; without a normal, only the roll."""
        z = -self.normal if self.upright else np.array([0.0, 0.0, 1.0])
        x = np.array([math.cos(self.roll) * z[2], math.sin(self.roll) * z[2], 0.0])
        x[2] = -(math.cos(self.roll) * z[0] + math.sin(self.roll) * z[1])
        x /= np.linalg.norm(x)
        return np.column_stack([x, np.cross(z, x), z])

    def known_covariance(self) -> arrays.Array:
        """Return `covariance`, with NaN for the rotations about x and y if the normal is unknown."""
        found = self.covariance.copy()
        if not self.upright:
            found[3:5, :] = found[:, 3:5] = math.nan
        return found


def leaning_normal(yaw: float, pitch: float) -> arrays.Array:
    """Return the (3,) unit normal, toward the camera, of faces with this yaw and pitch, rad."""
    z = np.array([math.tan(yaw), -math.tan(pitch), 1.0])
    return np.asarray(-z / np.linalg.norm(z))


def is_front(axis: arrays.Array, normal: arrays.Array, sight: arrays.Array) -> bool:
    """Return whether a normal belongs to faces visible from the front to camera and charger, square to their bars.

    Args:
        axis: (3,) unit vector along the bars.
        normal: (3,) unit normal, toward the camera.
        sight: (3,) from the camera to the faces.
    """
    return bool(normal @ sight < 0.0 and normal[2] < -_STEEPEST and abs(normal @ axis) < _SQUARE)


FRAME, CAMERA_FRAME = frames.CHARGER_BASE, frames.CAMERA
_USUAL = np.diag([0.002**2] * 3 + [math.radians(0.5) ** 2] * 3)
"""Covariance of a mount without its own: m² and rad²; accuracy of a calibration by hand (assumed)."""
_PLACE, _DOCK = (0.0, 0.12, -0.12), (0.0, 0.0, machine.DOCK_DISTANCE)
_UNIT = 1e-3
_KEYS = ("frame", "camera_frame", "position", "orientation", "covariance", "calibration")


@dataclass(frozen=True, eq=False)
class Mount:
    """Pose of the camera on the charger.

    Attributes:
        pose: (4, 4) charger_base_T_camera, of the optical frame (x right, y down, z forward).
        covariance: (6, 6) of its error: translation (m) and a small rotation about the camera's centre (rad), both
            along the axes of charger_base.

    Raises:
        MountError: the pose is not rigid or on no robot, or the covariance is invalid.
    """

    pose: arrays.Array
    covariance: arrays.Array

    def __post_init__(self) -> None:
        pose, covariance = np.asarray(self.pose, dtype=float), np.asarray(self.covariance, dtype=float)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise errors.MountError("pose", f"shape {pose.shape} or not finite; give a (4, 4) transform")
        turn = pose[:3, :3]
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0.0:
            raise errors.MountError("orientation", "is no rotation; give a unit quaternion x, y, z, w")
        if problem := texts.far(pose[:3, 3].tolist()):
            raise errors.MountError("position", problem)
        if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
            raise errors.MountError("covariance", "give 36 finite numbers, (6, 6) row by row")
        if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] < -1e-12:
            raise errors.MountError("covariance", "must be symmetric and not negative")
        object.__setattr__(self, "pose", pose)
        object.__setattr__(self, "covariance", covariance)

    @staticmethod
    def default() -> Mount:
        """Return the usual mount: at (0, 0.12, −0.12) m, upright, pitched so that (0, 0, 80 mm) is centred."""
        return Mount(look_at(_PLACE, _DOCK), _USUAL)

    @staticmethod
    def from_numbers(seven: Sequence[float]) -> Mount:
        """Build a mount with the usual error from x, y, z (m) and the quaternion x, y, z, w, of length 1 within 0.001.

        Raises:
            MountError: the numbers are not a pose.
        """
        if len(seven) != 7:
            raise errors.MountError("mount", f"{len(seven)} numbers; give seven: x y z qx qy qz qw")
        pose = terminal.transform(_rotation(np.asarray(seven[3:], dtype=float)), seven[:3])
        return Mount(pose, _USUAL)

    @staticmethod
    def load(path: str | Path) -> Mount:
        """Read a YAML file written by `save`; without `covariance` the usual error is assumed.

        Raises:
            FileNotFoundError: no such file.
            MountError: the file is not a mount.
        """
        source = str(path)
        try:
            found = yaml_file.read_yaml(path)
        except yaml_file.YamlError as error:
            raise errors.MountError(
                source, f"{error.problem}; give a file of `deltacharger calibrate camera`"
            ) from error
        if not isinstance(found, dict):
            raise errors.MountError(source, f"must be a mapping with {', '.join(_KEYS)}")
        unknown = [key for key in found if key not in _KEYS]
        if unknown:
            raise errors.MountError(source, f"unknown key {files.brief(unknown[0])}; known: {', '.join(_KEYS)}")
        for key, frame in (("frame", FRAME), ("camera_frame", CAMERA_FRAME)):
            if found.get(key, frame) != frame:
                raise errors.MountError(
                    source, f"{key} is {files.brief(found[key])}; this is the pose of {CAMERA_FRAME} in {FRAME}"
                )
        try:
            mount = Mount.from_numbers([*_numbers(found, "position", 3), *_numbers(found, "orientation", 4)])
            if "covariance" not in found:
                return mount
            return Mount(mount.pose, np.reshape(_numbers(found, "covariance", 36), (6, 6)))
        except errors.MountError as error:
            raise errors.MountError(source, str(error)) from error

    def save(self, path: str | Path, about: Mapping[str, Any] | None = None) -> None:
        """Write a YAML file.

        Args:
            path: of the file.
            about: origin of the mount, saved under `calibration`; plain YAML values.
        """
        content: dict[str, Any] = {
            "frame": FRAME,
            "camera_frame": CAMERA_FRAME,
            "position": [round(float(value), 7) for value in self.pose[:3, 3]],
            "orientation": [round(float(value), 9) for value in quaternion(self.pose[:3, :3])],
            "covariance": [float(f"{value:.6g}") for value in self.covariance.ravel()],
        }
        if about:
            content["calibration"] = dict(about)
        yaml_file.write_yaml(path, content)

    def place(self, found: terminal.Detection) -> Placed:
        """Return a detection in charger_base; drops normals of faces that look away or are not square to their bars."""
        turn = self.pose[:3, :3]
        arm = turn @ found.position
        both = np.zeros((6, 6))
        both[:3, :3] = both[3:, 3:] = turn
        lever = np.eye(6)
        lever[:3, 3:] = -terminal.cross_matrix(arm)
        covariance = both @ found.covariance @ both.T + lever @ self.covariance @ lever.T
        axis, normal = turn @ found.axis, turn @ found.normal
        x, y, z = axis
        # d roll = dωz − z (x dωx + y dωy) / (x² + y²), from d axis = dω × axis.
        to_roll = np.eye(6)
        to_roll[5, 3:5] = -z * np.array([x, y]) / (x * x + y * y)
        return Placed(
            position=arm + self.pose[:3, 3],
            roll=line_angle(x, y),
            normal=normal if is_front(axis, normal, arm) else np.full(3, np.nan),
            covariance=to_roll @ covariance @ to_roll.T,
        )


def look_at(position: Sequence[float], point: Sequence[float]) -> arrays.Array:
    """Return (4, 4) charger_base_T_camera of a camera at `position` that centres `point` (m), upright along +y."""
    forward = np.subtract(point, position)
    right = np.cross(forward, (0.0, 1.0, 0.0))
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    return terminal.transform(np.column_stack([right, np.cross(forward, right), forward]), position)


def line_angle(x: float, y: float) -> float:
    """Return the angle of a line along (x, y) from +x, rad in (−π/2, π/2]."""
    angle = math.atan2(y, x)
    return angle - math.copysign(math.pi, angle) if not -0.5 * math.pi < angle <= 0.5 * math.pi else angle


def pose_numbers(pose: arrays.Array) -> tuple[float, ...]:
    """Return a pose (4, 4) as numbers for `Mount.from_numbers`: x, y, z in m, then the quaternion x, y, z, w."""
    return tuple(float(value) for value in (*pose[:3, 3], *quaternion(pose[:3, :3])))


def quaternion(rotation: arrays.Array) -> arrays.Array:
    """Return the unit quaternion (x, y, z, w), w ≥ 0, of a rotation (3, 3): the largest eigenvector (Bar-Itzhack)."""
    r = rotation
    matrix = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    found = np.linalg.eigh(matrix)[1][:, -1]
    return np.asarray(-found if found[3] < 0.0 else found)


def _rotation(q: arrays.Array) -> arrays.Array:
    """Return (3, 3) of a quaternion (x, y, z, w)."""
    length = float(np.linalg.norm(q))
    if not abs(length - 1.0) <= _UNIT:
        raise errors.MountError("orientation", f"a quaternion of length {length:.4g}; its length must be 1")
    return np.array(frames.rotation(*q))


def _numbers(found: Mapping[str, Any], key: str, count: int) -> list[float]:
    values = found.get(key)
    right = isinstance(values, list) and len(values) == count
    if not right or any(isinstance(value, bool) or not isinstance(value, numbers.Real) for value in values or ()):
        raise errors.MountError(key, f"is {files.brief(values)}; give {count} numbers")
    assert values is not None
    return [float(value) for value in values]
