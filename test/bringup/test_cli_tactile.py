# SPDX-License-Identifier: Apache-2.0
"""`deltacharger tactile`: from a simulated data set to an evaluated classifier, and its errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_tactile import MODEL_PATH

from .command import Capture, answer, refuses, run

pytestmark = pytest.mark.rest
"""Libraries of training and thousand dockings take seconds."""


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Data sets of the paper's protocol by their seed and rig."""
    folder, found = tmp_path_factory.mktemp("tactile"), {}
    for name, words in (("data", "--seed 3"), ("again", "--seed 3"), ("fresh", "--seed 9 --first-rig 9")):
        found[name] = folder / f"{name}.npz"
        assert main(["tactile", "generate", "--rigs", "1", *words.split(), "--out", str(found[name])]) == 0
    return found


def test_a_data_set_has_the_documented_fields_and_follows_from_its_seed(sets: dict[str, Path]) -> None:
    with np.load(sets["data"], allow_pickle=False) as file:
        assert file["left"].shape == file["right"].shape == (1100, 10, 10)
        assert file["tare"].shape == (1100, 2, 10, 10)
        for name in ("angle", "vertical", "horizontal", "current"):
            assert file[name].shape == (1100,)
        for name in ("attempt", "session", "rig", "subset"):
            assert np.issubdtype(file[name].dtype, np.integer)
        meta = json.loads(str(file["meta"]))
    assert (meta["protocol"], meta["seed"], meta["rigs"], bool(meta["parameters"]["sensor"])) == ("paper", 3, [0], True)
    with np.load(sets["data"]) as one, np.load(sets["again"]) as two, np.load(sets["fresh"]) as three:
        assert all(np.array_equal(one[name], two[name]) for name in one.files)
        assert not np.array_equal(one["left"], three["left"])


def test_a_classifier_is_trained_and_evaluated(sets: dict[str, Path], tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    data, fresh = sets["data"], sets["fresh"]
    train = ("tactile", "train", "--model", "lda", "--target", "vertical", "--data")
    model, referred = tmp_path / "model.npz", tmp_path / "referred.npz"
    assert answer(capsys, *train, data, "--out", model)[1]["n"] == 400
    code, found = answer(capsys, "tactile", "evaluate", "--data", fresh, "--model", model)
    assert (code, found["target"], found["n"], found["nominal"]) == (0, "vertical", 500, 0.95)
    assert found["accuracy"] > 0.8
    assert 0.0 < found["mean_absolute_error"] < 0.002
    assert all(0.0 <= found[name] <= 1.0 for name in ("coverage", "act_rate", "drift_rate"))
    code, out, err = run(capsys, "tactile", "evaluate", "--data", fresh, "--model", model)
    assert (code, "simulated" in out, "trained on" in err) == (0, True, False)
    assert f"{model} was trained on {data}" in run(capsys, "tactile", "evaluate", "--data", data, "--model", model)[2]

    assert run(capsys, *train, data, "--out", referred, "--reference", fresh)[0] == 0
    with np.load(model) as one, np.load(referred) as two:
        assert np.array_equal(one["weights"], two["weights"])
        assert not np.array_equal(one["bias"], two["bias"])
    refuses(capsys, f"{' '.join(train)} {data} --out {referred} --reference none.npz", "none.npz")

    for source, path in ((data, "foreign.npz"), (fresh, "other.npz")):  # of another program
        with np.load(source, allow_pickle=False) as file:
            np.savez(tmp_path / path, **{**{name: file[name] for name in file.files}, "meta": np.array("{}")})
    assert run(capsys, *train, tmp_path / "foreign.npz", "--out", model)[0] == 0
    assert "trained on" not in run(capsys, "tactile", "evaluate", "--data", tmp_path / "other.npz", "--model", model)[2]


def test_a_pose_estimator_is_trained_and_evaluated_on_different_rigs(tmp_path: Path, capsys: Capture) -> None:
    data, fresh, model = (tmp_path / name for name in ("data.npz", "fresh.npz", "pose.npz"))
    generate = ("tactile", "generate", "--protocol", "continuous", "--frames", 4)
    assert run(capsys, *generate, "--rigs", 6, "--dockings", 500, "--out", data)[0] == 0
    assert run(capsys, *generate, "--rigs", 2, "--first-rig", 50, "--dockings", 300, "--out", fresh)[0] == 0
    with np.load(fresh) as file:
        assert (len(file["angle"]), json.loads(str(file["meta"]))["frames"]) == (600, 4)
        assert file["angle"].min() < 0.0 < file["angle"].max()
    train = ("tactile", "train", "--data", data, "--model", "pose", "--target", "pose", "--out", model)
    assert answer(capsys, *train)[1]["n"] == 3000
    results = []
    for path in (model, MODEL_PATH):
        code, found = answer(capsys, "tactile", "evaluate", "--data", fresh, "--model", path)
        assert (code, found["target"], found["n"]) == (0, "pose", 600)
        results.append(found)
    for axis in ("angle", "vertical", "horizontal"):
        own, packaged = (result[axis] for result in results)
        assert packaged["mean_absolute_error"] < own["mean_absolute_error"] < 0.2
        assert packaged["coverage"] > 0.85
        assert {"target", "n", "accuracy", "nominal", "act_rate", "drift_rate"} <= set(own)


@pytest.mark.parametrize(
    ("line", "noun"),
    [
        ("tactile evaluate --data {data} --model {data}", "pose model"),
        (f"tactile evaluate --data {{data}} --model {MODEL_PATH}", "1 N"),
        ("tactile train --data {data} --model pose --target pose --out new.npz", "too few"),
    ],
)
def test_data_that_do_not_fit_are_refused(sets: dict[str, Path], capsys: Capture, line: str, noun: str) -> None:
    refuses(capsys, line, noun, data=sets["data"])
    assert not Path("new.npz").exists()
