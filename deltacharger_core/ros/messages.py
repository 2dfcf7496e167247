# SPDX-License-Identifier: Apache-2.0
"""Conversions between ROS messages and plain values: durations, goals, feedback, results; unknown is NaN, never 0."""

import math
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from deltacharger.action import Dock
from deltacharger.msg import Misalignment
from std_msgs.msg import Header

from deltacharger_core.frames import END_EFFECTOR, lean, rotation
from deltacharger_core.ros.outcomes import Outcome, Pose, Progress

_AXES = ("horizontal", "vertical", "angle")
_CODES = (name for name in dir(type(Dock.Result)) if name.isupper() and "__" not in name and name[0] != "_")
CODES: dict[int, str] = {getattr(Dock.Result, name): name for name in _CODES}
"""Names of the result codes."""

_STATES = (name for name in dir(type(Dock.Feedback)) if name.startswith("STATE_"))
PHASES: dict[int, str] = {getattr(Dock.Feedback, name): name.removeprefix("STATE_").lower() for name in _STATES}
"""Names of the states, lower case."""


def fill_pose(message: Any, pose: Pose) -> None:
    """Write `pose` into a geometry_msgs/PoseStamped; its stamp stays 0, which is exempt from age checks."""
    message.header.frame_id = pose.frame_id
    message.pose.position.x = float(pose.x)
    message.pose.position.y = float(pose.y)
    message.pose.position.z = float(pose.z)
    message.pose.orientation.z = math.sin(0.5 * pose.roll)
    message.pose.orientation.w = math.cos(0.5 * pose.roll)


def duration(length: float) -> Duration:
    """Return a Duration message of `length` s."""
    whole = math.floor(length)
    return Duration(sec=int(whole), nanosec=min(round((length - whole) * 1e9), 999_999_999))


def seconds(message: Any) -> float:
    """Return a Duration message in s."""
    return float(message.sec) + 1e-9 * float(message.nanosec)


def to_result(kind: Any, outcome: Any, **details: Any) -> Any:
    """Return an action's result message from an outcome and further fields."""
    return kind.Result(
        success=outcome.success,
        error_code=int(outcome.code),
        error_message=outcome.notice if outcome.success else outcome.message,
        retriable=outcome.retriable,
        elapsed=duration(outcome.elapsed),
        **details,
    )


def to_progress(feedback: Any, elapsed: float) -> Progress:
    """Return a feedback message, received `elapsed` s after the goal was sent, as plain data."""
    misalignment = getattr(feedback, "misalignment", None)  # undock's feedback has no such fields
    return Progress(
        time=elapsed,
        phase=PHASES.get(feedback.state, f"state {feedback.state}"),
        z=feedback.z,
        contact_current=getattr(feedback, "contact_current", math.nan),
        charge_current=getattr(feedback, "charge_current", math.nan),
        alignments=getattr(feedback, "alignments", 0),
        waiting_for=getattr(feedback, "waiting_for", ""),
        **{axis: getattr(misalignment, axis, math.nan) for axis in _AXES},
    )


def to_outcome(action: str, result: Any) -> Outcome:
    """Return a result message of Dock, Undock or ChargeRobot as plain data."""
    return Outcome(
        action=action,
        success=result.success,
        error_code=result.error_code,
        error_name=CODES.get(result.error_code, "UNKNOWN"),
        error_message=result.error_message,
        retriable=result.retriable,
        elapsed=seconds(result.elapsed),
        details=_dock_details(result) if hasattr(result, "misalignment") else {},
    )


def _dock_details(result: Any) -> dict[str, Any]:
    forces = ("contact_current", "contact_force", "contact_force_min", "contact_force_max")
    numbers = (*forces, "charge_current", "energy", "charge_voltage")
    estimates = [name for axis in _AXES for name in (axis, f"{axis}_stddev")]
    return {
        "aligned": result.aligned,
        "alignments": result.alignments,
        **({"redockings": result.redockings} if hasattr(result, "redockings") else {}),
        "misalignment": {name: getattr(result.misalignment, name) for name in (*estimates, "sure", "in_range")},
        **{name: getattr(result, name) for name in numbers},
        "charge_end": result.charge_end,
        "suggested_base_pose": _base(result.suggested_base_pose),
    }


def _base(suggested: Any) -> dict[str, Any] | None:
    """Return the suggested robot pose: position (m) and yaw (rad) about +y of the frame; None = no suggestion."""
    frame, point, turn = suggested.header.frame_id, suggested.pose.position, suggested.pose.orientation
    if not frame:
        return None
    yaw, _ = lean(rotation(turn.x, turn.y, turn.z, turn.w))
    return {"frame_id": frame, "position": [point.x, point.y, point.z], "yaw": yaw}


def unknown(message: Any) -> Any:
    """Set every float of a message and its nested messages to NaN; return the message."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind in ("float", "double"):
            setattr(message, name, math.nan)
        elif isinstance(value, np.ndarray):
            value[:] = math.nan
        elif hasattr(value, "get_fields_and_field_types"):
            unknown(value)
    return message


def unknown_misalignment(frame: str = END_EFFECTOR) -> Misalignment:
    """Return a Misalignment message without any estimate."""
    return unknown(Misalignment(header=Header(frame_id=frame)))
