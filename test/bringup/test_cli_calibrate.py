# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate kinematics`: its output, its files and its errors."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration.calibrate import COUNT, Uncertainty, numbers, rms, with_numbers
from deltacharger_kinematics.calibration.data import Encoder, PoseRecording, plan
from deltacharger_kinematics.geometry import load_geometry

from .command import Capture, answer, refuses, run

NOMINAL = DeltaGeometry()
ARM = with_numbers(
    NOMINAL, numbers(NOMINAL) + np.random.default_rng(1).uniform(-1.0, 1.0, COUNT) * Uncertainty().tolerances
)
FIT = ("calibrate", "kinematics")


def record(path: Path, wrong: int | None = None) -> Path:
    """Write the measurements of an operator of ARM; row `wrong` is off by 3 mm."""
    random = np.random.default_rng(4)
    recording = PoseRecording(path, Encoder())
    for index, pose in enumerate(plan(NOMINAL)):
        ticks = np.round(Encoder().ticks(Delta(NOMINAL).inverse(pose.position).angles))
        x, y, z = Delta(ARM).forward(Encoder().angles(ticks)).position + random.normal(scale=5e-5, size=3)
        first, second, third = map(float, ticks)
        recording.append(pose, (first, second, third), (float(x) + 0.003 * (index == wrong), float(y), float(z)))
    return path


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recorded") / "measured.csv")


@pytest.mark.rest
def test_a_fit_reports_its_quality_and_writes_a_geometry(capsys: Capture, data: Path, tmp_path: Path) -> None:
    out = tmp_path / "arm.yaml"
    out.write_text("mine", encoding="utf-8")
    refuses(capsys, f"calibrate kinematics {data} --out {out}", "--force")
    assert out.read_text(encoding="utf-8") == "mine"
    code, _, err = run(capsys, *FIT, data, "--out", out, "--force")
    assert (code, str(out) in err) == (0, True), err
    geometry = load_geometry(out)
    box = np.random.default_rng(0).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (100, 3))
    angles = Delta(NOMINAL).inverse(box).angles
    assert rms(Delta(ARM).forward(angles).position - Delta(geometry).forward(angles).position) < 1e-4
    header = out.read_text(encoding="utf-8")
    digest = hashlib.sha256(data.read_bytes()).hexdigest()
    assert digest in header
    code, _, err = run(capsys, *FIT, data, "--nominal", out, "--out", tmp_path / "again.yaml")  # already fitted
    assert (code, "improve" in err, (tmp_path / "again.yaml").exists()) == (1, True, False)


@pytest.mark.rest
def test_an_outlier_is_named_and_the_geometry_is_not_written(capsys: Capture, tmp_path: Path) -> None:
    data, out = record(tmp_path / "measured.csv", wrong=10), tmp_path / "arm.yaml"
    code, found = answer(capsys, *FIT, data, "--out", out)
    assert (code, found["outliers"], out.exists()) == (1, [14], False)  # two comments and the header come first
    assert run(capsys, *FIT, data, "--out", out, "--force")[0] == 0
    assert "line 14: the other rows" in out.read_text(encoding="utf-8")
