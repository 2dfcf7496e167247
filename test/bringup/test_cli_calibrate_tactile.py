# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate tactile`: its output, its files and its errors."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from pathlib import Path

import numpy as np
import pytest

from deltacharger_tactile.calibration.rig import TactileCalibration
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.generator import generate_continuous
from deltacharger_tactile.parameters import TactileParameters
from deltacharger_tactile.sensor import Rig

from . import command

NEAR = {"position_limit": 0.008, "angle_limit": math.radians(10.0)}


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    return command.run(capsys, "calibrate", "tactile", *words)


@pytest.fixture(scope="module")
def recorded() -> Dataset:
    return generate_continuous(rigs=(661,), count=60, seed=2, frames=12, threshold=0.25, **NEAR)


@pytest.fixture
def data(recorded: Dataset, tmp_path: Path) -> Path:
    recorded.save(tmp_path / "data.npz")
    return tmp_path / "data.npz"


def test_the_calibration_is_printed_and_written(
    capsys: pytest.CaptureFixture[str], data: Path, recorded: Dataset, tmp_path: Path
) -> None:
    out = tmp_path / "pads.yaml"
    code, text, err = run(capsys, "--data", data, "--out", out)
    assert code == 0, err
    assert f"wrote {out}" in err
    for word in (
        "60 of rig 661, simulated",
        "dead, reported",
        "spread",
        "load shift",
        "vertical error",
        "held out",
        "after",
    ):
        assert word in text
    assert max(map(len, text.splitlines())) <= 120
    made = TactileCalibration.load(out)
    assert np.array_equal(made.dead, recorded.dead[0])
    assert made.data == hashlib.sha256(data.read_bytes()).hexdigest()
    assert (made.rig, made.dockings, made.simulated) == (661, 60, True)
    true = Rig.draw(TactileParameters(), 661).gain[~made.dead]
    assert np.corrcoef(made.gain[~made.dead], true)[0, 1] > 0.7
    assert "data.npz" in out.read_text(encoding="utf-8")


def test_one_object_in_si_units(capsys: pytest.CaptureFixture[str], data: Path, tmp_path: Path) -> None:
    code, text, _ = run(capsys, "--data", data, "--out", tmp_path / "pads.yaml", "--json")
    assert code == 0
    found = json.loads(text)
    assert found["success"] is True
    assert found["written"] == str(tmp_path / "pads.yaml")
    assert (found["rig"], found["dockings"], found["simulated"]) == (661, 60, True)
    assert len(found["dead"]["reported"]) == 1
    assert found["dead"]["silent"] == found["dead"]["loud"] == found["dead"]["noisy"] == []
    assert 0.05 < found["gain"]["stddev"] < 0.25
    assert abs(found["bias"]["vertical"]["used"]) <= abs(found["bias"]["vertical"]["found"]) < 1e-3
    assert found["held_out"]["against_contact_pose"] is True
    assert found["held_out"]["rms"]["vertical"]["after"] < 1e-3
    assert found["tare"]["sessions"] == 5
    assert found["doubts"] == []


def test_doubts_are_reported(capsys: pytest.CaptureFixture[str], recorded: Dataset, data: Path, tmp_path: Path) -> None:
    broken = {name: np.array(getattr(recorded, name)) for name in ("right", "tare", "vertical")}
    broken["right"][:, 9, 0] = 1.5
    broken["tare"][recorded.session == 2, 1, 4, 4] += 0.6
    broken["vertical"] += 0.004
    rows = slice(0, 29)
    dataclasses.replace(
        recorded, **{name: broken.get(name, value)[rows] for name, value in vars(recorded).items() if name != "meta"}
    ).save(data)
    code, text, err = run(capsys, "--data", data, "--out", tmp_path / "pads.yaml", "--json", "--force")
    assert code == 0, err
    doubts = " ".join(json.loads(text)["doubts"])
    for word in ("29 dockings", "right row 4 column 4", "mounted askew"):
        assert word in doubts
        assert word in err
    assert json.loads(text)["dead"]["loud"] == [[1, 9, 0]]
    assert TactileCalibration.load(tmp_path / "pads.yaml").dead[1, 9, 0]
    broken["right"][:, 2] = 1.5
    dataclasses.replace(recorded, right=broken["right"]).save(data)
    code, _, err = run(capsys, "--data", data, "--out", tmp_path / "none.yaml")
    assert code == 2
    assert "on one pad" in err
    assert "replace the pad" in err


