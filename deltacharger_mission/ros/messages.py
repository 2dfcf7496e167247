# SPDX-License-Identifier: Apache-2.0
"""Conversion between ROS messages and the mission's plain values."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from deltacharger.action import Dock
from geometry_msgs.msg import PoseStamped

from deltacharger_core.frames import END_EFFECTOR, LONGEST, Pose, composed, lean, rotation
from deltacharger_core.texts import ON_MAP, cut, far
from deltacharger_docking.codes import Code, Rejected, State
from deltacharger_docking.observation import BasePose
from deltacharger_docking.ros.messages import seen
from deltacharger_kinematics.geometry import Vector
from deltacharger_mission.dialogue import DockingReport, End, MissionGoal, TaskReply
from deltacharger_mission.places import Place
from deltacharger_ros.messages import seconds, unknown_misalignment


def read_dock(number: int, end: End, result: Any, feedback: Any) -> TaskReply:
    """Return the reply of a docking or an undocking; `result` is None if docking_node sent none."""
    if result is None:
        return TaskReply(number, end, Code.REJECTED, "docking_node did not accept the goal; check its log", True)
    pose = getattr(result, "suggested_base_pose", None)
    base = _suggested_base(pose.pose) if pose is not None and pose.header.frame_id else None
    code = Code(result.error_code) if result.error_code in set(Code) else Code.INTERNAL
    ended = End.DONE if result.success else End.FAILED if end is End.DONE else end
    energy = getattr(result, "energy", 0.0)
    unmeasured = math.isnan(energy) and math.isnan(result.charge_current)
    message = cut(result.error_message)
    return TaskReply(
        number, ended, code, message, result.retriable, suggested=base, unmeasured=unmeasured, energy=energy
    )


def read_drive(number: int, end: End, result: Any, feedback: Any) -> TaskReply:
    """Return the reply of a drive; results before Kilted have no text, and before Iron no code."""
    code, words = getattr(result, "error_code", 0), cut(getattr(result, "error_msg", ""))
    message = " ".join(part for part in (words, f"(error {code} of the navigator)" if code else "") if part)
    return TaskReply(number, end, message=message, place=None if feedback is None else place(feedback.current_pose))


def read_detection(number: int, answer: Any, place: Callable[[Any], Any] = lambda detection: detection) -> TaskReply:
    """Return the reply of detect_electrodes.

    An implausible detection counts as failed, so that the robot is not sent to it.

    Args:
        number: of the request.
        answer: None if there was none.
        place: returns a detection in charger_base.
    """
    if answer is None:
        return TaskReply(number, End.LOST)
    if not answer.success:
        return TaskReply(number, End.FAILED, message=cut(answer.message))
    try:
        detection = place(answer.detection)
        if problem := far(_numbers(detection.pose.pose.position)):
            return TaskReply(number, End.FAILED, message=f"the detection's place: {problem}")
        return TaskReply(number, End.DONE, electrodes=seen(detection, age=0.0))
    except ValueError as error:
        return TaskReply(number, End.FAILED, message=str(error))


def _suggested_base(pose: Any) -> BasePose | None:
    """Return a suggested pose; None if it is not finite or implausibly far."""
    point, turn = _numbers(pose.position), pose.orientation
    yaw, _ = lean(rotation(turn.x, turn.y, turn.z, turn.w))
    return BasePose(*point, yaw) if not far(point) and math.isfinite(yaw) else None


def read_state(message: Any) -> DockingReport | None:
    """Return the content of docking_state; None if its state is invalid."""
    if message.state not in set(State):
        return None
    return DockingReport(State(message.state), message.docked, message.charging)


def unknown_dock(frame_id: str = END_EFFECTOR, energy: float = 0.0) -> Any:
    """Return the result of a docking of which none is known: measurements are NaN; J of earlier ones."""
    return Dock.Result(
        energy=energy,
        misalignment=unknown_misalignment(frame_id),
        contact_current=math.nan,
        contact_force=math.nan,
        contact_force_min=math.nan,
        contact_force_max=math.nan,
        charge_current=math.nan,
        charge_voltage=math.nan,
    )


def in_frame(message: PoseStamped, frame: str, there: Pose) -> PoseStamped:
    """Return a pose in the frame named `frame`; `there` is the pose of its own frame in that one."""
    point, turn = message.pose.position, message.pose.orientation
    moved = PoseStamped()
    moved.header.frame_id = frame
    pose = composed(there, (point.x, point.y, point.z, turn.x, turn.y, turn.z, turn.w))
    point, turn = moved.pose.position, moved.pose.orientation
    point.x, point.y, point.z, turn.x, turn.y, turn.z, turn.w = pose
    return moved


def goal(request: Any, electrodes: Sequence[float] | None, target: PoseStamped | None = None) -> MissionGoal:
    """Return a ChargeRobot goal as plain values.

    Args:
        request: the message.
        electrodes: x, y (m) and yaw (rad) of the electrodes in the goal's target; None without navigation.
        target: transformed target, in place of the request's.

    Raises:
        Rejected: the target has no frame, or is not a pose on the ground of a site.
    """
    where = None
    if electrodes is not None:
        length = len(request.target.header.frame_id)
        if not 0 < length <= LONGEST:
            raise Rejected(f"target.header.frame_id has {length} characters: name the navigator's frame, such as map")
        here = place(target or request.target)
        if here is None:
            raise Rejected("the target's pose is not finite, or its quaternion is zero: send numbers")
        if problem := far((here.x, here.y), ON_MAP):
            raise Rejected(f"the target's place in {here.frame}: {problem}")
        where = here.at(*electrodes)
    stop_after = seconds(request.stop_after)
    return MissionGoal(where, request.stop_energy, stop_after, request.request_id, request.target_profile)


def place(message: PoseStamped) -> Place | None:
    """Return a pose as a place on the ground; None if it is not finite or its quaternion is zero."""
    point, turn = message.pose.position, message.pose.orientation
    length = math.hypot(turn.x, turn.y, turn.z, turn.w)
    if not (math.isfinite(point.x) and math.isfinite(point.y) and math.isfinite(length) and length > 0.0):
        return None
    x, y, z, w = (part / length for part in (turn.x, turn.y, turn.z, turn.w))
    sine, cosine = w * z + x * y, 0.5 - y**2 - z**2
    return Place(point.x, point.y, math.atan2(sine, cosine), message.header.frame_id)


def fill_pose(message: PoseStamped, where: Place) -> None:
    """Write a place into a PoseStamped, except its stamp."""
    message.header.frame_id = where.frame
    message.pose.position.x, message.pose.position.y = where.x, where.y
    message.pose.orientation.z, message.pose.orientation.w = math.sin(0.5 * where.yaw), math.cos(0.5 * where.yaw)


def _numbers(point: Any) -> Vector:
    return point.x, point.y, point.z
