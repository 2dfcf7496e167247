# SPDX-License-Identifier: Apache-2.0
"""The packaged nine models of the paper: size, accuracy, and refused files."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from deltacharger_tactile.classifiers import labels, packaged
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.labels import TARGETS, examples
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.errors import ModelError, UnknownModelError

from ..marks import rest
from .small_paper import small_paper

LARGEST = 12e6  # bytes of all files together
MEMORY = 60e6  # bytes of memory for all


@pytest.fixture(scope="module")
def data() -> Dataset:
    return small_paper((331, 332), 6, positions=4, angles=20)


@pytest.mark.parametrize("name", [rest("knn") if name == "knn" else name for name in packaged.MODELS])
def test_each_reaches_its_stated_accuracy(name: str, data: Dataset) -> None:
    for target, model in packaged.load(name).items():
        rows = examples(data, target)
        shares = model.predict_proba(rows.frames)
        assert shares.shape == (len(rows), labels.classes(target))
        np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=1e-6)
        right = float(np.mean(shares.argmax(axis=1) == rows.labels))
        assert right > model.about[packaged.ACCURACY] - 0.08, "two other rigs than in its test"


@pytest.mark.rest
def test_loading_all_needs_no_trainer_and_little_memory() -> None:
    program = (
        "import sys, psutil\n"
        "from deltacharger_tactile.classifiers import packaged\n"
        "before = psutil.Process().memory_info().rss\n"
        "models = [packaged.load(name) for name in packaged.MODELS]\n"
        "print(psutil.Process().memory_info().rss - before)\n"
        "print(sorted({'torch', 'sklearn', 'xgboost', 'scipy'} & set(sys.modules)))\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    memory, trainers = ended.stdout.splitlines()
    assert int(memory) < MEMORY
    assert trainers == "[]"
    assert len(packaged.MODELS) == 9
    files = [packaged.path(name, target) for name in packaged.MODELS for target in TARGETS]
    assert sum(file.stat().st_size for file in files) < LARGEST


@pytest.mark.parametrize("name", ["", "CNN", "../cnn", "/etc/passwd", "pose", "x" * 5_000_000])
def test_an_unknown_name_is_answered_with_the_known_ones(name: str) -> None:
    with pytest.raises(UnknownModelError, match="xgboost, nn, cnn") as found:
        packaged.load(name)
    assert len(str(found.value)) < 300


@pytest.mark.parametrize("harm", ["generator", "empty", "cut", "another", "missing"])
def test_an_unusable_file_is_named(harm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original, file = packaged.path("tree", "angle"), packaged.path("tree", "angle", tmp_path)
    with np.load(original) as content:
        arrays = dict(content)
    about = json.loads(str(arrays["about"])) | {"generator": "0123456789abcdef"}
    if harm == "generator":
        np.savez(file, **arrays | {"about": np.array(json.dumps(about))})
    elif harm != "missing":
        other = packaged.path("tree", "vertical").read_bytes()
        file.write_bytes({"empty": b"", "cut": original.read_bytes()[:999], "another": other}[harm])
    monkeypatch.setattr(packaged, "FOLDER", tmp_path)
    with pytest.raises(ModelError, match=file.name) as found:
        packaged.load("tree")
    assert harm != "generator" or "0123456789abcdef" in str(found.value)


@pytest.mark.rest
@pytest.mark.parametrize("name", ["logistic", "knn", "forest"])
def test_a_shrunk_model_predicts_the_same_from_a_smaller_file(name: str, data: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    rows = examples(data, "vertical")
    model = Classifier(name, "vertical").fit(rows.frames[::2], rows.labels[::2])
    known = model.predict(rows.frames)
    model.save(tmp_path / "whole.npz")
    model.shrink(rows.frames).save(tmp_path / "small.npz")
    np.testing.assert_array_equal(Classifier.load(tmp_path / "small.npz").predict(rows.frames), known)
    np.testing.assert_array_equal(model.predict(rows.frames), known)
    assert (tmp_path / "small.npz").stat().st_size < 0.7 * (tmp_path / "whole.npz").stat().st_size
