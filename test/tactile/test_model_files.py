# SPDX-License-Identifier: Apache-2.0
"""Foreign model files: truncated, of another kind or version, hostile; each is refused with a reason."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_tactile import MODEL_PATH, PoseEstimator
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.labels import examples
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.errors import ModelError
from deltacharger_tactile.generator import generate_paper

Arrays = dict[str, Any]


@pytest.fixture(scope="module")
def data() -> Dataset:
    return generate_paper(rigs=(320,), seed=5)


def saved(name: str, data: Dataset, path: Path) -> Arrays:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    rows = examples(data, "vertical")
    model = Classifier(name, "vertical").fit(rows.frames, rows.labels)
    model.calibrate(rows.frames, rows.labels)
    model.save(path)
    with np.load(path) as file:
        return {key: file[key] for key in file.files}


def test_both_loaders_refuse_files_that_are_not_models(data: Dataset, tmp_path: Path) -> None:
    whole = MODEL_PATH.read_bytes()
    data.save(tmp_path / "data.npz")
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "pickle.npz").write_bytes(pickle.dumps([1]))
    np.savez(tmp_path / "object.npz", about=np.array([print], dtype=object), meta=np.array([print], dtype=object))
    for path in tmp_path.glob("*.npz"):
        for load in (Classifier.load, PoseEstimator.load):
            with pytest.raises(ModelError, match=path.name):
                load(path)
    for load in (Classifier.load, PoseEstimator.load):
        with pytest.raises(FileNotFoundError):
            load(tmp_path / "none.npz")
        with pytest.raises(ModelError, match="folder"):
            load(tmp_path)


def test_each_loader_refuses_the_other_kind(data: Dataset, tmp_path: Path) -> None:
    saved("lda", data, tmp_path / "class.npz")
    with pytest.raises(ModelError):
        PoseEstimator.load(tmp_path / "class.npz")
    with pytest.raises(ModelError):
        Classifier.load(MODEL_PATH)


@pytest.mark.parametrize("name", ["lda", "pose", "tree"])
def test_mismatched_arrays_are_refused(name: str, data: Dataset, tmp_path: Path) -> None:
    good = saved(name, data, tmp_path / "good.npz")
    for key in [key for key in good if key not in ("about", "means", "usual")]:
        for wrong in (None, good[key][..., :-1] if good[key].ndim else None, np.array(["a"])):
            arrays = {**good, key: wrong}
            if wrong is None:
                del arrays[key]
            np.savez(tmp_path / "bad.npz", **arrays)
            with pytest.raises(ModelError):
                Classifier.load(tmp_path / "bad.npz")
        if np.issubdtype(good[key].dtype, np.floating):
            np.savez(tmp_path / "bad.npz", **{**good, key: np.full_like(good[key], np.nan)})
            with pytest.raises(ModelError, match="NaN"):
                Classifier.load(tmp_path / "bad.npz")


def test_an_endless_tree_is_refused(data: Dataset, tmp_path: Path) -> None:
    good = saved("forest", data, tmp_path / "good.npz")
    for key, value in (("left", 0), ("right", 10**9), ("root", -1)):
        array = good[key].copy()
        array[:] = value
        np.savez(tmp_path / "bad.npz", **{**good, key: array})
        with pytest.raises(ModelError, match="trees"):
            Classifier.load(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    "change",
    [
        {"format": 99},
        {"target": "colour"},
        {"name": "none"},
        {"threshold": "a"},
        {"kind": "magic"},
        {"reliability": {"a": 1}},
    ],
)
def test_a_wrong_description_is_refused(data: Dataset, tmp_path: Path, change: dict[str, Any]) -> None:
    good = saved("lda", data, tmp_path / "good.npz")
    about = json.loads(str(good["about"])) | change
    np.savez(tmp_path / "bad.npz", **{**good, "about": np.array(json.dumps(about))})
    with pytest.raises(ModelError):
        Classifier.load(tmp_path / "bad.npz")


def test_a_classifier_trained_on_packaged_models_of_an_earlier_version_is_refused(
    data: Dataset, tmp_path: Path
) -> None:
    good = saved("pose", data, tmp_path / "good.npz")
    assert Classifier.load(tmp_path / "good.npz").name == "pose"
    about = json.loads(str(good["about"]))
    earlier = {key: value for key, value in about.items() if key != "pretrained"}  # files had none before 1.0.0
    for changed in (earlier, about | {"pretrained": "0" * 16}):
        np.savez(tmp_path / "bad.npz", **{**good, "about": np.array(json.dumps(changed))})
        with pytest.raises(ModelError, match=r"bad\.npz.*packaged models of another version; train it again"):
            Classifier.load(tmp_path / "bad.npz")


def test_a_damaged_pose_model_is_refused(tmp_path: Path) -> None:
    with np.load(MODEL_PATH) as file:
        good = {name: file[name] for name in file.files}
    for key in ("both_0_weight1", "support_whitening", "one_centre", "both_factor"):
        for wrong in (good[key][..., :-1], np.full_like(good[key], np.nan)):
            np.savez(tmp_path / "bad.npz", **{**good, key: wrong})
            with pytest.raises(ModelError):
                PoseEstimator.load(tmp_path / "bad.npz")
    meta = json.loads(str(good["meta"]))
    np.savez(tmp_path / "lean.npz", **{**good, "meta": np.array(json.dumps(meta | {"format": 2}))})
    with pytest.raises(
        ModelError, match=r"lean\.npz.*format 2, and this version reads 3.*train one or use the packaged"
    ):
        PoseEstimator.load(tmp_path / "lean.npz")  # made before leans were learnt: its seats mean something else
    for change in ({"format": 1}, {"members": "two"}, {"interval": [1]}, {"support": None}):
        np.savez(tmp_path / "bad.npz", **{**good, "meta": np.array(json.dumps(meta | change))})
        with pytest.raises(ModelError):
            PoseEstimator.load(tmp_path / "bad.npz")
