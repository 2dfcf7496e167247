# SPDX-License-Identifier: Apache-2.0
"""Recordings made before a message got its last fields are replayed by the definitions in the file."""

from __future__ import annotations

import math
import re
from array import array
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from .docking_tapes import KINDS, NAMES, decision, docking, raw, refused, result, write

pytest.importorskip("mcap", reason="replays with deltacharger[record]")
pytest.importorskip("mcap_ros2", reason="replays older recordings with deltacharger[record]")

from builtin_interfaces.msg import Duration
from deltacharger.action import Dock
from deltacharger.msg import DockingState, Misalignment
from mcap_ros2._dynamic import serialize_dynamic

from deltacharger_core.mcap_file import Raw, RecordingError
from deltacharger_docking.codes import Code, State
from deltacharger_docking.parameters import DockingParameters
from deltacharger_records.recording import mcap_recording
from deltacharger_records.replay.file import Recording
from deltacharger_records.replay.older import fields, is_older, older_decoder
from deltacharger_records.replay.record import replay
from deltacharger_records.replay.words import story, why

pytestmark = pytest.mark.ros

FEEDBACK = "dock/_action/feedback"
WITHOUT_LEAN = """\
std_msgs/Header header
bool contact
bool sure
bool in_range
float64 angle
float64 angle_stddev
float64 vertical
float64 vertical_stddev
float64 horizontal
float64 horizontal_stddev
float32[] angle_probability
float32[] vertical_probability
float32[] horizontal_probability
float32 left_force
float32 right_force
string model
"""
"""Misalignment.msg before it had across, yaw and pitch."""
NEWER = ("across", "across_stddev", "yaw", "yaw_stddev", "pitch", "pitch_stddev")


def without(text: str, *names: str) -> str:
    """Return a schema without these fields."""
    return "\n".join(line for line in text.splitlines() if not set(line.partition("#")[0].split()[1:2]) & set(names))


def as_before(message: Any, text: str) -> bytes:
    """Return a message encoded by the definition in `text`, by other code than ours."""
    name = mcap_recording.type_name(type(message)).replace("_", "")
    plain = text.replace("Dock_", "Dock")
    return bytes(serialize_dynamic(name, plain)[name](_plain(message)))


def _plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return SimpleNamespace(**{name: _plain(getattr(value, name)) for name in value.get_fields_and_field_types()})
    return list(value) if isinstance(value, (np.ndarray, array)) else value


def older(path: Path, kind: Any, definition: str, *messages: Raw) -> Path:
    """Return a recording of a docking with the old definition of `kind`."""
    tape = [each for each in docking(*refused(Code.NO_CONTACT, "nothing is there")) if each.topic != NAMES[FEEDBACK]]
    with pytest.MonkeyPatch.context() as patch:
        own = mcap_recording.schema_text
        patch.setattr(mcap_recording, "schema_text", lambda each: definition if each is kind else own(each))
        return write(path, [*tape, *messages], result(Code.NO_CONTACT, "nothing is there"))


@pytest.mark.parametrize("lost", [["waiting_for"], ["waiting_for", "horizontal_stddev", "model"]])
def test_feedback_without_its_last_fields_is_replayed(tmp_path: Path, lost: list[str]) -> None:
    kind = KINDS[NAMES[FEEDBACK]]
    definition = without(mcap_recording.schema_text(kind), *lost)
    estimate = Misalignment(angle=0.02, vertical=0.001, horizontal=0.003, horizontal_stddev=0.5, sure=True)
    sent = Dock.Feedback(alignments=3, z=0.08, misalignment=estimate, elapsed=Duration(sec=7), waiting_for="nobody")
    message = raw(9.0, FEEDBACK, kind())._replace(data=as_before(kind(feedback=sent), definition))
    path = older(tmp_path / "a.mcap", kind, definition, message)
    assert not Recording(path).unreadable
    found: list[Any] = []
    recording = Recording(path)
    recording.read(lambda name, _, each: found.append(each.feedback) if name == FEEDBACK else None)
    assert not recording.damage
    (feedback,) = found
    assert (feedback.alignments, feedback.z, feedback.elapsed.sec, feedback.waiting_for) == (3, 0.08, 7, "")
    assert (feedback.misalignment.angle, feedback.misalignment.sure) == (0.02, True)
    stddev = feedback.misalignment.horizontal_stddev
    assert math.isnan(stddev) if "horizontal_stddev" in lost else stddev == 0.5
    assert replay(path).outcome()["name"] == "NO_CONTACT"


