# SPDX-License-Identifier: Apache-2.0
"""Between messages and the state machine's plain values. Part of docking_node."""

from __future__ import annotations

import copy
import math
from array import array
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from deltacharger.msg import ElectrodeDetection, Misalignment
from geometry_msgs.msg import PoseStamped
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_core.rotation import IDENTITY, Matrix, composed, inverted, lean, rotation
from deltacharger_docking.clearance import FeltPose, MisalignmentClasses
from deltacharger_docking.codes import Rejected, Unplaced
from deltacharger_docking.observation import BasePose, ElectrodePose
from deltacharger_docking.parameters import DockingNodeParameters
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_ros.frames import Contradiction, Frames
from deltacharger_ros.messages import duration
from deltacharger_ros.tf_tree import TransformError, UnknownFrame

_UNIT = (0.9, 1.1)  # norm of a quaternion that somebody meant
_LEVEL = 1e-3  # rad; a lean below it is rounding, such as that of a quaternion of four digits
_SAME = 1e-3  # rad between a detection's roll and that of its orientation
_ABOUT_X, _ABOUT_Y, _ABOUT_Z = 21, 28, 35  # of a 6 × 6 covariance, row-major: variances of the rotations, rad²


_DEGREES = tuple(math.radians(degree) for degree in range(6))
_OFFSETS = (-0.010, -0.005, 0.0, 0.005, 0.010)
_CENTRES = {"angle": _DEGREES, "vertical": _OFFSETS, "horizontal": _OFFSETS}  # rad, m; as Misalignment.msg lists them


def estimate(message: Misalignment, with_classes: bool = False) -> FeltPose:
    """Return the plain values of a Misalignment; its most probable classes only where they were asked for."""
    return FeltPose.of(message, _classes(message) if with_classes else None)


def told(value: FeltPose, source: Misalignment) -> Misalignment:
    """Return the message that an estimate came from with the numbers that docking made of it."""
    message = copy.deepcopy(source)
    for name in ("horizontal", "vertical", "across", "yaw", "pitch"):
        setattr(message, name, getattr(value, name))
        setattr(message, f"{name}_stddev", getattr(value, f"{name}_stddev"))
    return message


def _classes(message: Misalignment) -> MisalignmentClasses:
    """Return the centres of the most probable classes; NaN where probabilities are missing or not finite."""
    found = {}
    for axis, centres in _CENTRES.items():
        shares = np.asarray(getattr(message, f"{axis}_probability"), dtype=float)
        known = shares.shape == (len(centres),) and bool(np.isfinite(shares).all())
        found[axis] = centres[int(np.argmax(shares))] if known else math.nan
    return MisalignmentClasses(**found)


def trajectory(waypoints: Sequence[Waypoint], stamp: Any, secret: str = "") -> JointTrajectory:
    """Return waypoints as a JointTrajectory whose efforts (N·m) bound each servo's torque.

    The velocities are for whoever interpolates with them; servo_node goes straight from point to point, and they are
    dense enough for that. The frame_id, which angles do not need, is the sender's secret: servo_node knows by it who
    leads the arm.
    """
    message = JointTrajectory(joint_names=list(JOINTS))
    message.header.stamp = stamp
    message.header.frame_id = secret
    message.points = [
        JointTrajectoryPoint(
            positions=array("d", point.angles),
            velocities=array("d", point.velocities or ()),
            effort=array("d", point.torque_bound),
            time_from_start=duration(point.time),
        )
        for point in waypoints
    ]
    return message


def electrodes(
    message: PoseStamped, mount: DockingNodeParameters, charger: Sequence[float] = IDENTITY
) -> ElectrodePose | None:
    """Return a goal's electrodes in charger_base; None for an empty frame_id (ask the camera).

    Args:
        message: pose of the electrodes' midpoint, its z axis away from the charger. Where that leans it is believed, at
            `goal_lean_stddev`. One that does not is the roll about z alone, as most clients send it: nobody looked
            whether the faces lean, so their lean is unknown.
        mount: how far electrodes may lean.
        charger: charger_base in the goal's frame.

    Raises:
        Rejected: a pose that is not finite, an orientation that is no unit quaternion, or one whose z axis leans by
            more than `lean_max` from charger_base's.
    """
    if not message.header.frame_id:
        return None
    turn, point = message.pose.orientation, message.pose.position
    position, axes = np.array([point.x, point.y, point.z]), np.array(rotation(turn.x, turn.y, turn.z, turn.w))
    if not np.isfinite(position).all() or not np.isfinite(axes).all():
        raise Rejected("the electrodes' pose is not finite; send numbers, or an empty frame_id to use the camera")
    if not _UNIT[0] <= math.hypot(turn.x, turn.y, turn.z, turn.w) <= _UNIT[1]:
        raise Rejected("the electrodes' orientation is no unit quaternion; send one, such as (0, 0, 0, 1)")
    base = np.array(rotation(*charger[3:]))
    position, axes = base.T @ (position - np.asarray(charger[:3])), base.T @ axes
    leans = math.atan2(math.hypot(axes[0, 2], axes[1, 2]), axes[2, 2])
    if leans > mount.lean_max:
        raise Rejected(
            f"the electrodes' z axis leans {math.degrees(leans):.0f}° from charger_base's, more than lean_max; give "
            "the orientation of charger_base, rolled and leaning as the electrodes do"
        )
    x, y, z = position.tolist()
    found = ElectrodePose((x, y, z), math.atan2(axes[1, 0], axes[0, 0]))
    if leans < _LEVEL:
        return found
    yaw, pitch = lean(axes.tolist())
    stddev = mount.goal_lean_stddev
    return replace(found, yaw=yaw, pitch=pitch, yaw_stddev=stddev, pitch_stddev=stddev)


