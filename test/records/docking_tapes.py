# SPDX-License-Identifier: Apache-2.0
"""Messages of invented dockings, for tests of recording and replay."""

import json
import math
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from deltacharger.action import Dock
from deltacharger.msg import ChargerPower, DockingDecision, DockingState, ServoState, TactileFrame
from rclpy.serialization import serialize_message

from deltacharger_bringup.records.recording import folder, mcap_recording
from deltacharger_core.mcap_file import Raw
from deltacharger_core.ros.messages import unknown_misalignment
from deltacharger_core.ros.outcomes import Outcome
from deltacharger_docking.codes import Code, State

BEGAN = 1_795_000_000 * 10**9  # ns since 1970
NAMES = {topic.name: f"/a/{topic.name}" for topic in mcap_recording.TOPICS}
RECORDED = {NAMES[topic.name]: topic for topic in mcap_recording.TOPICS}
MEASURED = (
    *("angle_rad", "angle_stddev_rad", "vertical_m", "vertical_stddev_m", "horizontal_m", "horizontal_stddev_m"),
    *("across_m", "across_stddev_m"),
)


def raw(seconds: float, name: str, message: Any) -> Raw:
    """Return a message as received `seconds` after the tape's beginning."""
    time = BEGAN + round(seconds * 1e9)
    return Raw(NAMES[name], time, time, serialize_message(message))


def state(
    seconds: float,
    state: State,
    code: Code = Code.NONE,
    message: str = "",
    charging: bool = False,
    docked: bool = False,
) -> Raw:
    """Return a docking_state."""
    sent = DockingState(state=int(state), docked=docked, charging=charging, error_code=int(code), request_id="r/1")
    sent.error_message = message
    return raw(seconds, "docking_state", sent)


def decision(seconds: float, state: State, kind: str, text: str = "", **values: float) -> Raw:
    """Return a docking_decision."""
    message = DockingDecision(request_id="r/1", state=int(state), kind=kind, text=text)
    message.names, message.values = list(values), list(values.values())
    return raw(seconds, "docking_decision", message)


def measured(seconds: float, angle: float, vertical: float = 0.0, horizontal: float = 0.0, sure: bool = True) -> Raw:
    """Return the decision with a measurement (degrees and m)."""
    turn = math.radians(angle)
    across = vertical * math.cos(turn) - horizontal * math.sin(turn)
    values = (turn, math.radians(0.3), vertical, 1e-4, horizontal, 1e-3, across, 1e-4)
    kept = dict(zip(MEASURED, values, strict=True))
    return decision(seconds, State.MEASURE, "measured", "sure" if sure else "unsure", **kept)


@cache
def readings(start: float, end: float, current: float = 0.0, rate: float = 25.0) -> tuple[Raw, ...]:
    """Return servo_state, tactile_frame, charger_power and feedback of an interval."""
    found: list[Raw] = []
    for step in range(round((end - start) * rate)):
        now = start + step / rate
        servo = ServoState(name=["limb_0_arm_joint", "limb_1_arm_joint", "limb_2_arm_joint"])
        servo.position, servo.current, servo.valid = [0.6] * 3, [0.4] * 3, [True] * 3
        frame = TactileFrame(sequence=step, rows=10, columns=10, pitch=4e-3, tared=True)
        frame.left = frame.right = [3.0] * 20 + [0.0] * 80
        found += [raw(now, "servo_state", servo), raw(now, "tactile_frame", frame)]
        if step % 5 == 0:
            power = ChargerPower(contactor_closed=current > 0, charge_current=current, target_voltage=24.0)
            feedback = Dock.Impl.FeedbackMessage(feedback=Dock.Feedback(contact_current=0.45, z=0.08))
            feedback.feedback.misalignment = unknown_misalignment()
            feedback.goal_id.uuid = [7] * 16
            found += [raw(now, "charger_power", power), raw(now, "dock/_action/feedback", feedback)]
    return tuple(found)


def docking(*after: Raw, until: float = 3.0, current: float = 0.0) -> list[Raw]:
    """Return a docking up to its first measurement, and the following messages."""
    before = [
        state(0.0, State.IDLE),
        decision(1.0, State.IDLE, "accepted", "electrodes as given", x_m=0.0, y_m=0.0, z_m=0.08),
        state(1.0, State.APPROACH),
        state(2.0, State.CONTACT),
        decision(2.5, State.CONTACT, "contact", "the electrodes rest on the target", contact_current_A=0.45),
        state(2.5, State.MEASURE),
    ]
    return in_order([*readings(0.0, until, current), *before, *after])


def in_order(messages: Iterable[Raw]) -> list[Raw]:
    """Return messages in order of reception."""
    return sorted(messages, key=lambda message: message.received)


def refused(code: Code, message: str, at: float = 3.0) -> list[Raw]:
    """Return the end of a docking that an error stops."""
    return [
        decision(at, State.MEASURE, "interrupted", f"{code.name}: {message}", code=float(code)),
        state(at, State.RETRACT, code, message),
        decision(at + 0.9, State.RETRACT, "retracted", "the arm is home", away_m=0.0),
        state(at + 1.0, State.IDLE, code, message),
    ]


def result(code: Code, message: str = "", elapsed: float = 3.0, **details: Any) -> Outcome:
    """Return the outcome sent to the client."""
    return Outcome("dock", code == Code.NONE, int(code), code.name, message, False, elapsed, details)


def write(
    path: Path,
    messages: Iterable[Raw],
    *results: Outcome,
    topics: Mapping[str, mcap_recording.Topic] = RECORDED,
    parameters: Mapping[str, Any] = MappingProxyType({}),
) -> Path:
    """Write a recording of messages."""
    about = {"version": "0", "scene": "tape", "namespace": "/a", "request_id": "r/1"}
    with mcap_recording.McapWriter(path.open("wb"), topics, [(folder.ABOUT, about)]) as writer:
        for message in messages:
            if message.topic in topics:
                writer.add(message)
        writer.add_metadata(folder.PARAMETERS, {name: json.dumps(value) for name, value in parameters.items()})
        for each in results:
            writer.add_metadata(folder.RESULT, {"action": each.action, "json": json.dumps(each.as_dict())})
    return path