def test_cut_bytes_of_an_older_message_are_damage() -> None:
    definition = without(mcap_recording.schema_text(DockingState), "request_id")
    decode = older_decoder(definition, "deltacharger/msg/DockingState", DockingState)
    data = as_before(DockingState(state=3, error_message="nothing"), definition)
    assert decode(data).state == 3
    with pytest.raises(RecordingError, match="damaged from here on"):
        decode(data[: len(data) // 2])


def test_a_removed_field_or_another_type_is_not_an_older_message() -> None:
    now = fields(mcap_recording.schema_text(DockingState))
    assert is_older(now, now)
    for text in ("uint8 state\nfloat64 gone", "uint16 state"):
        assert not is_older(fields(text), now)
    assert not is_older({**now, "deltacharger/Gone": ["float64 x"]}, now)


def test_a_changed_definition_is_reported(tmp_path: Path) -> None:
    kind = KINDS[NAMES["charger_power"]]
    definition = mcap_recording.schema_text(kind).replace("float32 charge_current", "float64 charge_current")
    path = older(tmp_path / "a.mcap", kind, definition)
    assert "another definition" in Recording(path).unreadable["charger_power"]


def test_without_a_definition_in_the_file_messages_are_read_as_they_are_now(tmp_path: Path) -> None:
    path = older(tmp_path / "a.mcap", DockingState, "")
    assert replay(path).phases[1].state == "approach"


def before_lean(kind: Any) -> str:
    """Return the schema of a type that contains or is a Misalignment, with the old Misalignment."""
    head, *parts = re.split(r"(?m)^=+\nMSG: ", mcap_recording.schema_text(kind))
    if kind is Misalignment:
        head = WITHOUT_LEAN
    name = "deltacharger/Misalignment\n"
    parts = [name + WITHOUT_LEAN if part.startswith(name) else part for part in parts]
    return ("=" * 80 + "\nMSG: ").join([head, *parts])


def pose(**more: float) -> Misalignment:
    return Misalignment(angle=0.02, vertical=-0.001, contact=True, angle_probability=[0.25, 0.75], model="pose", **more)


def test_a_misalignment_recorded_without_lean_has_no_lean(tmp_path: Path) -> None:
    definition = before_lean(Misalignment)
    assert fields(definition) != fields(mcap_recording.schema_text(Misalignment))
    old = as_before(pose(yaw=0.3), definition)
    path = older(tmp_path / "a.mcap", Misalignment, definition, raw(2.2, "misalignment", pose())._replace(data=old))
    found: list[Misalignment] = []
    recording = Recording(path)
    assert not recording.unreadable
    recording.read(lambda name, _, each: found.append(each) if name == "misalignment" else None)
    assert not recording.damage
    (read,) = found
    assert (read.angle, read.vertical, read.contact, read.model) == (0.02, -0.001, True, "pose")
    assert list(read.angle_probability) == [0.25, 0.75]
    assert all(math.isnan(getattr(read, name)) for name in NEWER)


def test_feedback_without_lean_is_replayed(tmp_path: Path) -> None:
    kind = KINDS[NAMES[FEEDBACK]]
    definition = before_lean(kind)
    message = kind(feedback=Dock.Feedback(misalignment=pose(), waiting_for="nobody"))
    old = as_before(message, definition)
    path = older(tmp_path / "a.mcap", kind, definition, raw(9.0, FEEDBACK, kind())._replace(data=old))
    found: list[Any] = []
    Recording(path).read(lambda name, _, each: found.append(each.feedback) if name == FEEDBACK else None)
    (feedback,) = found
    assert (feedback.misalignment.angle, feedback.waiting_for) == (0.02, "nobody")
    assert all(math.isnan(getattr(feedback.misalignment, name)) for name in NEWER)


def test_a_record_with_names_of_an_earlier_version_is_replayed(tmp_path: Path) -> None:
    earlier = {"contact_speed": 0.01, "landing_sigmas": 3.0, "redockings_max": 2, "travel_speed": 0.2}
    again = decision(2.9, State.MEASURE, "redock", "docking begins again, 1 more times at most", code=302.0)
    tape = docking(again, *refused(Code.NO_CONTACT, "nothing is there"))
    # The first results of a docking told the alignments, and no redockings.
    path = write(
        tmp_path / "a.mcap", tape, result(Code.NO_CONTACT, "nothing is there", alignments=1), parameters=earlier
    )
    found = replay(path)
    assert found.parameters == DockingParameters(travel_speed=0.2)  # what has no parameter of its name has no effect
    assert found.outcome()["name"] == "NO_CONTACT"
    assert any("redock: docking begins again" in line for line in story(found))
    assert "nothing is there" in why(found)


def test_an_older_recording_is_shown_by_its_own_definitions(tmp_path: Path) -> None:
    from deltacharger_records.view.sources import ShownRecording

    old = as_before(pose(yaw=0.3), before_lean(Misalignment))
    message = raw(2.2, "misalignment", pose())._replace(data=old)
    path = older(tmp_path / "a.mcap", Misalignment, before_lean(Misalignment), message)
    found: list[Any] = []

    class Feed:
        def take(self, topic: str, received: int, decode: Any) -> None:
            found.extend([decode()] if topic == "misalignment" else [])

    ShownRecording(path).play(cast(Any, Feed()), lambda: False)
    (told,) = found
    assert (told.angle, told.vertical, told.model) == (0.02, -0.001, "pose")
    assert math.isnan(told.across)


def test_a_topic_that_was_defined_in_another_way_is_not_shown_and_named(tmp_path: Path) -> None:
    from deltacharger_records.view.sources import ShownRecording

    kind = KINDS[NAMES["charger_power"]]
    path = older(tmp_path / "a.mcap", kind, mcap_recording.schema_text(kind).replace("float32", "float64"))
    refusals: list[str] = []

    class Feed:
        def take(self, topic: str, received: int, decode: Any) -> None:
            if topic == "charger_power":
                with pytest.raises(ValueError, match="another definition"):
                    decode()
                refusals.append(topic)

    ShownRecording(path).play(cast(Any, Feed()), lambda: False)
    assert refusals
