# SPDX-License-Identifier: Apache-2.0
"""The paper's classifiers and one more: training, files, and when an answer may be used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_tactile.classifiers import labels, packaged, reliability, splits
from deltacharger_tactile.classifiers.classifier import NAMES, Classifier
from deltacharger_tactile.classifiers.judgement import evaluate
from deltacharger_tactile.classifiers.labels import Examples, examples
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.errors import DatasetError, ModelError
from deltacharger_tactile.generator import generate_continuous, generate_paper

from ..marks import night, rest
from .small_paper import small_paper

NEEDS = {"gbdt": "sklearn", "xgboost": "xgboost", "nn": "torch", "cnn": "torch"}
SIMPLE = "lda"


def marked(name: str) -> Any:
    slow = {"nn": night, "cnn": night, "gbdt": rest, "logistic": rest}
    return slow[name](name) if name in slow else name


@pytest.fixture(scope="module")
def data() -> Dataset:
    return small_paper()


@pytest.fixture(scope="module")
def angle(data: Dataset) -> Examples:
    return examples(data, "angle")


def trained(name: str, rows: Examples, target: str = "angle") -> tuple[Classifier, Examples]:
    pytest.importorskip(NEEDS.get(name, "sklearn"), reason="trains with deltacharger[train]")
    learns, judges = splits.by_docking(rows, seed=1)
    model = Classifier(name, target).fit(rows.frames[learns], rows.labels[learns], seed=1)
    return model, rows.part(judges)


@pytest.mark.parametrize("name", [marked(name) for name in NAMES])
def test_numpy_matches_the_trainer_its_file_and_the_same_seed(name: str, angle: Examples, tmp_path: Path) -> None:
    model, rows = trained(name, angle)
    found = model.predict_proba(rows.frames)
    np.testing.assert_allclose(found, model.trainer_proba(rows.frames), atol=1e-6)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-9)
    assert np.mean(found.argmax(axis=1) == rows.labels) > 0.35  # few examples; chance is one in six
    model.save(tmp_path / "model.npz")
    again = Classifier.load(tmp_path / "model.npz")
    np.testing.assert_allclose(again.predict_proba(rows.frames), found, atol=1e-12)
    assert (again.name, again.target) == (name, "angle")
    if name in ("forest", "cnn"):  # draw while they learn
        np.testing.assert_allclose(trained(name, angle)[0].predict_proba(rows.frames), found, atol=1e-5)


def test_a_dead_taxel_counts_as_zero(angle: Examples) -> None:
    dead, nothing = angle.frames[:20].copy(), angle.frames[:20].copy()
    dead[:, 0, 4, 4], nothing[:, 0, 4, 4] = np.nan, 0.0
    model = packaged.load("logistic")["angle"]
    np.testing.assert_array_equal(model.predict_proba(dead), model.predict_proba(nothing))


@pytest.mark.rest
@pytest.mark.parametrize("target", labels.TARGETS)
def test_conformal_sets_reach_their_nominal_coverage(target: str) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    rows, covered = examples(generate_paper(rigs=(301,), seed=5), target), []
    for seed in range(8):
        learns, others = splits.by_docking(rows, seed)
        judged = rows.part(others)
        checks, judges = splits.by_docking(judged, seed, 0.5)
        model = Classifier(SIMPLE, target).fit(rows.frames[learns], rows.labels[learns])
        model.calibrate(judged.frames[checks], judged.labels[checks])
        covered.append(evaluate(model, judged.part(judges))["coverage"])
    assert np.mean(covered) >= reliability.NOMINAL - 0.03


def test_frames_unlike_training_are_detected_after_calibration(angle: Examples) -> None:
    model, rows = trained(SIMPLE, angle)
    before = evaluate(model, rows)
    assert np.isnan([before["coverage"], before["act_rate"], before["drift_rate"]]).all()
    with pytest.raises(ModelError, match="too few"):
        model.calibrate(rows.frames[:5], rows.labels[:5])
    model.calibrate(rows.frames, rows.labels)
    assert model.reliability is not None
    assert evaluate(model, rows)["drift_rate"] < 0.05
    for strange in (0.5 * rows.frames, 2.0 * rows.frames, np.zeros_like(rows.frames)):
        assert model.reliability.familiar.strange(strange, model.threshold).mean() > 0.9


def test_classes_match_the_paper() -> None:
    degrees = np.radians([0.0, 0.49, 0.51, 4.6, 5.5, 5.6])
    assert labels.label(degrees, "angle").tolist() == [0, 0, 1, 5, 5, -1]
    assert labels.label(np.array([-0.010, -0.0124, 0.0024, 0.0026, 0.0126]), "horizontal").tolist() == [0, 0, 2, 3, -1]


def test_a_target_uses_the_rows_that_vary_it(data: Dataset) -> None:
    for target, counts in (("angle", [40] * 6), ("vertical", [40] * 5), ("horizontal", [40] * 5)):
        assert np.bincount(examples(data, target).labels).tolist() == counts
    continuous = generate_continuous(rigs=(3,), count=50, seed=1)
    assert (examples(continuous, "angle").values <= np.radians(5.5)).all()


def test_a_split_never_separates_a_docking(angle: Examples) -> None:
    double = Examples(*(np.repeat(getattr(angle, name), 2, axis=0) for name in Examples.__dataclass_fields__))
    learns, judges = splits.by_docking(double, seed=3)
    assert not set(double.groups[learns]) & set(double.groups[judges])
    assert len(learns) + len(judges) == len(double)
    judged = [set(double.groups[rows]) for _, rows in splits.thirds(double, seed=3)]
    assert set.union(*judged) == set(double.groups)
    assert sum(map(len, judged)) == len(angle)
    mixed, others = splits.by_frame(double, seed=3)
    assert set(double.groups[mixed]) & set(double.groups[others])


def test_each_rig_is_left_out_once() -> None:
    rows = examples(small_paper((1, 2), angles=1, positions=1), "vertical")
    parts = splits.leave_one_out(rows, "rigs")
    assert [set(rows.rigs[judges]) for _, judges in parts] == [{1}, {2}]
    with pytest.raises(DatasetError, match="only one"):
        splits.leave_one_out(rows.part(rows.rigs == 1), "rigs")


def test_unknown_names_targets_and_classes_without_examples_are_refused(angle: Examples) -> None:
    for name, target in (("cnn2", "angle"), ("cnn", "pose")):
        with pytest.raises(ModelError, match="known"):
            Classifier(name, target)
    some = angle.part(angle.labels < 4)
    with pytest.raises(ModelError, match="class 0 to 5"):
        Classifier(SIMPLE, "angle").fit(some.frames, some.labels)
