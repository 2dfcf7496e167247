# SPDX-License-Identifier: Apache-2.0
"""One record per docking, in spite of a failing disk, docking or recorder.

It keeps everything around an event, little from hours of charging, and never more than its limit.
"""

import errno
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from .docking_tapes import BEGAN, RECORDED, docking, in_order, measured, raw, readings, refused, result, state

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from deltacharger.msg import DockingState

from deltacharger_bringup.records.recording import docking_recorder, mcap_recording
from deltacharger_bringup.records.recording.folder import PARTIAL, RecordFolder
from deltacharger_bringup.records.replay import record, words
from deltacharger_core import mcap_file, texts
from deltacharger_docking.codes import Code, State

TILTED = "the target is rolled by 12.6°"


def recorder(folder: Path, max_bytes: int = 10**8) -> docking_recorder.DockingRecorder:
    about = {"version": "0", "scene": "tape", "namespace": "/a"}
    return docking_recorder.DockingRecorder(RecordFolder(folder, max_bytes), RECORDED, about)


def play(recorder: docking_recorder.DockingRecorder, messages: Iterable[mcap_file.Raw]) -> float:
    """Pass messages in recorded time, without waiting; return the time (s) after the last."""
    now = 0.0
    for message in messages:
        now = (message.received - BEGAN) * 1e-9
        recorder.take_message(now, message)
        recorder.tick(now, alive=True)
    return now


def finish(recorder: docking_recorder.DockingRecorder, now: float) -> None:
    """Advance the time until no record is open."""
    for step in range(20):
        recorder.tick(now + 0.5 * step, alive=True)


def only(folder: Path) -> Path:
    (path,) = folder.iterdir()
    return path


def test_a_refused_docking_is_one_file_that_includes_the_seconds_before_its_goal(tmp_path: Path) -> None:
    recording = recorder(tmp_path)
    message = f"{TILTED}: the electrodes would come too close to a short"
    now = play(recording, docking(measured(2.9, 12.6), *refused(Code.CRITICAL_ANGLE, message)))
    recording.take_result(result(Code.CRITICAL_ANGLE, message))
    finish(recording, now)
    assert only(tmp_path).name == "20261118T110641Z-r_1-CRITICAL_ANGLE.mcap"
    found = record.replay(only(tmp_path))
    assert found.is_complete
    assert found.outcome() == {"success": False, "code": 403, "name": "CRITICAL_ANGLE", "message": message}
    assert found.motion.arrays()["time"][0] == pytest.approx(-1.0, abs=0.02), "the tape began 1 s before the goal"
    assert [phase.state for phase in found.phases] == ["idle", "approach", "contact", "measure", "retract", "idle"]
    assert (found.about["request_id"], found.about["began"]) == ("r/1", str(BEGAN + 10**9))


def test_a_fault_while_charging_names_the_record(tmp_path: Path) -> None:
    recording = recorder(tmp_path)
    tape = docking(
        state(3.0, State.CHARGING, charging=True, docked=True),
        state(5.0, State.RETRACT, Code.NO_CONTACT, "contact was lost"),
        state(6.0, State.IDLE, Code.NO_CONTACT, "contact was lost"),
        until=6.0,
        current=5.0,
    )
    now = play(recording, tape)
    recording.take_result(result(Code.NONE))
    finish(recording, now)
    assert only(tmp_path).name.endswith("-NO_CONTACT.mcap")
    found = record.replay(only(tmp_path))
    assert found.outcome()["success"] is True
    assert found.afterwards() == {"success": False, "code": 302, "name": "NO_CONTACT", "message": "contact was lost"}
    assert "Charging was ended after 2.0 s by NO_CONTACT" in words.why(found)


def test_consecutive_dockings_are_two_records(tmp_path: Path) -> None:
    recording = recorder(tmp_path)
    first = docking(*refused(Code.NO_CONTACT, "nothing is there"), until=4.0)
    second = [
        mcap_file.Raw(each.topic, each.received + 4_200_000_000, each.published, each.data) for each in first[50:]
    ]
    finish(recording, play(recording, [*first, *second]))
    paths = sorted(tmp_path.iterdir())
    assert [path.name.split("-")[-1] for path in paths] == ["NO_CONTACT.mcap"] * 2
    first_, second_ = (record.replay(path) for path in paths)
    phases, expected = ([phase.state for phase in each.phases if phase.state != "idle"] for each in (second_, first_))
    assert phases == expected
    assert second_.began_ns - first_.began_ns == 4_200_000_000


