# SPDX-License-Identifier: Apache-2.0
"""Foreign model files: truncated, of another kind or version, hostile; each is refused with a reason."""

from __future__ import annotations

import json
import pickle
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_tactile import MODEL_PATH, PoseEstimator
from deltacharger_tactile.classifiers import packaged
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.labels import examples
from deltacharger_tactile.errors import ModelError

from ..marks import rest
from .small_paper import small_paper

Arrays = dict[str, Any]


@cache
def saved(name: str) -> Arrays:
    """Return the arrays of a classifier's file, a packaged one if there is one."""
    path = packaged.path(name, "vertical")
    if not path.exists():
        pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
        rows, path = examples(small_paper(), "vertical"), Path(tempfile.mkdtemp()) / "good.npz"
        model = Classifier(name, "vertical").fit(rows.frames, rows.labels)
        model.calibrate(rows.frames, rows.labels)
        model.save(path)
    with np.load(path) as file:
        return dict(file)


def refuses(load: Any, path: Path, arrays: Arrays, noun: str = "") -> None:
    np.savez(path, **arrays)
    with pytest.raises(ModelError, match=noun):
        load(path)


def test_both_loaders_refuse_files_that_are_not_models(tmp_path: Path) -> None:
    whole = MODEL_PATH.read_bytes()
    small_paper(angles=1, positions=1).save(tmp_path / "data.npz")
    for name, content in (("half", whole[: len(whole) // 2]), ("empty", b""), ("pickle", pickle.dumps([1]))):
        (tmp_path / f"{name}.npz").write_bytes(content)
    np.savez(tmp_path / "object.npz", about=np.array([print], dtype=object), meta=np.array([print], dtype=object))
    for load in (Classifier.load, PoseEstimator.load):
        for path in [*tmp_path.glob("*.npz"), tmp_path]:
            with pytest.raises(ModelError, match=path.name):
                load(path)
        with pytest.raises(FileNotFoundError):
            load(tmp_path / "none.npz")
    refuses(PoseEstimator.load, tmp_path / "class.npz", saved("logistic"))
    with pytest.raises(ModelError):
        Classifier.load(MODEL_PATH)


@pytest.mark.parametrize("name", ["logistic", "nn", "tree", rest("lda"), rest("pose")])
def test_mismatched_arrays_are_refused(name: str, tmp_path: Path) -> None:
    good, path = saved(name), tmp_path / "bad.npz"
    for key in [key for key in good if key not in ("about", "means", "usual")]:
        refuses(Classifier.load, path, {other: value for other, value in good.items() if other != key})
        refuses(Classifier.load, path, good | {key: np.array(["a"])})
        if good[key].ndim:
            refuses(Classifier.load, path, good | {key: good[key][..., :-1]})
        if np.issubdtype(good[key].dtype, np.floating):
            refuses(Classifier.load, path, good | {key: np.full_like(good[key], np.nan)}, "NaN")


def test_an_endless_tree_is_refused(tmp_path: Path) -> None:
    good = saved("tree")
    for key, value in (("left", 0), ("right", 10**9), ("root", -1)):
        refuses(Classifier.load, tmp_path / "bad.npz", good | {key: np.full(good[key].shape, value)}, "trees")


def test_a_wrong_description_is_refused(tmp_path: Path) -> None:
    good = saved("logistic")
    wrong = {
        "format": 99,
        "target": "colour",
        "name": "none",
        "threshold": "a",
        "kind": "magic",
        "reliability": {"a": 1},
    }
    for name, value in wrong.items():
        about = json.loads(str(good["about"])) | {name: value}
        refuses(Classifier.load, tmp_path / "bad.npz", good | {"about": np.array(json.dumps(about))})


@pytest.mark.rest
def test_a_classifier_of_an_earlier_version_is_refused(tmp_path: Path) -> None:
    good = saved("pose")
    about = json.loads(str(good["about"]))
    earlier = {key: value for key, value in about.items() if key != "pretrained"}  # files had none before 1.0.0
    for changed in (earlier, about | {"pretrained": "0" * 16}):
        refuses(Classifier.load, tmp_path / "bad.npz", good | {"about": np.array(json.dumps(changed))}, "version")


def test_a_damaged_pose_model_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    with np.load(MODEL_PATH) as file:
        good = {name: file[name] for name in file.files}
    for key in ("both_0_weight1", "support_whitening", "one_centre", "both_factor"):
        for wrong in (good[key][..., :-1], np.full_like(good[key], np.nan)):
            refuses(PoseEstimator.load, path, good | {key: wrong})
    meta = json.loads(str(good["meta"]))
    # A model of format 2 was made before leans were learnt: its seats mean something else.
    for change in ({"format": 2}, {"members": "two"}, {"interval": [1]}, {"support": None}):
        refuses(PoseEstimator.load, path, good | {"meta": np.array(json.dumps(meta | change))})