def refusal(error: TransformError) -> Rejected:
    """Return with what a goal is refused whose frame cannot be told; it may come back where that may pass by itself."""
    lasts = isinstance(error, UnknownFrame | Contradiction)
    return Rejected(str(error)) if lasts else Unplaced(str(error))


def in_charger_base(message: ElectrodeDetection, frames: Frames) -> ElectrodeDetection:
    """Return a detection in charger_base, whatever frame it is told in; the mount's error is its sender's to tell.

    Raises:
        TransformError: its frame is not known; it is not waited for.
        ValueError: of a detection in another frame, as of `seen`: its roll is told anew.
    """
    charger = frames.charger_base_in(message.header.frame_id, message.header.stamp, timeout=0.0)
    if charger == IDENTITY:
        return message
    _axes(message)
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    pose = composed(inverted(charger), (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))
    axes = rotation(*pose[3:])
    if axes[0][0] < 0.0:  # the bars look the same from both ends: the roll is within a quarter turn
        pose = composed(pose, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0))
        axes = rotation(*pose[3:])
    both = np.kron(np.eye(2), np.array(rotation(*charger[3:])).T)
    covariance = both @ np.asarray(message.pose.covariance, dtype=float).reshape(6, 6) @ both.T
    found = copy.deepcopy(message)
    found.header.frame_id = frames.charger_base
    place, turn = found.pose.pose.position, found.pose.pose.orientation
    place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = pose
    found.pose.covariance = covariance.ravel()
    found.roll = math.atan2(axes[1][0], axes[0][0])
    return found


def seen(message: ElectrodeDetection, age: float) -> ElectrodePose:
    """Return a detection, `age` s old, in plain values.

    A lean whose variance is NaN, or 0 as in messages that do not fill it, is unknown.

    Raises:
        ValueError: orientation or roll is not finite, they contradict each other, or a rotation's variance is negative.
    """
    point, covariance = message.pose.pose.position, message.pose.covariance
    axes = _axes(message)
    variances = tuple(float(covariance[index]) for index in (_ABOUT_X, _ABOUT_Y, _ABOUT_Z))
    if any(variance < 0.0 for variance in variances):
        raise ValueError("the detection has a negative variance of a rotation; look at the detector's covariance")
    pitch_stddev, yaw_stddev = (math.sqrt(variance) if variance > 0.0 else math.nan for variance in variances[:2])
    yaw, pitch = lean(axes)
    return ElectrodePose(
        (point.x, point.y, point.z),
        message.roll,
        math.sqrt(variances[2]) if variances[2] >= 0.0 else math.inf,  # of NaN: unknown is not exact
        age,
        math.nan if math.isnan(yaw_stddev) else yaw,
        math.nan if math.isnan(pitch_stddev) else pitch,
        yaw_stddev,
        pitch_stddev,
    )


def _axes(message: ElectrodeDetection) -> Matrix:
    """Return a detection's axes as columns; errors of orientation and roll as of `seen`."""
    turn = message.pose.pose.orientation
    axes = rotation(turn.x, turn.y, turn.z, turn.w)
    if not all(math.isfinite(value) for row in axes for value in (*row, message.roll)):
        raise ValueError("the detection's orientation or roll is not finite; look at the detector's mount")
    told = math.atan2(axes[1][0], axes[0][0])
    if abs(math.remainder(told - message.roll, 2.0 * math.pi)) > _SAME:
        raise ValueError(
            f"the detection contradicts itself: its roll is {math.degrees(message.roll):.1f}°, that of its orientation "
            f"{math.degrees(told):.1f}°; look at the detector"
        )
    return axes


def pose_stamped(base: BasePose | None, stamp: Any, frame: str) -> PoseStamped:
    """Return a stand of charger_base as a pose in the present one, called `frame`; an empty frame_id for None."""
    message = PoseStamped()
    if base is not None:
        message.header.stamp = stamp
        message.header.frame_id = frame
        point, turn = message.pose.position, message.pose.orientation
        point.x, point.y, point.z = base.x, base.y, base.z
        turn.y, turn.w = math.sin(0.5 * base.yaw), math.cos(0.5 * base.yaw)
    return message
