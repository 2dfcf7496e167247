# SPDX-License-Identifier: Apache-2.0
"""`deltacharger tactile`: data sets, classifiers, and their errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_tactile import MODEL_PATH
from test.bringup.command import Capture, answer, refuses, run


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Data sets of the paper's protocol by their seed and rig."""
    folder, found = tmp_path_factory.mktemp("tactile"), {}
    for name, words in (("data", "--seed 3"), ("fresh", "--seed 9 --first-rig 9")):
        found[name] = folder / f"{name}.npz"
        assert main(["tactile", "generate", "--rigs", "1", *words.split(), "--out", str(found[name])]) == 0
    return found


@pytest.mark.rest
def test_a_classifier_is_trained_and_evaluated(sets: dict[str, Path], tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger-lab[train]")
    data, fresh = sets["data"], sets["fresh"]
    train = ("tactile", "train", "--model", "lda", "--target", "vertical", "--data")
    model = tmp_path / "model.npz"
    with np.load(data, allow_pickle=False) as file:
        meta = json.loads(str(file["meta"]))
    assert (meta["protocol"], meta["seed"], meta["rigs"], bool(meta["parameters"]["sensor"])) == ("paper", 3, [0], True)
    assert answer(capsys, *train, data, "--out", model)[1]["n"] == 400
    code, found = answer(capsys, "tactile", "evaluate", "--data", fresh, "--model", model)
    assert (code, found["target"], found["n"], found["nominal"]) == (0, "vertical", 500, 0.95)
    assert found["accuracy"] > 0.8
    assert 0.0 < found["mean_absolute_error"] < 0.002
    assert all(0.0 <= found[name] <= 1.0 for name in ("coverage", "act_rate", "drift_rate"))
    code, out, err = run(capsys, "tactile", "evaluate", "--data", fresh, "--model", model)
    assert (code, "simulated" in out, "trained on" in err) == (0, True, False)
    assert f"{model} was trained on {data}" in run(capsys, "tactile", "evaluate", "--data", data, "--model", model)[2]

    refuses(capsys, f"{' '.join(train)} {data} --out {tmp_path}/new.npz --reference none.npz", "none.npz")


@pytest.mark.rest
@pytest.mark.parametrize(
    ("line", "noun"),
    [
        ("tactile evaluate --data {data} --model {data}", "pose model"),
        (f"tactile evaluate --data {{data}} --model {MODEL_PATH}", "1 N"),
        ("tactile train --data {data} --model pose --target pose --out new.npz", "too few"),
    ],
)
def test_sets_that_do_not_fit_are_refused(sets: dict[str, Path], capsys: Capture, line: str, noun: str) -> None:
    refuses(capsys, line, noun, data=sets["data"])
    assert not Path("new.npz").exists()