def test_data_of_several_rigs_need_the_option_rig(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data, out = tmp_path / "two.npz", tmp_path / "pads.yaml"
    generate_continuous(rigs=(5, 6), count=30, seed=2, frames=4, threshold=0.25, **NEAR).save(data)
    code, _, err = run(capsys, "--data", data, "--out", out)
    assert code == 2
    assert "5, 6; pick one with --rig" in err
    assert run(capsys, "--data", data, "--out", out, "--rig", 7)[0] == 2
    assert not out.exists()
    assert run(capsys, "--data", data, "--out", out, "--rig", 6)[0] == 0
    assert TactileCalibration.load(out).rig == 6


def test_nothing_is_overwritten_without_force(capsys: pytest.CaptureFixture[str], data: Path, tmp_path: Path) -> None:
    out = tmp_path / "pads.yaml"
    out.write_text("mine", encoding="utf-8")
    code, _, err = run(capsys, "--data", data, "--out", out)
    assert (code, out.read_text(encoding="utf-8")) == (2, "mine")
    assert "--force" in err
    assert run(capsys, "--data", data, "--out", out, "--force")[0] == 0
    assert TactileCalibration.load(out).rig == 661


def test_a_calibration_that_makes_estimates_worse_is_not_written(
    capsys: pytest.CaptureFixture[str], recorded: Dataset, data: Path, tmp_path: Path
) -> None:
    # The commanded poses are 3 mm off and the poses in contact are right: every correction is wrong.
    dataclasses.replace(recorded, vertical=recorded.vertical + 0.003).save(data)
    out = tmp_path / "pads.yaml"
    code, text, err = run(capsys, "--data", data, "--out", out, "--json")
    assert code == 1
    assert json.loads(text)["success"] is False
    assert "vertical gets worse" in err
    assert not out.exists()
    assert run(capsys, "--data", data, "--out", out, "--force")[0] == 0
    assert out.exists()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--out", "new.yaml"), "--data"),
        (("--data", "DATA"), "--out"),
        (("--data", "none.npz", "--out", "new.yaml"), "none.npz: there is no such file"),
        (("--data", "DATA", "--out", "no/folder.yaml"), "folder"),
        (("--data", "DATA", "--out", "."), "cannot be written"),
        (("--data", "DATA", "--out", "new.yaml", "--model", "DATA"), "model"),
        (("--data", "DATA", "--out", "new.yaml", "--model", "none.npz"), "none.npz"),
        (("--data", "DATA", "--out", "new.yaml", "--rig", "-1"), "--rig"),
        (("--data", "TEXT", "--out", "new.yaml"), "data set"),
        (("--data", "PAPER", "--out", "new.yaml"), "--threshold 0.25"),
        (("--data", "FEW", "--out", "new.yaml"), "in range"),
    ],
)
def test_wrong_input_ends_with_2_and_a_reason(
    capsys: pytest.CaptureFixture[str],
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    reason: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.npz").write_text("no", encoding="utf-8")
    generate_continuous(rigs=(1,), count=20, threshold=1.0).save(tmp_path / "paper.npz")
    generate_continuous(rigs=(1,), count=3, threshold=0.25).save(tmp_path / "few.npz")
    files = {"DATA": str(data), "TEXT": "text.npz", "PAPER": "paper.npz", "FEW": "few.npz"}
    code, out, err = run(capsys, *(files.get(word, word) for word in words), "--json")
    assert code == 2, err
    answer = json.loads(out)
    assert answer["success"] is False
    assert reason in answer["error"]
    assert not (tmp_path / "new.yaml").exists()
