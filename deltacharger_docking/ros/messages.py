# SPDX-License-Identifier: Apache-2.0
"""Between messages and the state machine's plain values. Part of docking_node."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from deltacharger.msg import Misalignment
from geometry_msgs.msg import PoseStamped
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_core.rotation import rotation
from deltacharger_docking.clearance import FeltPose, MisalignmentClasses
from deltacharger_docking.codes import Rejected
from deltacharger_docking.observation import ElectrodePose
from deltacharger_docking.parameters import DockingNodeParameters
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_ros.messages import duration

_QUOTED = 60  # characters of what a client sent that a message repeats
_UNIT = (0.9, 1.1)  # norm of a quaternion that somebody meant


_DEGREES = tuple(math.radians(degree) for degree in range(6))
_OFFSETS = (-0.010, -0.005, 0.0, 0.005, 0.010)
_CENTRES = {"angle": _DEGREES, "vertical": _OFFSETS, "horizontal": _OFFSETS}  # rad, m; as Misalignment.msg lists them


def estimate(message: Misalignment, with_classes: bool = False) -> FeltPose:
    """Return the plain values of a Misalignment; its most probable classes only where they were asked for."""
    told = {item.name: getattr(message, item.name) for item in fields(FeltPose) if item.name != "classes"}
    return FeltPose(**told, classes=_classes(message) if with_classes else None)


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


def electrodes(message: PoseStamped, mount: DockingNodeParameters) -> ElectrodePose | None:
    """Return a goal's electrodes in charger_base; None for an empty frame_id (ask the camera).

    Args:
        message: pose of the electrodes' midpoint, orientation = that of charger_base turned by the roll about its z.
        mount: charger_base in the robot's frame, and how far electrodes may lean: what is docked to is the roll alone.

    Raises:
        Rejected: unknown frame, a pose that is not finite, or one that leans away from charger_base.
    """
    frame = message.header.frame_id
    if not frame:
        return None
    if frame not in ("charger_base", mount.base_frame):
        known = f"charger_base, {mount.base_frame}"
        raise Rejected(f"unknown frame {frame[:_QUOTED]!a}: give {known}, or '' to use the camera")
    turn, point = message.pose.orientation, message.pose.position
    position, axes = np.array([point.x, point.y, point.z]), np.array(rotation(turn.x, turn.y, turn.z, turn.w))
    if not np.isfinite(position).all() or not np.isfinite(axes).all():
        raise Rejected("the electrodes' pose is not finite; send numbers, or an empty frame_id to use the camera")
    if not _UNIT[0] <= math.hypot(turn.x, turn.y, turn.z, turn.w) <= _UNIT[1]:
        raise Rejected("the electrodes' orientation is no unit quaternion; send one, such as (0, 0, 0, 1)")
    if frame == mount.base_frame:
        base = np.array(rotation(*mount.base_pose[3:]))
        position = base.T @ (position - np.asarray(mount.base_pose[:3]))
        axes = base.T @ axes
    if axes[2, 2] < math.cos(mount.lean_max):
        lean = math.degrees(math.acos(max(min(float(axes[2, 2]), 1.0), -1.0)))
        raise Rejected(f"the electrodes' z axis leans {lean:.0f}° from charger_base's; give the roll about z alone")
    x, y, z = position.tolist()
    return ElectrodePose((x, y, z), math.atan2(axes[1, 0], axes[0, 0]))


def pose_stamped(position: Vector | None, stamp: Any) -> PoseStamped:
    """Return a position in charger_base as a pose; an empty frame_id for None."""
    message = PoseStamped()
    if position is not None:
        message.header.stamp = stamp
        message.header.frame_id = "charger_base"
        message.pose.position.x, message.pose.position.y, message.pose.position.z = position
    return message
