# SPDX-License-Identifier: Apache-2.0
"""`python -m deltacharger_lab.training`: data sets, classifiers, and their errors."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_lab.training.__main__ import COMMANDS
from test.bringup.command import Capture, answer, refuses, run

ask, tell = partial(answer, commands=COMMANDS), partial(run, commands=COMMANDS)


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Data sets of the paper's protocol by their seed and rig."""
    folder, found = tmp_path_factory.mktemp("tactile"), {}
    for name, words in (("data", "--seed 3"), ("fresh", "--seed 9 --first-rig 9")):
        found[name] = folder / f"{name}.npz"
        assert main(["generate", "--rigs", "1", *words.split(), "--out", str(found[name])], COMMANDS) == 0
    return found


@pytest.mark.rest
def test_a_classifier_is_trained_and_evaluated(sets: dict[str, Path], tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger-lab[train]")
    data, fresh = sets["data"], sets["fresh"]
    train = ("train", "--model", "lda", "--target", "vertical", "--data")
    model = tmp_path / "model.npz"
    with np.load(data, allow_pickle=False) as file:
        meta = json.loads(str(file["meta"]))
    assert (meta["protocol"], meta["seed"], meta["rigs"], bool(meta["parameters"]["sensor"])) == ("paper", 3, [0], True)
    assert ask(capsys, *train, data, "--out", model)[1]["n"] == 400
    code, found = ask(capsys, "evaluate", "--data", fresh, "--model", model)
    assert (code, found["target"], found["n"], found["nominal"]) == (0, "vertical", 500, 0.95)
    assert found["accuracy"] > 0.8
    assert 0.0 < found["mean_absolute_error"] < 0.002
    assert all(0.0 <= found[name] <= 1.0 for name in ("coverage", "act_rate", "drift_rate"))
    code, out, err = tell(capsys, "evaluate", "--data", fresh, "--model", model)
    assert (code, "simulated" in out, "trained on" in err) == (0, True, False)
    err = tell(capsys, "evaluate", "--data", data, "--model", model)[2]
    assert f"{model} was trained on {data}" in err

    refuses(
        capsys, f"{' '.join(train)} {data} --out {tmp_path}/new.npz --reference none.npz", "none.npz", commands=COMMANDS
    )
