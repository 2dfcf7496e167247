# SPDX-License-Identifier: Apache-2.0
"""`deltacharger replay`: why a recorded docking ended, in text and numbers that a person can act on."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import pytest

from .docking_tapes import KINDS, NAMES, decision, docking, measured, readings, refused, result, state, write

pytest.importorskip("mcap", reason="replays with deltacharger[record]")

from deltacharger.msg import DockingState, ServoState
from rclpy.serialization import serialize_message

from deltacharger_bringup.cli.main import main
from deltacharger_core.mcap_file import Raw
from deltacharger_docking.codes import Code, State
from deltacharger_records.quantities import numbers
from deltacharger_records.recording import mcap_recording
from deltacharger_records.recording.mcap_recording import McapWriter
from deltacharger_records.replay.record import replay
from deltacharger_records.replay.words import story, why

pytestmark = pytest.mark.ros

PNG = b"\x89PNG"
TILTED = (
    "the target is rolled by 12.6°: the electrodes would come too close to a short; level the target or the charger"
)


def tilted(path: Path) -> Path:
    tape = docking(measured(2.7, 12.5), measured(2.9, 12.7), *refused(Code.CRITICAL_ANGLE, TILTED), until=4.0)
    return write(path / "tilted.mcap", tape, result(Code.CRITICAL_ANGLE, TILTED))


def charged(path: Path, seconds: float = 5.0) -> Path:
    """Dock, charge for some seconds and undock."""
    end = 3.0 + seconds
    tape = docking(
        measured(2.8, 3.0, vertical=1e-3),
        decision(
            2.8, State.MEASURE, "verdict", "safe at clearance_sigmas_sure standard deviations", clearance_m=0.0041
        ),
        decision(2.9, State.MEASURE, "aligned", "the target lies within the tolerance", x_m=0.0, y_m=1e-3),
        state(3.0, State.CHARGING, charging=True, docked=True),
        *readings(3.0, end, 5.0, rate=min(100.0, 3000.0 / seconds)),
        state(end, State.RETRACT, docked=True),
        state(end + 1.0, State.IDLE),
    )
    return write(path / "charged.mcap", tape, result(Code.NONE, contact_current=0.45, contact_force=17.2))


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = main(["replay", *words])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_a_critical_angle_is_explained_by_the_remaining_clearance(tmp_path: Path) -> None:
    assert why(replay(tilted(tmp_path))) == (
        "Charging was refused: the angle was measured as 12.6° ± 0.3° in two contacts; even without an offset across "
        "the bars the clearance would be −0.3 mm, 0.3 mm are needed. Level the target or the charger. The arm was home "
        "again at 3.0 s."
    )


def test_an_angle_that_is_critical_only_with_its_error_is_explained_by_the_error(tmp_path: Path) -> None:
    tape = docking(measured(2.7, 10.6), measured(2.9, 10.6), *refused(Code.CRITICAL_ANGLE, "tilted by 10.6°"))
    text = why(replay(write(tmp_path / "a.mcap", tape)))
    assert "the clearance would be 0.9 mm, 0.3 mm after subtracting 3 standard deviations; 0.3 mm are needed" in text


def test_a_given_roll_is_refused_before_any_contact(tmp_path: Path) -> None:
    tape = [state(0.0, State.IDLE), *readings(0.0, 2.0), *refused(Code.CRITICAL_ANGLE, "the roll is 17.2°", at=1.0)]
    assert "refused: before anything was touched, the roll is 17.2°." in why(replay(write(tmp_path / "a.mcap", tape)))


@pytest.mark.parametrize(
    ("code", "message", "parts"),
    [
        (
            Code.ELECTRODES_NOT_FOUND,
            "no electrodes were found: dark",
            ["in MEASURE by ELECTRODES_NOT_FOUND", "dark", "Move"],
        ),
        (Code.CANCELED, "cancelled by the client", ["The client canceled the goal in MEASURE after 2.0 s."]),
        (Code.STUCK, "the magnets held against 2.8 A", ["STUCK", "free the target by hand"]),
        (
            Code.MISALIGNED,
            "after 15 alignments",
            ["refused: after 15 alignments", "1.0 mm ± 0.1 mm", "4.1 mm of clearance"],
        ),
        (Code.ESTIMATE_UNSURE, "it stayed unsure", ["0 of 1 measurements were unsure", "Check pads and target"]),
        (Code.TACTILE_STALE, "frames stopped", ["TACTILE_STALE: frames stopped.", "Check the board's cable"]),
        (Code.INTERNAL, "internal error", ["in MEASURE by INTERNAL: internal error."]),
    ],
)
def test_every_ending_is_explained_with_a_remedy(tmp_path: Path, code: Code, message: str, parts: list[str]) -> None:
    verdict = decision(2.8, State.MEASURE, "verdict", "too close", clearance_m=0.0041)
    tape = docking(measured(2.8, 3.0, vertical=1e-3), verdict, *refused(code, message))
    text = why(replay(write(tmp_path / "a.mcap", tape, result(code, message))))
    assert [part for part in parts if part not in text] == [], text
    assert text.endswith("The arm was home again at 3.0 s.")


def test_a_docking_that_charged_is_described_with_numbers(tmp_path: Path) -> None:
    text = why(replay(charged(tmp_path)))
    assert text == (
        "Docked and charging in 3.0 s; the electrodes rest with 0.45 A of contact current, 17.2 N; the target lies "
        "0.0 mm, 1.0 mm and 3.0° off, which leaves 4.1 mm of clearance. It charged for 5.0 s at up to 5.00 A. Then it "
        "was undocked."
    )


def test_the_story_is_in_order_with_every_state_and_decision(tmp_path: Path) -> None:
    found = replay(tilted(tmp_path))
    lines = story(found)
    assert len(lines) == len(found.phases) + len(found.run.decisions)
    kinds = [line.split()[2].strip(",:") for line in lines]
    assert kinds == [
        *("idle", "accepted", "approach", "contact", "contact", "measure", "measured", "measured"),
        *("interrupted", "retract", "retracted", "idle"),
    ]
    numbers_text = "angle 12.5° ± 0.3°, vertical 0.0 mm ± 0.1 mm, horizontal 0.0 mm ± 1.0 mm, across 0.0 mm ± 0.1 mm"
    assert f"measured: sure ({numbers_text})" in lines[6]


def test_numbers_have_the_unit_of_their_name() -> None:
    values = {"angle_rad": 0.1, "x_m": -0.00125, "share": 0.036467, "margin_3_sigma_m": 0.005, "v_V": float("inf")}
    assert numbers(values) == "angle 5.7°, x −1.2 mm, share 0.0365, margin at 3σ 5.0 mm, v infinite"
    stiffness = {"estimated_Nm_per_rad": 17.284, "configured_Nm_per_rad": 15.0}
    assert numbers(stiffness) == "estimated 17.3 N·m/rad, configured 15.0 N·m/rad"


def test_json_contains_everything(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, str(tilted(tmp_path)), "--json")
    found = json.loads(out)
    assert code == 0
    assert found["outcome"] == {"success": False, "code": 403, "name": "CRITICAL_ANGLE", "message": TILTED}
    assert [phase["state"] for phase in found["phases"]] == [
        "idle",
        "approach",
        "contact",
        "measure",
        "retract",
        "idle",
    ]
    assert found["decisions"][-1]["kind"] == "retracted"
    assert found["measurements"][1]["angle"] == pytest.approx(0.2217, abs=1e-4)
    assert found["why"].startswith("Charging was refused")
    assert len(found["story"]) == 12
    assert "misalignment" in found["dropped"]["missing"]


def test_a_folder_is_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tilted(tmp_path)
    charged(tmp_path)
    (tmp_path / "bad.mcap").write_bytes(b"no")
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "link.mcap").symlink_to("tilted.mcap")
    (tmp_path / "notes.txt").write_text("not listed")
    code, out, _ = run(capsys, str(tmp_path), "--json")
    records = {each["file"]: each for each in json.loads(out)["records"]}
    assert code == 0
    assert set(records) == {"tilted.mcap", "charged.mcap", "bad.mcap", "pipe.mcap", "link.mcap"}
    assert "it is a pipe" in records["pipe.mcap"]["problem"]
    assert records["link.mcap"]["bytes"] == records["tilted.mcap"]["bytes"] > 0
    assert all(each["left_alone"] for each in records.values()), "none has the name that a recorder gives"
    assert records["tilted.mcap"]["request_id"] == "r/1"
    assert records["tilted.mcap"]["duration"] == pytest.approx(4.0, abs=0.1)
    assert "no MCAP" in records["bad.mcap"]["problem"]
    code, out, _ = run(capsys, str(tmp_path))
    assert len(out.splitlines()) == 5


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.999])
def test_a_truncated_record_is_read_up_to_its_end(tmp_path: Path, share: float) -> None:
    path = tmp_path / "a.mcap.partial"
    messages = docking(*refused(Code.NO_CONTACT, "nothing is there"), until=4.0)
    with path.open("wb") as stream:
        writer = mcap_recording.McapStream(stream, KINDS, live=True)
        for number, message in enumerate(messages):
            writer.add(message)
            if number % 50 == 0:
                writer.flush()
        writer.finish()
    whole = path.read_bytes()
    path.write_bytes(whole[: round(share * len(whole))])
    found = replay(path)
    assert found.recording.damage
    assert 0.0 < found.end <= 3.1
    assert why(found)


def test_a_damaged_record_is_read_up_to_the_damage(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = mcap_recording.McapStream(stream, KINDS, live=True)
        for number, message in enumerate(docking()):
            writer.add(message)
            if number % 50 == 0:
                writer.flush()
        writer.finish()
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 5000] = b"\xff" * 5000
    path.write_bytes(bytes(data))
    found = replay(path)
    assert "damaged from here on" in found.recording.damage or "ends early" in found.recording.damage
    assert found.outcome()["success"] is None


def test_a_recording_of_docking_state_alone_is_enough(tmp_path: Path) -> None:
    kinds = {NAMES["docking_state"]: DockingState}
    tape = docking(*refused(Code.NO_CONTACT, "nothing is there"))
    found = replay(write(tmp_path / "a.mcap", tape, kinds=kinds))
    assert found.outcome()["name"] == "NO_CONTACT"
    assert set(found.as_dict()["dropped"]["missing"]) == set(NAMES) - {"docking_state"}
    assert "302" not in why(found)


@pytest.mark.parametrize(
    ("make", "why_"),
    [
        (lambda path: path.write_bytes(b""), "is empty"),
        (lambda path: path.write_bytes(b"PNG and so on" * 100), "no MCAP file"),
        (lambda path: write(path, readings(0.0, 0.1), kinds={NAMES["servo_state"]: ServoState}), "no docking_state"),
        (lambda path: write(path, []), "has no readable docking_state: no messages"),
        (lambda path: None, "no such file"),
    ],
)
def test_wrong_input_ends_with_2_and_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make: Any, why_: str
) -> None:
    path = tmp_path / "a.mcap"
    make(path)
    code, out, err = run(capsys, str(path))
    assert (code, out) == (2, "")
    assert why_ in err
    code, out, _ = run(capsys, str(path), "--json")
    assert (code, json.loads(out)["success"]) == (2, False)


def test_two_chargers_in_one_recording_need_a_namespace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.mcap"
    kinds = {"/left/docking_state": DockingState, "/right/docking_state": DockingState}
    with McapWriter(path, kinds) as writer:
        for topic, code in (("/left/docking_state", 302), ("/right/docking_state", 305)):
            for time, state_message in ((1, DockingState(state=2)), (2, DockingState(state=0, error_code=code))):
                writer.add(Raw(topic, time * 10**9, time * 10**9, serialize_message(state_message)))
    code, _, err = run(capsys, str(path))
    assert code == 2
    assert "/left, /right: name one with --namespace" in err
    assert replay(path, "right").outcome()["name"] == "STUCK"


@pytest.mark.parametrize("tape", ["tilted", "charged", "hours", "states alone"])
def test_it_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str], tape: str) -> None:
    pytest.importorskip("matplotlib", reason="pictures need deltacharger[report]")
    path = {
        "tilted": lambda: tilted(tmp_path),
        "charged": lambda: charged(tmp_path),
        "hours": lambda: charged(tmp_path, 9000.0),
        "states alone": lambda: write(tmp_path / "s.mcap", docking(), kinds={NAMES["docking_state"]: DockingState}),
    }[tape]()
    picture = tmp_path / "run.png"
    assert run(capsys, str(path), "--picture", str(picture))[0] == 0
    assert picture.read_bytes()[:4] == PNG
    assert picture.stat().st_size > 20_000


def test_an_unwritable_picture_is_refused_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, str(tilted(tmp_path)), "--picture", str(tmp_path / "no" / "run.png"))
    assert code == 2
    assert "--picture" in err


def test_clearance_uses_the_offset_across_the_bars_and_older_records_derive_it_from_the_pose(
    tmp_path: Path,
) -> None:
    newer = measured(2.7, 6.0, vertical=2e-3, horizontal=4e-3)
    older = measured(2.7, 6.0, vertical=2e-3, horizontal=4e-3, without=("across_m", "across_stddev_m"))
    (new,), (old,) = (
        replay(write(tmp_path / f"{name}.mcap", docking(each, until=3.0))).run.touches
        for name, each in (("new", newer), ("old", older))
    )
    across = 2e-3 * math.cos(math.radians(6.0)) - 4e-3 * math.sin(math.radians(6.0))
    assert math.isnan(old.across)
    assert new.estimate.across == pytest.approx(across)
    assert old.estimate.across == pytest.approx(across)
    # The pads' own value is better than the pose's: a lean affects the pose's horizontal.
    assert new.estimate.across_stddev == pytest.approx(1e-4)
    assert old.estimate.across_stddev > new.estimate.across_stddev
