# SPDX-License-Identifier: Apache-2.0
"""The packaged nine models of the paper, and model files: each foreign or damaged one is refused with a reason."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_sim.pads import generate_paper
from deltacharger_tactile import MODEL_PATH, PoseEstimator, dataset, errors
from deltacharger_tactile.classifiers import classifier

from ..marks import rest


@pytest.fixture(scope="module")
def data() -> dataset.Dataset:
    return generate_paper(rigs=(331, 332), seed=6)


@pytest.mark.parametrize("name", [rest("knn") if name == "knn" else name for name in classifier.MODELS])
def test_each_reaches_its_stated_accuracy_without_a_trainer(
    name: str, data: dataset.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    for library in ("torch", "sklearn", "xgboost", "scipy"):
        monkeypatch.setitem(sys.modules, library, None)
    for target, model in classifier.load(name).items():
        is_angle = target == "angle"
        rows = np.flatnonzero(data.subset == (dataset.SUBSET_ANGLE if is_angle else dataset.SUBSET_POSITION))[::3]
        value = getattr(data, target)[rows]
        known = np.abs(np.degrees(value)) if is_angle else value / 0.005 + 2.0
        shares = model.predict_proba(np.stack(data.robot_frames(), axis=1)[rows])
        np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-6)
        right = float(np.mean(shares.argmax(axis=1) == np.rint(known)))
        assert right > model.about[classifier.ACCURACY] - 0.08, "two other rigs than in its test"


@pytest.mark.parametrize("name", ["", "../cnn", "x" * 5_000_000])
def test_an_unknown_name_is_answered_with_the_known_ones(name: str) -> None:
    with pytest.raises(errors.ModelError, match="xgboost, nn, cnn") as found:
        classifier.load(name)
    assert len(str(found.value)) < 300


Arrays = dict[str, Any]


@pytest.mark.parametrize("wrong", [{"format": 99}, {"name": "lda"}, {"generator": "0123456789abcdef"}])
def test_a_file_of_another_kind_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: Any) -> None:
    with np.load(classifier.path("tree", "angle")) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["about"])) | wrong
    np.savez(classifier.path("tree", "angle", tmp_path), **arrays | {"about": np.array(json.dumps(about))})
    monkeypatch.setattr(classifier, "FOLDER", tmp_path)
    with pytest.raises(errors.ModelError, match=r"tree-angle\.npz"):
        classifier.load("tree")


def test_a_damaged_pose_model_is_refused(tmp_path: Path) -> None:
    def refuses(arrays: Arrays) -> None:
        np.savez(tmp_path / "bad.npz", **arrays)
        with pytest.raises(errors.ModelError, match=r"bad\.npz"):
            PoseEstimator.load(tmp_path / "bad.npz")

    with np.load(MODEL_PATH) as file:
        good = {name: file[name] for name in file.files}
    for key in ("both_0_weight1", "support_whitening", "one_centre", "both_factor"):
        for wrong in (good[key][..., :-1], np.full_like(good[key], np.nan)):
            refuses(good | {key: wrong})
    meta = json.loads(str(good["meta"]))
    # A model of format 2 was made before leans were learnt: its seats mean something else.
    for change in ({"format": 2}, {"members": "two"}, {"support": None}):
        refuses(good | {"meta": np.array(json.dumps(meta | change))})
