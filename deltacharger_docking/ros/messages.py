# SPDX-License-Identifier: Apache-2.0
"""Conversion between messages and the state machine's plain values. Part of docking_node."""

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

from deltacharger_core.frames import CHARGER_BASE, IDENTITY, lean, rotation
from deltacharger_core.machine import JOINTS
from deltacharger_core.ros import frames, messages
from deltacharger_docking import clearance, codes, observation
from deltacharger_kinematics.trajectory_feed import Waypoint

_LEAN_MAX = math.radians(30.0)  # of a goal's electrodes: more is a wrong frame
_GOAL_LEAN_STDDEV = math.radians(1.0)  # standard deviation of a goal's lean, which goals do not give

_UNIT = (0.9, 1.1)  # accepted norm of a quaternion
_LEVEL = 1e-3  # rad; a smaller lean is rounding, for example of a quaternion with four digits
IMAGE_ALONE = "image"
"""`ElectrodeDetection.source` of a pose without depth."""
_SAME = 1e-3  # rad; accepted difference of a detection's roll and orientation
_ABOUT_X, _ABOUT_Y, _ABOUT_Z = 21, 28, 35  # in a 6 × 6 covariance, row-major: variances of the rotations, rad²
GIVEN = ("critical_angle", "start_charging", "hold", "stop_energy", "request_id", "target_profile")
"""Fields of a Dock goal that have the same names in docking's own."""
MEASURED = (
    *("aligned", "alignments", "contact_current", "contact_force", "charge_current", "energy"),
    *("contact_force_min", "contact_force_max", "charge_end", "charge_voltage"),
)
"""Fields of a Dock result that have the same names in an outcome."""


def refined(value: clearance.MisalignmentEstimate, source: Misalignment) -> Misalignment:
    """Return the message of an estimate, with the values that docking has refined."""
    message = copy.deepcopy(source)
    for name in ("horizontal", "vertical", "across", "yaw", "pitch"):
        setattr(message, name, getattr(value, name))
        setattr(message, f"{name}_stddev", getattr(value, f"{name}_stddev"))
    return message


def trajectory(waypoints: Sequence[Waypoint], stamp: Any, secret: str = "") -> JointTrajectory:
    """Return waypoints as a JointTrajectory whose efforts (N·m) bound each servo's torque.

    The velocities serve receivers that interpolate with them. servo_node interpolates linearly between the points,
    which are dense enough for that. Angles need no frame_id; it holds the sender's secret, by which servo_node
    recognizes the process that controls the arm.
    """
    message = JointTrajectory(joint_names=list(JOINTS))
    message.header.stamp = stamp
    message.header.frame_id = secret
    message.points = [
        JointTrajectoryPoint(
            positions=array("d", point.angles),
            velocities=array("d", point.velocities or ()),
            effort=array("d", point.torque_bound),
            time_from_start=messages.duration(point.time),
        )
        for point in waypoints
    ]
    return message


def check_numbers(message: PoseStamped) -> None:
    """Refuse a goal's electrodes with numbers that are no pose, in whatever frame; an empty frame_id needs none.

    Raises:
        Rejected: a pose that is not finite, or an orientation that is not a unit quaternion.
    """
    turn, point = message.pose.orientation, message.pose.position
    if not message.header.frame_id:
        return
    if not all(map(math.isfinite, (point.x, point.y, point.z, turn.x, turn.y, turn.z, turn.w))):
        raise codes.Rejected("the electrodes' pose is not finite; send numbers, or an empty frame_id to use the camera")
    if not _UNIT[0] <= math.hypot(turn.x, turn.y, turn.z, turn.w) <= _UNIT[1]:
        raise codes.Rejected("the electrodes' orientation is not a unit quaternion; send one, such as (0, 0, 0, 1)")


