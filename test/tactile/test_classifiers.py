# SPDX-License-Identifier: Apache-2.0
"""The paper's classifiers and one more: training, files, and when an answer may be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deltacharger_tactile.classifiers import labels, reliability, splits
from deltacharger_tactile.classifiers.classifier import NAMES, Classifier
from deltacharger_tactile.classifiers.judgement import evaluate
from deltacharger_tactile.classifiers.labels import Examples, examples
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.errors import DatasetError, ModelError
from deltacharger_tactile.generator import generate_continuous, generate_paper

from ..marks import rest

NEEDS = {"gbdt": "sklearn", "xgboost": "xgboost", "nn": "torch", "cnn": "torch"}
SIMPLE = "lda"


@pytest.fixture(scope="module")
def data() -> Dataset:
    return generate_paper(rigs=(301,), seed=5)


@pytest.fixture(scope="module")
def angle(data: Dataset) -> Examples:
    return examples(data, "angle")


def trained(name: str, rows: Examples, target: str = "angle") -> tuple[Classifier, Examples]:
    pytest.importorskip(NEEDS.get(name, "sklearn"), reason="trains with deltacharger[train]")
    learns, judges = splits.by_docking(rows, seed=1)
    model = Classifier(name, target).fit(rows.frames[learns], rows.labels[learns], seed=1)
    return model, rows.part(judges)


@pytest.mark.parametrize("name", [rest(name) if NEEDS.get(name) == "torch" else name for name in NAMES])
def test_numpy_export_matches_the_trained_model(name: str, angle: Examples, tmp_path: Path) -> None:
    model, rows = trained(name, angle)
    found = model.predict_proba(rows.frames)
    np.testing.assert_allclose(found, model.trainer_proba(rows.frames), atol=1e-6)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-9)
    assert np.mean(found.argmax(axis=1) == rows.labels) > 0.5  # chance is one in six
    model.save(tmp_path / "model.npz")
    again = Classifier.load(tmp_path / "model.npz")
    np.testing.assert_allclose(again.predict_proba(rows.frames), found, atol=1e-12)
    assert (again.name, again.target) == (name, "angle")
    np.load(tmp_path / "model.npz", allow_pickle=False)


@pytest.mark.parametrize("name", ["forest", rest("cnn")])
def test_same_seed_gives_the_same_model(name: str, angle: Examples) -> None:
    one, rows = trained(name, angle)
    two, _ = trained(name, angle)
    np.testing.assert_allclose(one.predict_proba(rows.frames), two.predict_proba(rows.frames), atol=1e-5)


def test_a_dead_taxel_counts_as_zero(angle: Examples) -> None:
    model, rows = trained("logistic", angle)
    dead, nothing = rows.frames.copy(), rows.frames.copy()
    dead[:, 0, 4, 4], nothing[:, 0, 4, 4] = np.nan, 0.0
    np.testing.assert_array_equal(model.predict_proba(dead), model.predict_proba(nothing))


@pytest.mark.parametrize("target", labels.TARGETS)
def test_conformal_sets_reach_their_nominal_coverage(target: str, data: Dataset) -> None:
    covered = []
    for seed in range(8):
        pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
        rows = examples(data, target)
        learns, others = splits.by_docking(rows, seed)
        rest = rows.part(others)
        checks, judges = splits.by_docking(rest, seed, 0.5)
        model = Classifier(SIMPLE, target).fit(rows.frames[learns], rows.labels[learns])
        model.calibrate(rest.frames[checks], rest.labels[checks])
        covered.append(evaluate(model, rest.part(judges))["coverage"])
    assert np.mean(covered) >= reliability.NOMINAL - 0.03


def test_frames_unlike_training_are_detected(angle: Examples) -> None:
    model, rows = trained(SIMPLE, angle)
    model.calibrate(rows.frames, rows.labels)
    assert model.reliability is not None
    assert evaluate(model, rows)["drift_rate"] < 0.05
    for strange in (0.5 * rows.frames, 2.0 * rows.frames, np.zeros_like(rows.frames)):
        assert model.reliability.familiar.strange(strange, model.threshold).mean() > 0.9


def test_uncalibrated_metrics_are_nan(angle: Examples) -> None:
    model, rows = trained(SIMPLE, angle)
    found = evaluate(model, rows)
    assert np.isnan([found["coverage"], found["act_rate"], found["drift_rate"]]).all()
    with pytest.raises(ModelError, match="too few"):
        model.calibrate(rows.frames[:5], rows.labels[:5])


def test_classes_match_the_paper() -> None:
    degrees = np.radians([0.0, 0.49, 0.51, 4.6, 5.5, 5.6])
    assert labels.label(degrees, "angle").tolist() == [0, 0, 1, 5, 5, -1]
    assert labels.label(np.array([-0.010, -0.0124, 0.0024, 0.0026, 0.0126]), "horizontal").tolist() == [0, 0, 2, 3, -1]


def test_a_target_uses_the_rows_that_vary_it(data: Dataset) -> None:
    assert [len(examples(data, target)) for target in labels.TARGETS] == [600, 500, 500]
    assert np.bincount(examples(data, "angle").labels).tolist() == [100] * 6
    assert np.bincount(examples(data, "horizontal").labels).tolist() == [100] * 5
    continuous = generate_continuous(rigs=(3,), count=200, seed=1)
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
    rows = examples(generate_paper(rigs=(1, 2), seed=0), "vertical")
    parts = splits.leave_one_out(rows, "rigs")
    assert [set(rows.rigs[judges]) for _, judges in parts] == [{1}, {2}]
    with pytest.raises(DatasetError, match="only one"):
        splits.leave_one_out(rows.part(rows.rigs == 1), "rigs")


@pytest.mark.parametrize(("name", "target"), [("cnn2", "angle"), ("cnn", "pose")])
def test_unknown_classifiers_and_targets_are_refused(name: str, target: str) -> None:
    with pytest.raises(ModelError, match="known are"):
        Classifier(name, target)


def test_a_class_without_examples_is_refused(angle: Examples) -> None:
    some = angle.part(angle.labels < 4)
    with pytest.raises(ModelError, match="every class 0 to 5"):
        Classifier(SIMPLE, "angle").fit(some.frames, some.labels)
