# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate tactile`: a rig's calibration, and its errors."""

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest

from deltacharger_sim.pads import Rig, generate_continuous
from deltacharger_tactile import dataset, parameters
from deltacharger_tactile.calibration.rig import TactileCalibration

from .command import Capture, answer, refuses, run

NEAR = {"position_limit": 0.008, "angle_limit": math.radians(10.0)}
CALIBRATE = ("calibrate", "tactile")


@pytest.fixture(scope="module")
def recorded() -> dataset.Dataset:
    return generate_continuous(rigs=(661,), count=40, seed=2, frames=6, threshold=0.25, **NEAR)


@pytest.fixture
def data(recorded: dataset.Dataset, tmp_path: Path) -> Path:
    recorded.save(tmp_path / "data.npz")
    return tmp_path / "data.npz"


@pytest.mark.rest
def test_the_calibration_is_printed_and_written(
    capsys: Capture, data: Path, recorded: dataset.Dataset, tmp_path: Path
) -> None:
    out = tmp_path / "pads.yaml"
    out.write_text("mine", encoding="utf-8")
    refuses(capsys, f"calibrate tactile --data {data} --out {out}", "--force")
    assert out.read_text(encoding="utf-8") == "mine"
    code, _, err = run(capsys, *CALIBRATE, "--data", data, "--out", out, "--force")
    assert (code, str(out) in err) == (0, True), err
    made = TactileCalibration.load(out)
    assert np.array_equal(made.dead, recorded.dead[0])
    assert made.data == hashlib.sha256(data.read_bytes()).hexdigest()
    assert (made.rig, made.dockings, made.simulated) == (661, 40, True)
    true = Rig.draw(parameters.TactileParameters(), 661).gain[~made.dead]
    assert np.corrcoef(made.gain[~made.dead], true)[0, 1] > 0.7
    code, found = answer(capsys, *CALIBRATE, "--data", data, "--out", out, "--force")
    assert (code, found["success"], found["written"], found["dockings"]) == (0, True, str(out), 40)
    assert found["doubts"] == []
    assert found["held_out"]["vertical"]["after"] < 1e-3


def test_data_of_several_rigs_need_the_option_rig(capsys: Capture, tmp_path: Path) -> None:
    generate_continuous(rigs=(5, 6), count=5, seed=2, frames=4, threshold=0.25, **NEAR).save(tmp_path / "two.npz")
    line = f"calibrate tactile --data {tmp_path}/two.npz --out {tmp_path}/pads.yaml"
    refuses(capsys, line, "--rig")
    refuses(capsys, f"{line} --rig 7", "5, 6")
    assert not (tmp_path / "pads.yaml").exists()


@pytest.mark.parametrize(
    ("count", "threshold", "more", "noun"),
    [(20, 1.0, "", "--threshold 0.25"), (3, 0.25, "", "in range"), (3, 0.25, "--model {data}", "model")],
)
def test_data_that_do_not_fit_are_refused(
    capsys: Capture, tmp_path: Path, count: int, threshold: float, more: str, noun: str
) -> None:
    data = tmp_path / "data.npz"
    generate_continuous(rigs=(1,), count=count, threshold=threshold).save(data)
    refuses(capsys, f"calibrate tactile --data {data} --out {tmp_path}/new.yaml {more.format(data=data)}", noun)
    assert not (tmp_path / "new.yaml").exists()
