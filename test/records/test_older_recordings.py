# SPDX-License-Identifier: Apache-2.0
"""Recordings whose definitions differ from ours: later fields are missing, or a topic cannot be read and is named."""

from __future__ import annotations

import math
from array import array
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from .docking_tapes import KINDS, NAMES, docking, raw, refused, result, write

pytest.importorskip("mcap", reason="replays with deltacharger[record]")
pytest.importorskip("mcap_ros2", reason="replays older recordings with deltacharger[record]")

from deltacharger.msg import DockingState, Misalignment
from mcap_ros2._dynamic import serialize_dynamic

from deltacharger_core.mcap_file import RecordingError
from deltacharger_docking.codes import Code
from deltacharger_records.recording import mcap_recording
from deltacharger_records.replay.file import Recording
from deltacharger_records.replay.older import fields, is_older, older_decoder
from deltacharger_records.replay.record import replay
from deltacharger_records.view.sources import ShownRecording

pytestmark = pytest.mark.ros


def without(kind: Any, *names: str) -> str:
    """Return a schema without these fields."""
    lines = mcap_recording.schema_text(kind).splitlines()
    return "\n".join(line for line in lines if not set(line.partition("#")[0].split()[1:2]) & set(names))


def as_before(message: Any, text: str) -> bytes:
    """Return a message encoded by the definition in `text`, by other code than ours."""

    def plain(value: Any) -> Any:
        if hasattr(value, "get_fields_and_field_types"):
            return SimpleNamespace(**{name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()})
        return list(value) if isinstance(value, (np.ndarray, array)) else value

    name = mcap_recording.type_name(type(message))
    return bytes(serialize_dynamic(name, text)[name](plain(message)))


def older(path: Path, kind: Any, definition: str, *messages: Any) -> Path:
    """Return a recording of a docking with the old definition of `kind`."""
    with pytest.MonkeyPatch.context() as patch:
        own = mcap_recording.schema_text
        patch.setattr(mcap_recording, "schema_text", lambda each: definition if each is kind else own(each))
        tape = docking(*refused(Code.NO_CONTACT, "nothing is there"))
        return write(path, [*tape, *messages], result(Code.NO_CONTACT, "nothing is there"))


def test_a_message_without_its_last_fields_is_replayed_and_shown(tmp_path: Path) -> None:
    definition = without(Misalignment, "yaw", "pitch")
    sent = Misalignment(
        angle=0.02, vertical=-0.001, contact=True, angle_probability=[0.25, 0.75], model="pose", yaw=0.3
    )
    message = raw(9.0, "misalignment", sent)._replace(data=as_before(sent, definition))
    path, found = older(tmp_path / "a.mcap", Misalignment, definition, message), []
    recording = Recording(path)
    recording.read(lambda name, _, each: found.append(each) if name == "misalignment" else None)
    assert (recording.unreadable, recording.damage) == ({}, "")
    take = lambda topic, received, decode: found.extend([decode()] if topic == "misalignment" else [])  # noqa: E731
    ShownRecording(path).play(cast(Any, SimpleNamespace(take=take)), lambda: False)
    assert len(found) == 2
    for read in found:
        assert (read.angle, read.vertical, read.contact, read.model) == (0.02, -0.001, True, "pose")
        assert (list(read.angle_probability), math.isnan(read.yaw)) == ([0.25, 0.75], True)
    assert replay(path).outcome()["name"] == "NO_CONTACT"


def test_cut_bytes_of_an_older_message_are_damage() -> None:
    definition = without(DockingState, "request_id")
    decode = older_decoder(definition, "deltacharger/msg/DockingState", DockingState)
    data = as_before(DockingState(state=3, error_message="nothing"), definition)
    assert decode(data).state == 3
    with pytest.raises(RecordingError, match="damaged"):
        decode(data[: len(data) // 2])


def test_a_changed_definition_is_no_older_one_and_is_named(tmp_path: Path) -> None:
    now = fields(mcap_recording.schema_text(DockingState))
    assert is_older(now, now)
    for text in ("uint8 state\nfloat64 gone", "uint16 state"):
        assert not is_older(fields(text), now)
    assert not is_older({**now, "deltacharger/Gone": ["float64 x"]}, now)
    kind = KINDS[NAMES["charger_power"]]
    definition = mcap_recording.schema_text(kind).replace("float32 charge_current", "float64 charge_current")
    path = older(tmp_path / "a.mcap", kind, definition)
    assert "definition" in Recording(path).unreadable["charger_power"]
    refusals: list[str] = []

    def take(topic: str, received: int, decode: Any) -> None:
        if topic == "charger_power":
            with pytest.raises(ValueError, match="definition"):
                decode()
            refusals.append(topic)

    ShownRecording(path).play(cast(Any, SimpleNamespace(take=take)), lambda: False)
    assert refusals
    assert replay(older(tmp_path / "b.mcap", DockingState, "")).phases[1].state == "approach", "no definition: ours"
