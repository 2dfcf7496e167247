# SPDX-License-Identifier: Apache-2.0
"""The paper's classifiers: training, files, combined and reference dockings, and frames unlike training."""

import contextlib
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import deltacharger_tactile
from deltacharger_lab.training import inputs, judgement, reliability, splits
from deltacharger_lab.training.classifier import DEFAULT, TrainableClassifier, write
from deltacharger_lab.training.labels import Examples, examples
from deltacharger_sim.pads import Rig, generate_continuous, generate_paper, measure
from deltacharger_tactile import dataset, errors
from deltacharger_tactile.classifiers import classifier
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.parameters import TactileParameters
from test.marks import night, rest

from .small_paper import small_paper

Frames = NDArray[np.float64]
NEEDS = {"gbdt": "sklearn", "xgboost": "xgboost", "nn": "torch", "cnn": "torch"}
SIMPLE, RIG, THRESHOLD = "lda", 311, 0.25
TREE = TrainableClassifier.load(classifier.path("tree", "angle"))


def marked(name: str) -> Any:
    slow = {"nn": night, "cnn": night, "gbdt": rest, "logistic": rest}
    return slow[name](name) if name in slow else name


@pytest.fixture(scope="module")
def data() -> dataset.Dataset:
    return small_paper()


@pytest.fixture(scope="module")
def angle(data: dataset.Dataset) -> Examples:
    return examples(data, "angle")


def trained(name: str, rows: Examples, target: str = "angle") -> tuple[TrainableClassifier, Examples]:
    pytest.importorskip(NEEDS.get(name, "sklearn"), reason="trains with deltacharger-lab[train]")
    learns, judges = splits.by_docking(rows, seed=1)
    model = TrainableClassifier(name, target).fit(rows.frames[learns], rows.labels[learns], seed=1)
    return model, rows.part(judges)


@pytest.mark.parametrize("name", [marked(name) for name in inputs.NAMES])
def test_numpy_matches_the_trainer_its_file_and_the_same_seed(name: str, angle: Examples, tmp_path: Path) -> None:
    model, rows = trained(name, angle)
    found = model.predict_proba(rows.frames)
    np.testing.assert_allclose(found, model.trainer_proba(rows.frames), atol=1e-6)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-9)
    assert np.mean(found.argmax(axis=1) == rows.labels) > (0.35 if name == "svm" else 0.5)  # few examples
    model.save(tmp_path / "model.npz")
    again = TrainableClassifier.load(tmp_path / "model.npz")
    np.testing.assert_allclose(again.predict_proba(rows.frames), found, atol=1e-12)
    assert (again.name, again.target) == (name, "angle")
    if name in ("forest", "cnn"):  # draw while they learn
        np.testing.assert_allclose(trained(name, angle)[0].predict_proba(rows.frames), found, atol=1e-5)


@pytest.mark.rest
@pytest.mark.parametrize("name", ["logistic", "knn", "forest"])
def test_a_shrunk_model_predicts_the_same_from_a_smaller_file(name: str, tmp_path: Path) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger-lab[train]")
    rows = examples(generate_paper(rigs=(331, 332), seed=6), "vertical")
    model = TrainableClassifier(name, "vertical").fit(rows.frames[::2], rows.labels[::2])
    known = model.predict(rows.frames)
    model.save(tmp_path / "whole.npz")
    model.shrink(rows.frames).save(tmp_path / "small.npz")
    np.testing.assert_array_equal(TrainableClassifier.load(tmp_path / "small.npz").predict(rows.frames), known)
    np.testing.assert_array_equal(model.predict(rows.frames), known)
    assert (tmp_path / "small.npz").stat().st_size < 0.7 * (tmp_path / "whole.npz").stat().st_size


@pytest.mark.night
@pytest.mark.timeout(600)
def test_the_papers_networks_reach_its_accuracy_on_new_rigs() -> None:
    pytest.importorskip("torch", reason="trains with deltacharger-lab[train]")
    frozen = json.loads((Path(deltacharger_tactile.__file__).parent / "frozen.json").read_text())
    sets = [generate_paper(rigs=(rig,), seed=4) for rig in (341, 342, 343)]
    for case, accuracy in frozen["simulated_accuracy_percent"].items():
        name, target = case.split()
        right = []
        for data in sets:
            rows = examples(data, target)
            learns, judges = splits.by_docking(rows, seed=1)
            model = TrainableClassifier(name, target).fit(rows.frames[learns], rows.labels[learns])
            right.append(np.mean(model.predict(rows.frames[judges]) == rows.labels[judges]))
        # 4 allows for chance with three rigs and 500 dockings.
        assert abs(100.0 * np.mean(right) - accuracy["paper"]) < 1.5 + 4.0, case


