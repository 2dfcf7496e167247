# SPDX-License-Identifier: Apache-2.0
"""`deltacharger tactile`: from a simulated data set to an evaluated classifier, and its errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_bringup.cli.output import DONE, WRONG_INPUT
from deltacharger_tactile import MODEL_PATH


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tactile") / "data.npz"
    assert main(["tactile", "generate", "--rigs", "1", "--seed", "3", "--out", str(path)]) == DONE
    return path


def answer(capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    return dict(json.loads(capsys.readouterr().out.splitlines()[-1]))


def test_a_data_set_has_the_documented_fields(data: Path) -> None:
    with np.load(data, allow_pickle=False) as file:
        assert file["left"].shape == file["right"].shape == (1100, 10, 10)
        assert file["tare"].shape == (1100, 2, 10, 10)
        for name in ("angle", "vertical", "horizontal", "current"):
            assert file[name].shape == (1100,)
        for name in ("attempt", "session", "rig", "subset"):
            assert np.issubdtype(file[name].dtype, np.integer)
        meta = json.loads(str(file["meta"]))
    assert (meta["protocol"], meta["seed"], meta["rigs"]) == ("paper", 3, [0])
    assert meta["parameters"]["sensor"]


def test_the_same_seed_makes_the_same_data(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    again, other = tmp_path / "again.npz", tmp_path / "other.npz"
    assert main(["tactile", "generate", "--rigs", "1", "--seed", "3", "--out", str(again), "--json"]) == DONE
    assert answer(capsys)["n"] == 1100
    assert main(["tactile", "generate", "--rigs", "1", "--seed", "4", "--out", str(other)]) == DONE
    with np.load(data) as one, np.load(again) as two, np.load(other) as three:
        assert all(np.array_equal(one[name], two[name]) for name in one.files)
        assert not np.array_equal(one["left"], three["left"])


def test_signed_poses_are_averaged_over_the_given_frames(tmp_path: Path) -> None:
    path = tmp_path / "data.npz"
    words = ["--protocol", "continuous", "--rigs", "2", "--dockings", "30", "--frames", "5", "--out", str(path)]
    assert main(["tactile", "generate", *words]) == DONE
    with np.load(path) as file:
        assert len(file["angle"]) == 60
        assert file["angle"].min() < 0.0 < file["angle"].max()
        assert json.loads(str(file["meta"]))["frames"] == 5


def test_a_classifier_is_trained_and_evaluated(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    model, fresh = tmp_path / "model.npz", tmp_path / "fresh.npz"
    words = ["--data", str(data), "--model", "lda", "--target", "vertical", "--out", str(model), "--json"]
    assert main(["tactile", "train", *words]) == DONE
    assert answer(capsys)["n"] == 400
    assert main(["tactile", "generate", "--rigs", "1", "--seed", "9", "--out", str(fresh)]) == DONE
    assert main(["tactile", "evaluate", "--data", str(fresh), "--model", str(model), "--json"]) == DONE
    found = answer(capsys)
    assert (found["target"], found["n"], found["nominal"]) == ("vertical", 500, 0.95)
    assert found["accuracy"] > 0.9  # type: ignore[operator]
    assert 0.0 < found["mean_absolute_error"] < 0.001  # type: ignore[operator]
    assert all(0.0 <= found[name] <= 1.0 for name in ("coverage", "act_rate", "drift_rate"))  # type: ignore[operator]
    assert main(["tactile", "evaluate", "--data", str(fresh), "--model", str(model)]) == DONE
    output = capsys.readouterr()
    assert "simulated" in output.out
    assert "was trained on" not in output.err
    assert main(["tactile", "evaluate", "--data", str(data), "--model", str(model)]) == DONE
    assert f"{model} was trained on {data}" in capsys.readouterr().err


def test_data_of_another_program_are_not_taken_for_training_data(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    foreign, fresh, model = tmp_path / "foreign.npz", tmp_path / "fresh.npz", tmp_path / "model.npz"
    assert main(["tactile", "generate", "--rigs", "1", "--seed", "9", "--out", str(fresh)]) == DONE
    for source, path in ((data, foreign), (fresh, fresh)):
        with np.load(source, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        np.savez(path, **{**arrays, "meta": np.array("{}")})
    words = ["--data", str(foreign), "--model", "lda", "--target", "vertical", "--out", str(model)]
    assert main(["tactile", "train", *words]) == DONE
    capsys.readouterr()
    assert main(["tactile", "evaluate", "--data", str(fresh), "--model", str(model)]) == DONE
    assert "was trained on" not in capsys.readouterr().err


def test_a_pose_estimator_is_trained_and_evaluated_on_different_rigs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, fresh, model = (tmp_path / name for name in ("data.npz", "fresh.npz", "pose.npz"))
    generate = ["tactile", "generate", "--protocol", "continuous", "--frames", "4"]
    assert main([*generate, "--rigs", "6", "--dockings", "500", "--out", str(data)]) == DONE
    assert main([*generate, "--rigs", "2", "--first-rig", "50", "--dockings", "300", "--out", str(fresh)]) == DONE
    capsys.readouterr()
    words = ["--data", str(data), "--model", "pose", "--target", "pose", "--out", str(model), "--json"]
    assert main(["tactile", "train", *words]) == DONE
    assert answer(capsys)["n"] == 3000
    results = []
    for path in (str(model), str(MODEL_PATH)):
        assert main(["tactile", "evaluate", "--data", str(fresh), "--model", path, "--json"]) == DONE
        found = answer(capsys)
        assert (found["target"], found["n"]) == ("pose", 600)
        results.append(found)
    keys = {"target", "n", "accuracy", "mean_absolute_error", "coverage", "nominal", "act_rate", "drift_rate"}
    for axis in ("angle", "vertical", "horizontal"):
        own, packaged = (result[axis] for result in results)
        assert set(own) == set(packaged) == keys  # type: ignore[call-overload]
        assert packaged["mean_absolute_error"] < own["mean_absolute_error"] < 0.2  # type: ignore[index]
        assert packaged["coverage"] > 0.85  # type: ignore[index]
    assert main(["tactile", "evaluate", "--data", str(fresh), "--model", str(MODEL_PATH)]) == DONE
    output = capsys.readouterr().out
    assert all(axis in output for axis in ("simulated", "angle", "vertical", "horizontal"))


def test_reference_dockings_change_the_bias(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    plain, referred, other = (tmp_path / name for name in ("plain.npz", "referred.npz", "other.npz"))
    assert main(["tactile", "generate", "--rigs", "1", "--first-rig", "9", "--out", str(other)]) == DONE
    words = ["tactile", "train", "--data", str(data), "--model", "lda", "--target", "vertical"]
    assert main([*words, "--out", str(plain)]) == DONE
    assert main([*words, "--out", str(referred), "--reference", str(other)]) == DONE
    with np.load(plain) as one, np.load(referred) as two:
        assert np.array_equal(one["weights"], two["weights"])
        assert not np.array_equal(one["bias"], two["bias"])
    assert main([*words, "--out", str(referred), "--reference", "none.npz"]) == WRONG_INPUT
    assert "--reference none.npz" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("generate", "--out", "data.csv"), "must end in .npz"),
        (("generate", "--out", "nowhere/data.npz"), "does not exist"),
        (("evaluate", "--data", "missing.npz", "--model", "missing.npz"), "no such file"),
        (("evaluate", "--data", "DATA", "--model", "DATA"), "no pose model"),
        (("evaluate", "--data", "DATA", "--model", str(MODEL_PATH)), "cut at 1 N"),
        (("generate", "--dockings", "5", "--out", "data.npz"), "continuous"),
        (("train", "--data", "DATA", "--model", "pose", "--target", "pose", "--out", "m.npz"), "rigs are too few"),
        (("train", "--data", "DATA", "--model", "lda", "--target", "pose", "--out", "m.npz"), "--model pose"),
        (("evaluate", "--data", "DATA", "--model", "missing.npz"), "missing.npz"),
        (("train", "--data", "broken.npz", "--model", "lda", "--target", "angle", "--out", "m.npz"), "broken.npz"),
    ],
)
def test_wrong_input_is_named(
    words: tuple[str, ...],
    reason: str,
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("broken.npz").write_text("no archive")
    assert main(["tactile", *(str(data) if word == "DATA" else word for word in words), "--json"]) == WRONG_INPUT
    assert reason in str(answer(capsys)["error"])