def electrodes(message: PoseStamped, charger: Sequence[float] = IDENTITY) -> observation.ElectrodePose | None:
    """Return a goal's electrodes in charger_base; None for an empty frame_id (ask the camera).

    Args:
        message: pose of the electrodes' midpoint, its z axis away from the charger. A lean is used with the error
            _GOAL_LEAN_STDDEV. Without a lean the orientation is taken as the roll about z alone, as most clients send
            it, and the lean of the faces is unknown.
        charger: charger_base in the goal's frame.

    Raises:
        Rejected: a z axis that leans from charger_base's by more than _LEAN_MAX.
    """
    if not message.header.frame_id:
        return None
    turn, point = message.pose.orientation, message.pose.position
    position, axes = np.array([point.x, point.y, point.z]), np.array(rotation(turn.x, turn.y, turn.z, turn.w))
    base = np.array(rotation(*charger[3:]))
    position, axes = base.T @ (position - np.asarray(charger[:3])), base.T @ axes
    leans = math.atan2(math.hypot(axes[0, 2], axes[1, 2]), axes[2, 2])
    if leans > _LEAN_MAX:
        told = f"the electrodes' z axis leans {math.degrees(leans):.0f}° from charger_base's, more than 30°"
        raise codes.Rejected(f"{told}; give the orientation of charger_base, with their roll and lean")
    x, y, z = position.tolist()
    found = observation.ElectrodePose((x, y, z), math.atan2(axes[1, 0], axes[0, 0]))
    if leans < _LEVEL:
        return found
    yaw, pitch = lean(axes.tolist())
    stddev = _GOAL_LEAN_STDDEV
    return replace(found, yaw=yaw, pitch=pitch, yaw_stddev=stddev, pitch_stddev=stddev)


def refusal(error: frames.TransformError) -> codes.Rejected:
    """Return the refusal of a goal whose frame has no known transform; it is retriable if that may pass by itself."""
    lasts = isinstance(error, frames.UnknownFrame | frames.Contradiction)
    return codes.Rejected(str(error)) if lasts else codes.PoseUnknown(str(error))


def seen(message: ElectrodeDetection, age: float, frame: str = CHARGER_BASE) -> observation.ElectrodePose:
    """Return a detection with this age (s) as plain values; `frame` is the full name of charger_base.

    A lean is unknown if its variance is NaN, or 0 as in messages that do not set it.

    Raises:
        ValueError: it is in another frame, orientation or roll is not finite, they contradict each other, or a
            rotation's variance is negative.
    """
    if message.header.frame_id != frame:
        raise ValueError(f"the detection is in frame '{message.header.frame_id}', not in {frame}; check the detector")
    point, covariance = message.pose.pose.position, message.pose.covariance
    turn = message.pose.pose.orientation
    axes = rotation(turn.x, turn.y, turn.z, turn.w)
    if not all(math.isfinite(value) for row in axes for value in (*row, message.roll)):
        raise ValueError("the detection's orientation or roll is not finite; check the detector's mount")
    oriented = math.atan2(axes[1][0], axes[0][0])
    if abs(math.remainder(oriented - message.roll, 2.0 * math.pi)) > _SAME:
        told = f"its roll is {math.degrees(message.roll):.1f}°, its orientation has {math.degrees(oriented):.1f}°"
        raise ValueError(f"the detection contradicts itself: {told}; check the detector")
    variances = tuple(float(covariance[index]) for index in (_ABOUT_X, _ABOUT_Y, _ABOUT_Z))
    if any(variance < 0.0 for variance in variances):
        raise ValueError("the detection has a negative variance of a rotation; check the detector's covariance")
    pitch_stddev, yaw_stddev = (math.sqrt(variance) if variance > 0.0 else math.nan for variance in variances[:2])
    yaw, pitch = lean(axes)
    return observation.ElectrodePose(
        (point.x, point.y, point.z),
        message.roll,
        math.sqrt(variances[2]) if variances[2] >= 0.0 else math.inf,  # NaN: an unknown error is not zero
        age,
        math.nan if math.isnan(yaw_stddev) else yaw,
        math.nan if math.isnan(pitch_stddev) else pitch,
        yaw_stddev,
        pitch_stddev,
        message.range if message.source == IMAGE_ALONE else 0.0,
    )


def pose_stamped(base: observation.BasePose | None, stamp: Any, frame: str) -> PoseStamped:
    """Return a pose for charger_base in the present one, named `frame`; an empty frame_id for None."""
    message = PoseStamped()
    if base is not None:
        message.header.stamp = stamp
        message.header.frame_id = frame
        point, turn = message.pose.position, message.pose.orientation
        point.x, point.y, point.z = base.x, base.y, base.z
        turn.y, turn.w = math.sin(0.5 * base.yaw), math.cos(0.5 * base.yaw)
    return message