def test_frames_unlike_training_are_detected_after_calibration(angle: Examples) -> None:
    model, rows = trained(SIMPLE, angle)
    before = judgement.evaluate_classifier(model, rows)
    assert np.isnan([before["coverage"], before["act_rate"], before["drift_rate"]]).all()
    with pytest.raises(errors.ModelError, match="too few"):
        model.calibrate(rows.frames[:5], rows.labels[:5])
    model.calibrate(rows.frames, rows.labels)
    assert model.reliability is not None
    after = judgement.evaluate_classifier(model, rows)
    assert after["drift_rate"] < 0.05
    assert after["coverage"] >= reliability.NOMINAL
    for strange in (0.5 * rows.frames, 2.0 * rows.frames, np.zeros_like(rows.frames)):
        assert model.reliability.familiar.strange(strange, model.threshold).mean() > 0.9


def test_what_calibration_learnt_is_in_the_file_and_robots_read_it_without(angle: Examples, tmp_path: Path) -> None:
    model, path = TrainableClassifier.load(classifier.path("tree", "angle")), tmp_path / "model.npz"
    model.calibrate(angle.frames, angle.labels).save(path)
    again, robot = TrainableClassifier.load(path), Classifier.load(path)
    assert model.reliability is not None
    assert again.reliability is not None
    assert again.reliability.to_dict() == model.reliability.to_dict()
    assert again.about == TREE.about
    for each in (again, robot):
        np.testing.assert_array_equal(each.predict_proba(angle.frames), model.predict_proba(angle.frames))
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["about"])) | {"reliability": {"a": 1}}
    np.savez(path, **arrays | {"about": np.array(json.dumps(about))})
    with pytest.raises(errors.ModelError, match=path.name):
        TrainableClassifier.load(path)


def test_a_target_uses_the_rows_that_vary_it(data: dataset.Dataset) -> None:
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


USELESS = {
    "no contact": lambda rows: 0.0 * rows.frames,
    "dead": lambda rows: np.full_like(rows.frames, np.nan),
    "one frame": lambda rows: np.repeat(rows.frames[:1], len(rows), axis=0),
    "one frame of each class": lambda rows: rows.frames[np.unique(rows.labels, return_index=True)[1][rows.labels]],
    "rounding": lambda rows: 3.0 + np.random.default_rng(0).uniform(0.0, 1e-9, rows.frames.shape),
}


@pytest.mark.parametrize("frames", USELESS.values(), ids=USELESS)
def test_frames_that_teach_nothing_are_refused_with_what_to_do(frames: Any, angle: Examples) -> None:
    useless = frames(angle)
    with pytest.raises(errors.DatasetError, match=r"class \d .* [01] different frames in contact.* record more"):
        TrainableClassifier(SIMPLE, "angle").fit(useless, angle.labels)
    with pytest.raises(errors.ModelError, match=r"[016] different frames in contact"):
        TREE.calibrate(useless, angle.labels)


@pytest.mark.rest
@pytest.mark.parametrize("name", ["lda", DEFAULT])
def test_reference_dockings_remove_a_constant_tilt(name: str) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger-lab[train]")
    rows = examples(generate_paper(rigs=(312,), seed=5, threshold=THRESHOLD), "horizontal")
    model = TrainableClassifier(name, "horizontal", THRESHOLD).fit(rows.frames, rows.labels)
    rig = Rig.draw(TactileParameters(), 312)
    tilted = dataclasses.replace(rig, tilt=rig.tilt + np.radians([0.0, 0.06]))

    def dockings(device: Rig, places: np.ndarray, seed: int) -> np.ndarray:
        pose = np.column_stack([places, np.zeros((len(places), 2))])
        readings = measure(TactileParameters(), device, pose, np.random.default_rng(seed), 1, THRESHOLD)
        frames = np.stack([readings["left"], readings["right"]], axis=1)
        frames[readings["dead"]] = np.nan
        return frames

    def accuracy(frames: np.ndarray) -> float:
        return float(np.mean(model.predict(frames) == wanted))

    wanted = np.repeat(np.arange(5), 60)
    new, usual = (dockings(device, 0.005 * wanted - 0.010, 3) for device in (tilted, rig))
    before, as_trained = accuracy(new), accuracy(usual)
    ten = np.full(10, 2)
    for useless in (new[:1], np.repeat(new[:1], 10, axis=0), 0.0 * new):
        with pytest.raises(errors.ModelError, match=r"[01] different reference dockings are too few"):
            model.refer(useless, wanted[: len(useless)])
    model.refer(dockings(rig, np.zeros(10), 4), ten)
    assert accuracy(usual) > as_trained - 0.04, "little loss without a change"
    model.refer(dockings(tilted, np.zeros(10), 5), ten)
    assert accuracy(new) > before + 0.1


