# SPDX-License-Identifier: Apache-2.0
"""Names of the charger's coordinate frames, parameters of the nodes that use them, and rotations."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, ParameterError, number, words

Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


def rotation(x: float, y: float, z: float, w: float) -> Matrix:
    """Return the rotation matrix (3, 3) by rows of a quaternion of any length; NaN for length zero."""
    length = math.hypot(x, y, z, w) or math.nan
    x, y, z, w = x / length, y / length, z / length, w / length
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )


def lean(rows: Matrix) -> tuple[float, float]:
    """Return yaw and pitch (rad) of a frame whose axes are the columns of `rows` (3, 3).

    They are the rotations of its z axis about +y and about +x. Roll about z has no effect.
    """
    x, y, z = (row[2] for row in rows)
    return math.atan2(x, z), math.atan2(-y, z)


Quaternion = tuple[float, float, float, float]
Pose = tuple[float, float, float, float, float, float, float]
"""x, y, z (m), then the quaternion x, y, z, w."""

IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def product(a: Sequence[float], b: Sequence[float]) -> Quaternion:
    """Return the quaternion product a·b (x, y, z, w): rotation b, then a."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (
        aw * bx + bw * ax + ay * bz - az * by,
        aw * by + bw * ay + az * bx - ax * bz,
        aw * bz + bw * az + ax * by - ay * bx,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def composed(outer: Sequence[float], inner: Sequence[float]) -> Pose:
    """Return the composed transform outer·inner (7 numbers each)."""
    point = inner[:3]
    x, y, z = (
        origin + sum(factor * value for factor, value in zip(row, point, strict=True))
        for origin, row in zip(outer[:3], rotation(*outer[3:]), strict=True)
    )
    return x, y, z, *product(outer[3:], inner[3:])


def inverted(pose: Sequence[float]) -> Pose:
    """Return the inverse of a transform (7 numbers, unit quaternion)."""
    x, y, z, w = pose[3:]
    back = (-x, -y, -z, w)
    there = composed((0.0, 0.0, 0.0, *back), (*pose[:3], 0.0, 0.0, 0.0, 1.0))
    return -there[0], -there[1], -there[2], *back


def apart(a: Sequence[float], b: Sequence[float]) -> tuple[float, float]:
    """Return the distance (m) and the rotation angle (rad) between two poses (7 numbers each)."""
    difference = product((-a[3], -a[4], -a[5], a[6]), b[3:])
    turn = 2.0 * math.atan2(math.hypot(*difference[:3]), abs(difference[3]))
    return math.dist(a[:3], b[:3]), turn


CHARGER_BASE = "charger_base"
END_EFFECTOR = "end_effector"
CAMERA = "camera_color_optical_frame"
LONGEST = 256  # characters of a frame's name
_PREFIX_MAX = 64  # characters


@dataclass(frozen=True)
class FrameParameters(Bounded):
    """Prefix that distinguishes the frames of two chargers.

    Raises:
        ParameterError: the prefix begins with "/" (not allowed by tf), has white space or is too long.
    """

    frame_prefix: str = words(
        "", "prefix of every frame name of the charger, same as robot_state_publisher's frame_prefix, e.g. left/"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        _check("frame_prefix", self.frame_prefix)

    def named(self, frame: str) -> str:
        """Return the full name of a frame of the charger."""
        return f"{self.frame_prefix}{frame}"


@dataclass(frozen=True)
class JointFrameParameters(FrameParameters):
    """Prefixes of frames and joints of two chargers in one URDF. robot_state_publisher does not prefix joints.

    Raises:
        ParameterError: as in `FrameParameters`, for either prefix.
    """

    joint_prefix: str = words("", "prefix of the names in joint_states: the prefix of the URDF's macro, e.g. left_")

    def __post_init__(self) -> None:
        super().__post_init__()
        _check("joint_prefix", self.joint_prefix)


@dataclass(frozen=True)
class TransformParameters(FrameParameters):
    """Timeout and maximum age of tf transforms. They take effect only if tf2_ros is installed."""

    transform_timeout: float = number(2.0, 0.0, 10.0, "s", "longest wait for a transform that tf does not provide")
    transform_age_max: float = number(
        1.0, 0.05, 60.0, "s", "maximum age of a moving transform and of a stamped pose that needs one"
    )


def _check(name: str, prefix: str) -> None:
    """Refuse an invalid prefix; `name` is its parameter."""
    if prefix.startswith("/") or len(prefix.split()) > 1 or prefix != prefix.strip() or len(prefix) > _PREFIX_MAX:
        problem = f"{prefix[:_PREFIX_MAX]!a}: give at most {_PREFIX_MAX} characters, no white space, no leading '/'"
        raise ParameterError(name, prefix, problem)
