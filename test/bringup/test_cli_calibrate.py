# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate kinematics`: its output, its files and its errors."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from deltacharger_core.parameters import from_mapping
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration.data import TICK, Encoder
from deltacharger_kinematics.calibration.plan import plan
from deltacharger_kinematics.calibration.problem import COUNT, Uncertainty, numbers, rms, with_numbers
from deltacharger_kinematics.calibration.recording import PoseRecording
from deltacharger_kinematics.geometry_file import load_geometry

from . import command

NOMINAL = DeltaGeometry()
ARM = with_numbers(
    NOMINAL, numbers(NOMINAL) + np.random.default_rng(1).uniform(-1.0, 1.0, COUNT) * Uncertainty().tolerances
)


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    return command.run(capsys, "calibrate", "kinematics", *words)


def record(path: Path, arm: DeltaGeometry = ARM, wrong: int | None = None) -> Path:
    """Write the measurements of an operator of `arm`; row `wrong` is off by 3 mm."""
    random = np.random.default_rng(4)
    recording = PoseRecording(path, Encoder())
    for index, pose in enumerate(plan(NOMINAL)):
        ticks = np.round(Encoder().ticks(Delta(NOMINAL).inverse(pose.position).angles))
        x, y, z = Delta(arm).forward(Encoder().angles(ticks)).position + random.normal(scale=5e-5, size=3)
        first, second, third = map(float, ticks)
        recording.append(pose, (first, second, third), (float(x) + 0.003 * (index == wrong), float(y), float(z)))
    return path


def test_a_fit_reports_its_quality_and_writes_a_geometry(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data, out = record(tmp_path / "measured.csv"), tmp_path / "arm.yaml"
    code, text, err = run(capsys, data, "--out", out)
    assert code == 0, err
    assert f"wrote {out}" in err
    lines = text.splitlines()
    assert [line.split()[0] for line in lines if line.startswith(("radius", "tang", "height", "arm", "rod", "angle"))]
    for word in ("limb 0", "held out", "expected", "scatter", "line ", "singular", "weakest"):
        assert word in text
    assert max(map(len, lines)) <= 120
    geometry = load_geometry(out)
    box = np.random.default_rng(0).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (100, 3))
    angles = Delta(NOMINAL).inverse(box).angles
    assert rms(Delta(ARM).forward(angles).position - Delta(geometry).forward(angles).position) < 1e-4
    header = out.read_text(encoding="utf-8")
    assert hashlib.sha256(data.read_bytes()).hexdigest() in header
    for word in ("measured.csv", "36 rows", "held out: 9", "zero_ticks 2048 2048 2048", "date: 20"):
        assert word in header


