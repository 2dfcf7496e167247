# SPDX-License-Identifier: Apache-2.0
"""Accuracy of combined dockings, and of reference dockings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from deltacharger_tactile.classifiers import packaged, splits
from deltacharger_tactile.classifiers.classifier import DEFAULT, Classifier
from deltacharger_tactile.classifiers.fusion import groups, together
from deltacharger_tactile.classifiers.labels import examples
from deltacharger_tactile.errors import DatasetError, ModelError
from deltacharger_tactile.generator import generate_paper, measure
from deltacharger_tactile.parameters import TactileParameters
from deltacharger_tactile.sensor import Rig

THRESHOLD = 0.25


def accuracy(model: Classifier, frames: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.mean(model.predict(frames) == wanted))


def test_probabilities_of_independent_dockings_multiply() -> None:
    one = np.array([[0.6, 0.3, 0.1]])
    np.testing.assert_allclose(together([one]), one)
    np.testing.assert_allclose(together([one, one]), one**2 / np.sum(one**2))
    even = np.full((1, 3), 1.0 / 3.0)
    np.testing.assert_allclose(together([one, even]), one)
    # An outlier rules out no class.
    strange, usual = np.array([[0.0, 1.0]]), np.array([[0.999, 0.001]])
    assert together([strange, usual, usual, usual]).argmax() == 0


@pytest.mark.rest
def test_three_dockings_are_more_accurate_than_one() -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    rows = examples(generate_paper(rigs=(310, 311), seed=5, threshold=THRESHOLD), "horizontal")
    learns, judges = splits.by_docking(rows, seed=1)
    model = Classifier("lda", "horizontal", THRESHOLD).fit(rows.frames[learns], rows.labels[learns])
    test = rows.part(judges)
    shares = model.predict_proba(test.frames)
    three = groups(test, 3, seed=0)
    assert len(np.unique(three)) == three.size
    for column in (test.values, test.rigs, test.labels):
        assert (column[three] == column[three[0]]).all()
    alone = np.mean(shares.argmax(axis=1) == test.labels)
    joined = np.mean(together(shares[three]).argmax(axis=1) == test.labels[three[0]])
    assert joined > alone
    assert joined >= 0.99
    with pytest.raises(DatasetError, match="1000 times"):
        groups(test, 1000, seed=0)


@pytest.mark.rest
@pytest.mark.parametrize("name", ["lda", DEFAULT])
def test_reference_dockings_remove_a_constant_tilt(name: str) -> None:
    pytest.importorskip("sklearn", reason="trains with deltacharger[train]")
    rows = examples(generate_paper(rigs=(312,), seed=5, threshold=THRESHOLD), "horizontal")
    model = Classifier(name, "horizontal", THRESHOLD).fit(rows.frames, rows.labels)
    rig = Rig.draw(TactileParameters(), 312)
    tilted = dataclasses.replace(rig, tilt=rig.tilt + np.radians([0.0, 0.06]))

    def dockings(device: Rig, places: np.ndarray, seed: int) -> np.ndarray:
        pose = np.column_stack([places, np.zeros((len(places), 2))])
        readings = measure(TactileParameters(), device, pose, np.random.default_rng(seed), 1, THRESHOLD)
        frames = np.stack([readings["left"], readings["right"]], axis=1)
        frames[readings["dead"]] = np.nan
        return frames

    wanted = np.repeat(np.arange(5), 60)
    new, usual = (dockings(device, 0.005 * wanted - 0.010, 3) for device in (tilted, rig))
    before, as_trained = accuracy(model, new, wanted), accuracy(model, usual, wanted)
    ten = np.full(10, 2)
    with pytest.raises(ModelError, match="too few"):
        model.refer(new[:1], wanted[:1])
    model.refer(dockings(rig, np.zeros(10), 4), ten)
    assert accuracy(model, usual, wanted) > as_trained - 0.04, "little loss without a change"
    model.refer(dockings(tilted, np.zeros(10), 5), ten)
    assert accuracy(model, new, wanted) > before + 0.1


def test_classifiers_without_references_refuse_them() -> None:
    tree = packaged.load("tree")["vertical"]
    with pytest.raises(ModelError, match="train lda or pose"):
        tree.refer(np.zeros((3, 2, 10, 10)), np.zeros(3, dtype=int))