def full(*_: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_ends_recording_and_keeps_written_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("deltacharger_bringup.records.recording.docking_recorder.flush", full)
        recording = recorder(tmp_path)
        play(recording, docking())
        assert ("No space left" in recording.problem, list(tmp_path.iterdir())) == (True, []), "full at the start"
    recording = recorder(tmp_path)
    play(recording, docking())
    monkeypatch.setattr(mcap_recording.McapWriter, "add", full)
    now = play(recording, [state(3.1, State.ALIGN), *readings(3.1, 3.5), state(3.6, State.RETRACT)])
    assert "No space left" in recording.problem
    monkeypatch.undo()
    finish(recording, play(recording, [state(now + 0.1, State.IDLE)]))
    assert only(tmp_path).name.endswith(PARTIAL)
    found = record.replay(only(tmp_path))
    assert (bool(found.recording.damage), found.phases[-1].state) == (True, "measure")


def test_a_recorder_that_is_killed_leaves_all_but_the_last_second(tmp_path: Path) -> None:
    """Its file is read while it writes: what a kill would lose is still in its memory."""
    recording = recorder(tmp_path)
    play(recording, docking(until=5.0))
    path = only(tmp_path)
    assert path.name.endswith(PARTIAL)
    found = record.replay(path)
    assert ("ends early" in found.recording.damage, found.outcome()["success"]) == (True, None)
    assert found.end > 3.9 - 1.1, "1 s at most is lost"
    assert "without an outcome" in words.why(found)


def test_a_record_that_reaches_its_limit_ends_and_the_next_docking_is_recorded(tmp_path: Path) -> None:
    recording = recorder(tmp_path, max_bytes=200_000)
    play(recording, docking())
    assert ("half of max_megabytes" in recording.problem, recording.path) == (True, None)
    assert 100_000 < only(tmp_path).stat().st_size < 120_000
    play(recording, [state(4.0, State.IDLE), state(6.0, State.APPROACH)])
    assert (recording.problem, recording.path is None) == ("", False)


def test_unreadable_messages_are_skipped_and_long_texts_are_cut(tmp_path: Path) -> None:
    """Foreign bytes on the recorded topics, and an id of a megabyte."""
    long = DockingState(state=int(State.APPROACH), request_id="x" * 1_000_000, error_message="y" * 1_000_000)
    for tape in (docking(state(3.0, State.IDLE)), [raw(0.0, "docking_state", long), state(0.1, State.IDLE)]):
        with tempfile.TemporaryDirectory(dir=tmp_path) as folder:
            recording = recorder(Path(folder))
            foreign = [each._replace(data=b"\xff" * 30) for each in tape if "docking_" in each.topic]
            finish(recording, play(recording, in_order([*tape, *foreign])))
            assert recording.problem == ""
            found = record.replay(only(Path(folder)))
            assert (found.is_complete, len(found.about["request_id"]) <= texts.REQUEST_ID_MAX) == (True, True)


def numbered(topic: str, number: int) -> mcap_file.Raw:
    return mcap_file.Raw(topic, number, number, b"x" * 100)


def numbers(messages: list[mcap_file.Raw]) -> list[int]:
    return [message.received for message in messages]


def test_hours_of_charging_are_thinned_and_the_seconds_around_an_event_are_complete() -> None:
    """At 5 messages a second; the gate assumes no rate."""
    tap, kept, lengths = docking_recorder.Gate(["state"]), list[mcap_file.Raw](), list[int]()
    tap.open()
    tap.rest(0.0)
    for number in range(36_000):
        kept += tap.offer(0.2 * number, numbered("servo", number))
        lengths += [len(kept)] if number in (17_999, 35_999) else []
    assert lengths[0] == pytest.approx(3600, rel=0.1), "one a second in the first hour"
    assert lengths[1] - lengths[0] < 1.2 * 3600 * 0.7, "3600 ln 2 in the second"
    tap.stir(7200.0)
    for number in range(36_000, 36_100):
        kept += tap.offer(0.2 * number, numbered("servo", number))
    around = [number for number in numbers(kept) if abs(0.2 * number - 7200.0) < docking_recorder.BEFORE - 0.2]
    assert around == list(range(around[0], around[-1] + 1))
    assert len(around) == pytest.approx(2 * (docking_recorder.BEFORE - 0.2) / 0.2, abs=2)


def test_a_docking_ends_if_its_node_ends_but_not_if_the_node_returns(tmp_path: Path) -> None:
    recording = recorder(tmp_path)
    now = play(recording, docking())
    for after, alive in (
        (1.0, False),
        (1.0 + 0.9 * docking_recorder.LOST_AFTER, True),
        (8.0, False),
        (7.9 + docking_recorder.LOST_AFTER, False),
    ):
        recording.tick(now + after, alive)
        assert recording.path is not None
    recording.tick(now + 8.0 + docking_recorder.LOST_AFTER, alive=False)
    assert only(tmp_path).name.endswith("-UNFINISHED.mcap")
