# SPDX-License-Identifier: Apache-2.0
"""`deltacharger replay`: why a recorded docking ended, in text and numbers that a person can act on.

A recording whose messages have other fields than ours is refused by name; forces and heights use the charger's own
geometry, gravity and servos, live and in a record.
"""

import os
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from .docking_tapes import NAMES, RECORDED, decision, docking, measured, raw, readings, refused, result, state, write

pytest.importorskip("mcap", reason="replays with deltacharger[record]")

from deltacharger.msg import DockingState, ServoState
from rclpy.serialization import serialize_message

from deltacharger_bringup.records.node_parameters import with_geometry
from deltacharger_bringup.records.recording import mcap_recording
from deltacharger_bringup.records.recording.mcap_recording import McapWriter
from deltacharger_bringup.records.replay import record, words
from deltacharger_core import machine, mcap_file
from deltacharger_docking.codes import Code, State
from deltacharger_kinematics import geometry, scalar

from ..bringup.command import Capture, answer, refuses

pytestmark = pytest.mark.ros

TILTED = "the target is rolled by 12.6°: the electrodes would come too close to a short; level the target"


CHARGE = (
    measured(2.8, 3.0, vertical=1e-3),
    decision(2.8, State.MEASURE, "verdict", "safe", clearance_m=0.0041),
    decision(2.9, State.MEASURE, "aligned", "within the tolerance", x_m=0.0, y_m=1e-3),
    state(3.0, State.CHARGING, charging=True, docked=True),
)