def docked(target: str, seed: int, parameters: TactileParameters | None = None, rig: int = RIG) -> Frames:
    data = small_paper((rig,), seed, 0.0, parameters, angles=60, positions=12)
    return np.nan_to_num(examples(data, target).frames)


Known = tuple[reliability.Familiarity, Frames]


@pytest.fixture(scope="module", params=["angle", rest("horizontal")])
def known(request: pytest.FixtureRequest) -> Known:
    """What was learnt from a rig, and frames of other dockings of the same rig."""
    learnt, other = (docked(request.param, seed) for seed in (1, 2))
    return reliability.learn_familiar(learnt, THRESHOLD), other


def fired(known: reliability.Familiarity, frames: Frames, size: int = reliability.WINDOW) -> float:
    random = np.random.default_rng(0)
    windows = [frames[random.choice(len(frames), size, replace=False)] for _ in range(20)]
    return float(np.mean([known.strange_together(window, THRESHOLD) for window in windows]))


def test_other_dockings_of_the_same_rig_are_familiar(known: Known) -> None:
    learnt, frames = known
    assert learnt.strange(frames, THRESHOLD).mean() <= 0.01
    assert fired(learnt, frames) <= 0.05
    window = frames[::7][: reliability.WINDOW].copy()
    window[0] = 0.0
    assert not learnt.strange_together(window, THRESHOLD), "one strange docking does not decide"


@pytest.mark.parametrize("change", ["weaker", "another rig"])
def test_a_slow_change_shows_in_a_window_though_not_in_a_frame(known: Known, change: str) -> None:
    learnt, usual = known
    target, family = "angle" if len(usual) == 360 else "horizontal", TactileParameters()
    force = {name: 0.8 * getattr(family.docking, name) for name in ("magnet_force", "push_per_ampere")}
    weaker = dataclasses.replace(family, docking=dataclasses.replace(family.docking, **force))
    frames = docked(target, 2, weaker) if change == "weaker" else docked(target, 2, rig=RIG + 1)
    assert learnt.strange(frames, THRESHOLD).mean() < 0.5
    assert fired(learnt, frames) > 0.9


def test_gross_changes_show_in_each_frame_and_lost_rows_in_a_window(known: Known) -> None:
    learnt, frames = known
    for strange in (0.4 * frames, 2.5 * frames, np.zeros_like(frames)):
        assert learnt.strange(strange, THRESHOLD).mean() > 0.9
    lost = frames.copy()
    lost[:, 0, 4:6] = 0.0
    assert fired(learnt, lost, 2 * reliability.WINDOW) > 0.5


def test_sets_of_held_out_frames_reach_nominal_coverage(known: Known) -> None:
    random = np.random.default_rng(5)
    frames, other = known[1][:200], known[1][200:]
    odds = random.gumbel(size=(200, 6))
    labels = np.argmax(odds + random.gumbel(size=(200, 6)), axis=1)
    shares = np.exp(odds) / np.exp(odds).sum(axis=1, keepdims=True)
    learnt = reliability.learn(shares, labels, frames, THRESHOLD)
    covered = learnt.sets(shares)[np.arange(200), labels].mean()
    assert reliability.NOMINAL <= covered <= reliability.NOMINAL + 0.015
    familiar = reliability.learn(shares, labels, frames, THRESHOLD, familiar=other)
    assert familiar.quantile == learnt.quantile
    assert not np.array_equal(familiar.familiar.weights, learnt.familiar.weights)


def test_a_classifier_trained_on_other_packaged_models_is_refused(tmp_path: Path) -> None:
    width = TrainableClassifier("pose", "vertical")._inputs(np.ones((1, 2, 10, 10))).shape[1]
    arrays = {"weights": np.zeros((width, 5)), "bias": np.zeros(5), "usual": np.zeros(width)}
    about = {"name": "pose", "target": "vertical", "threshold": 1.0, "kind": "linear"}
    for pretrained, fits in ((inputs.digest("vertical", 1.0), True), ("0" * 16, False)):
        write(tmp_path / "model.npz", {**about, "pretrained": pretrained}, arrays)
        with contextlib.nullcontext() if fits else pytest.raises(errors.ModelError, match="version"):
            TrainableClassifier.load(tmp_path / "model.npz")