def test_one_object_in_si_units(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, text, err = run(capsys, record(tmp_path / "measured.csv"), "--json")
    assert (code, err) == (0, "")
    found = json.loads(text)
    assert found["success"] is True
    assert found["written"] is None
    assert (found["rows"], len(found["held_out"]["lines"]), len(found["singular_values"])) == (36, 9, 18)
    assert found["rms"]["after"] < 2e-4 < 1e-3 < found["rms"]["before"]
    assert found["held_out"]["after"] < 3e-4 < 1e-3 < found["held_out"]["before"]
    errors = [
        (row["fitted"] - true) / row["stddev"] for row, true in zip(found["parameters"], numbers(ARM), strict=True)
    ]
    assert max(map(abs, errors)) < 4.0
    assert len({(row["limb"], row["name"]) for row in found["parameters"]}) == COUNT
    assert from_mapping(found["geometry"], DeltaGeometry).limbs != NOMINAL.limbs


def test_without_force_no_file_is_overwritten(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data, out = record(tmp_path / "measured.csv"), tmp_path / "arm.yaml"
    out.write_text("mine", encoding="utf-8")
    code, _, err = run(capsys, data, "--out", out)
    assert (code, out.read_text(encoding="utf-8")) == (2, "mine")
    assert "--force" in err
    assert run(capsys, data, "--out", out, "--force")[0] == 0
    assert load_geometry(out).limbs != NOMINAL.limbs
    assert run(capsys, data, "--out", tmp_path / "no" / "folder.yaml")[0] == 2


def test_an_outlier_is_named_and_the_geometry_is_not_written(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data, out = record(tmp_path / "measured.csv", wrong=10), tmp_path / "arm.yaml"
    code, text, err = run(capsys, data, "--out", out, "--json")
    assert code == 1
    assert not out.exists()
    assert json.loads(text)["outliers"] == [14]  # two comments and the header come first
    assert "line 14: the other rows contradict" in err
    assert "was not written" in err
    assert run(capsys, data, "--out", out, "--force")[0] == 0
    assert "doubtful: line 14" in out.read_text(encoding="utf-8")


def test_a_fit_that_does_not_improve_held_out_rows_ends_with_1(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data, calibrated, out = record(tmp_path / "measured.csv"), tmp_path / "arm.yaml", tmp_path / "again.yaml"
    assert run(capsys, data, "--out", calibrated)[0] == 0
    code, _, err = run(capsys, data, "--nominal", calibrated, "--out", out)  # already fitted
    assert code == 1
    assert "does not improve" in err
    assert not out.exists()


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("no-such-file.csv",),
        ("DATA", "--nominal", "no-such-file.yaml"),
        ("DATA", "--measurement-mm", "0"),
        ("DATA", "--tolerance-mm", "nan"),
        ("DATA", "--tolerance-deg", "-1"),
        ("DATA", "--held-out", "0"),
        ("DATA", "--held-out", "1"),
        ("DATA", "--seed", "1.5"),
        ("DATA", "--zero-ticks", "1", "2"),
        ("DATA", "--zero-ticks", "2050", "2048", "2048"),
        ("DATA", "--direction", "1", "0", "1"),
        ("DATA", "--direction", "1", "1", "-1"),
        ("DATA", "--plan", "new.csv"),
        ("--measure", "new.csv"),
        ("DATA", "--measure", "new.csv", "--plan", "plan.csv"),
        ("--plan", "no-such-file.csv", "--measure", "new.csv"),
        ("--plan", "new.csv", "--direction", "1", "2", "1"),
        ("--plan", "no/such/folder.csv"),
        ("--plan", "DATA"),
    ],
)
def test_wrong_usage_ends_with_2_and_a_reason(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    data = str(record(tmp_path / "measured.csv"))
    code, out, err = run(capsys, *(data if word == "DATA" else word for word in words), "--json")
    assert code == 2, err
    assert json.loads(out)["success"] is False
    assert not (tmp_path / "new.csv").exists()


def test_a_bad_row_is_reported_with_file_and_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = record(tmp_path / "measured.csv")
    lines = data.read_text(encoding="utf-8").splitlines()
    lines[6] = lines[6].replace(",", ",x", 1)
    data.write_text("\n".join(lines), encoding="utf-8")
    code, out, err = run(capsys, data, "--json")
    assert code == 2
    result = json.loads(out)
    assert (result["file"], result["lines"]) == (str(data), [7])
    assert f"{data}: line 7: held_out" in err


def test_zero_ticks_shift_the_angles(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = record(tmp_path / "measured.csv")
    bare = "".join(line for line in data.read_text(encoding="utf-8").splitlines(True) if not line.startswith("#"))
    data.write_text(bare, encoding="utf-8")
    offsets = [
        [row["fitted"] for row in json.loads(run(capsys, data, "--json", *words)[1])["parameters"][5::6]]
        for words in ((), ("--zero-ticks", 2058, 2048, 2048))
    ]
    assert np.allclose(np.subtract(offsets[1], offsets[0]), [10 * TICK, 0.0, 0.0], atol=1e-4)


def test_a_plan_is_not_overwritten_without_force(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    code, out, _ = run(capsys, "--plan", path, "--json", "--zero-ticks", 2000, 2048, 2048)
    assert code == 0
    assert json.loads(out) == {"success": True, "written": str(path), "poses": 36, "held_out": 9}
    assert "# zero_ticks 2000 2048 2048\n" in path.read_text(encoding="utf-8")
    assert run(capsys, "--plan", path)[0] == 2
    assert run(capsys, "--plan", path, "--force")[0] == 0