@pytest.fixture(scope="module")
def tapes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a docking that was refused as tilted, and one that charged for 5 s and was undocked."""
    folder = tmp_path_factory.mktemp("tapes")
    tape = docking(measured(2.7, 12.5), measured(2.9, 12.7), *refused(Code.CRITICAL_ANGLE, TILTED), until=4.0)
    write(folder / "tilted.mcap", tape, result(Code.CRITICAL_ANGLE, TILTED))
    undocked = (state(8.0, State.RETRACT, docked=True), state(9.0, State.IDLE))
    tape = docking(*CHARGE, *readings(3.0, 8.0, 5.0), *undocked)
    write(folder / "charged.mcap", tape, result(Code.NONE, contact_current=0.45, contact_force=17.2))
    return folder


@pytest.fixture(scope="module")
def tilted(tapes: Path) -> Path:
    return tapes / "tilted.mcap"


def has(text: str, *nouns: str) -> None:
    assert [noun for noun in nouns if noun not in text] == [], text


def test_a_critical_angle_is_explained_by_the_remaining_clearance(tilted: Path, tmp_path: Path) -> None:
    has(
        words.why(record.replay(tilted)),
        "12.6° ± 0.3°",
        "two contacts",
        "−0.3 mm",
        "Level the target",
        "home again at 3.0 s",
    )
    tape = docking(measured(2.7, 10.6), measured(2.9, 10.6), *refused(Code.CRITICAL_ANGLE, "tilted by 10.6°"))
    has(words.why(record.replay(write(tmp_path / "a.mcap", tape))), "0.9 mm, 0.3 mm after", "3 standard deviations")
    light = decision(2.2, State.CONTACT, "touched", "the touch is too light for an estimate", angle_rad=0.3)
    touched = decision(2.4, State.CONTACT, "touched", "the first touch gives an estimate", angle_rad=0.22)
    found = record.replay(
        write(tmp_path / "touch.mcap", docking(light, touched, *refused(Code.CRITICAL_ANGLE, TILTED)))
    )
    has(words.why(found), "the angle was measured as 12.6°")
    assert [(touch.contact, touch.estimate.sure) for touch in found.touches] == [(1, True)]
    tape = [state(0.0, State.IDLE), *readings(0.0, 2.0), *refused(Code.CRITICAL_ANGLE, "the roll is 17.2°", at=1.0)]
    has(words.why(record.replay(write(tmp_path / "given.mcap", tape))), "before anything was measured", "17.2°")


@pytest.mark.parametrize(
    ("code", "message", "nouns"),
    [
        (Code.STUCK, "the magnets held against 2.8 A", ("STUCK", "by hand")),
        (Code.MISALIGNED, "after 15 alignments", ("after 15 alignments", "1.0 mm ± 0.1 mm", "4.1 mm of clearance")),
        (Code.ESTIMATE_UNSURE, "it stayed unsure", ("0 of 1 measurements", "Check pads and target")),
    ],
)
def test_every_ending_is_explained_with_a_remedy(
    tmp_path: Path, code: Code, message: str, nouns: tuple[str, ...]
) -> None:
    verdict = decision(2.8, State.MEASURE, "verdict", "too close", clearance_m=0.0041)
    tape = docking(measured(2.8, 3.0, vertical=1e-3), verdict, *refused(code, message))
    has(
        words.why(record.replay(write(tmp_path / "a.mcap", tape, result(code, message)))), *nouns, "home again at 3.0 s"
    )


def test_a_docking_that_charged_is_described_with_numbers(tapes: Path) -> None:
    numbers = ("in 3.0 s", "0.45 A", "17.2 N", "0.0 mm, 1.0 mm and 3.0°", "4.1 mm of clearance", "5.0 s", "5.00 A")
    has(words.why(record.replay(tapes / "charged.mcap")), "Docked and charging", *numbers, "undocked")


def test_the_story_is_in_order_with_every_state_and_decision(tilted: Path, capsys: Capture) -> None:
    found = record.replay(tilted)
    lines = words.story(found)
    assert [line.split()[2].strip(",:") for line in lines] == [
        *("idle", "accepted", "approach", "contact", "contact", "measure", "measured", "measured"),
        *("interrupted", "retract", "retracted", "idle"),
    ]
    code, told = answer(capsys, "replay", tilted)
    assert (code, told["story"], told["why"]) == (0, lines, words.why(found))
    assert told["outcome"] == {"success": False, "code": 403, "name": "CRITICAL_ANGLE", "message": TILTED}
    assert told["measurements"][1]["angle"] == pytest.approx(0.2217, abs=1e-4)
    assert "misalignment" in told["dropped"]["missing"]


def test_a_folder_is_listed(tapes: Path, tmp_path: Path, capsys: Capture) -> None:
    for name in ("tilted.mcap", "charged.mcap"):
        shutil.copy(tapes / name, tmp_path)
    (tmp_path / "bad.mcap").write_bytes(b"no")
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "link.mcap").symlink_to("tilted.mcap")
    (tmp_path / "notes.txt").write_text("not listed")
    (tmp_path / "bag.db3").write_bytes(b"SQLite format 3\0")
    states = {NAMES["docking_state"]: RECORDED[NAMES["docking_state"]]}
    with McapWriter((tmp_path / "bag.mcap").open("wb"), states) as writer:  # as `ros2 bag record` would
        writer.add(state(0.0, State.IDLE))
    code, found = answer(capsys, "replay", tmp_path)
    records = {each["file"]: each for each in found["records"]}
    assert (code, set(records)) == (0, {path.name for path in tmp_path.iterdir()} - {"notes.txt"})
    assert ("rosbags-convert" in records["bag.db3"]["problem"], records["bag.mcap"]["outcome"]) == (True, "")
    assert ("pipe" in records["pipe.mcap"]["problem"], "MCAP" in records["bad.mcap"]["problem"]) == (True, True)
    assert records["tilted.mcap"]["request_id"] == "r/1"
    assert records["tilted.mcap"]["duration"] == pytest.approx(4.0, abs=0.1)


def test_two_chargers_in_one_recording_need_a_namespace(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "two.mcap"
    topics = dict.fromkeys(("/left/docking_state", "/right/docking_state"), RECORDED[NAMES["docking_state"]])
    with McapWriter(path.open("wb"), topics) as writer:
        for topic, code in zip(topics, (302, 305), strict=True):
            for time, state_message in ((1, DockingState(state=2)), (2, DockingState(state=0, error_code=code))):
                writer.add(mcap_file.Raw(topic, time * 10**9, time * 10**9, serialize_message(state_message)))
    refuses(capsys, f"replay {path}", "--namespace")
    assert record.replay(path, "right").outcome()["name"] == "STUCK"


@pytest.mark.parametrize(
    ("topic", "old", "new"),
    [
        ("charger_power", "float32 charge_current", "float64 charge_current"),
        ("dock/_action/feedback", "feedback\n", "feedback\nbool gone\n"),
        ("servo_state", "string frame_id", "# string frame_id"),
    ],
)
def test_a_recording_of_messages_with_other_fields_is_refused_by_name(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch, topic: str, old: str, new: str
) -> None:
    kind, schema_text = RECORDED[NAMES[topic]].kind, mcap_recording.schema_text
    with monkeypatch.context() as patch:
        other = schema_text(kind).replace(old, new)
        assert other != schema_text(kind)
        patch.setattr(mcap_recording, "schema_text", lambda each: other if each is kind else schema_text(each))
        path = write(tmp_path / "a.mcap", docking(*refused(Code.NO_CONTACT, "nothing is there")))
    for command in ("replay", "view --save a.rrd --recording") if find_spec("rerun") else ("replay",):
        refuses(capsys, f"{command} {path}", f"{NAMES[topic]} has other fields")


LIMBS = (geometry.LimbAdjustment(arm=0.101), geometry.LimbAdjustment(angle_offset=0.05), geometry.LimbAdjustment())
CALIBRATED = geometry.DeltaGeometry(arm=0.103, limbs=LIMBS)
TURNED = {"gravity": (0.0, -6.0, 7.76), "torque_constant": 1.1}
PLACE, PUSH = (0.004, -0.003, 0.07), 12.0  # m, N


def pushing() -> ServoState:
    """Return servo_state of that charger while it pushes at that place."""
    delta = scalar.ScalarDelta(CALIBRATED)
    held = delta.holding_torque(*PLACE, TURNED["gravity"])
    lever = delta.jacobian(*PLACE)[6:9]
    message = ServoState(name=list(machine.JOINTS), valid=[True] * 3)
    message.position = list(delta.inverse(*PLACE))
    message.current = [(hold + PUSH * each) / TURNED["torque_constant"] for hold, each in zip(held, lever, strict=True)]
    return message


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, Any]:
    """docking_node's parameters; the geometry is in its file only."""
    geometry.save_geometry(CALIBRATED, tmp_path / "arm.yaml")
    return {
        **TURNED,
        "geometry_file": str(tmp_path / "arm.yaml"),
        "start_type_description_service": True,
    }


@pytest.mark.parametrize("own", [True, False])
def test_a_record_is_replayed_with_its_own_settings(tmp_path: Path, settings: dict[str, Any], own: bool) -> None:
    tape = [*docking(until=0.0), *(raw(2.6 + 0.01 * step, "servo_state", pushing()) for step in range(50))]
    path = write(tmp_path / "a.mcap", tape, parameters=with_geometry(settings) if own else {})
    Path(settings["geometry_file"]).unlink()  # on another computer
    motion = record.replay(path).motion.arrays()
    assert len(motion["z"]) == 50
    right = [motion["z"][-1] == pytest.approx(PLACE[2], abs=1e-9), motion["force"][-1] == pytest.approx(PUSH, abs=1e-6)]
    assert right == [own, own]
