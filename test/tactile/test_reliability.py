# SPDX-License-Identifier: Apache-2.0
"""Detection of unfamiliar frames: single ones, and slow changes that only a window of dockings shows."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from numpy.typing import NDArray

from deltacharger_tactile.classifiers import familiarity, reliability
from deltacharger_tactile.classifiers.familiarity import WINDOW, Familiarity
from deltacharger_tactile.classifiers.labels import examples
from deltacharger_tactile.classifiers.reliability import Reliability
from deltacharger_tactile.errors import ModelError
from deltacharger_tactile.generator import generate_paper
from deltacharger_tactile.parameters import TactileParameters

from ..marks import rest

Frames = NDArray[np.float64]
RIG, THRESHOLD = 311, 0.25
TARGETS = ("angle", rest("horizontal"))


def docked(target: str, seed: int, parameters: TactileParameters | None = None, rig: int = RIG) -> Frames:
    data = generate_paper(parameters, rigs=(rig,), seed=seed, threshold=0.0)
    return np.nan_to_num(examples(data, target).frames)


@pytest.fixture(scope="module", params=TARGETS)
def known(request: pytest.FixtureRequest) -> tuple[str, Familiarity]:
    return request.param, familiarity.learn(docked(request.param, 1), THRESHOLD)


Known = tuple[str, Familiarity]


def fired(known: Familiarity, frames: Frames, size: int = WINDOW) -> float:
    random = np.random.default_rng(0)
    windows = [frames[random.choice(len(frames), size, replace=False)] for _ in range(40)]
    return float(np.mean([known.strange_together(window, THRESHOLD) for window in windows]))


def force(share: float) -> TactileParameters:
    base = TactileParameters()
    weaker = {name: share * getattr(base.docking, name) for name in ("magnet_force", "push_per_ampere")}
    return dataclasses.replace(base, docking=dataclasses.replace(base.docking, **weaker))


def test_other_dockings_of_the_same_rig_are_familiar(known: Known) -> None:
    target, learnt = known
    frames = docked(target, 2)
    assert learnt.strange(frames, THRESHOLD).mean() <= 0.01
    assert fired(learnt, frames) <= 0.05


def test_a_slow_change_shows_in_a_window_though_not_in_a_frame(known: Known) -> None:
    target, learnt = known
    weaker, other = docked(target, 2, force(0.8)), docked(target, 2, rig=RIG + 1)
    for frames in (weaker, other):
        assert learnt.strange(frames, THRESHOLD).mean() < 0.5
        assert fired(learnt, frames) > 0.9


def test_gross_changes_show_in_each_frame(known: Known) -> None:
    target, learnt = known
    frames = docked(target, 2)
    for strange in (0.4 * frames, 2.5 * frames, np.zeros_like(frames)):
        assert learnt.strange(strange, THRESHOLD).mean() > 0.9


def test_a_pad_that_lost_rows_is_detected(known: Known) -> None:
    target, learnt = known
    frames = docked(target, 2)
    frames[:, 0, 4:6] = 0.0
    assert fired(learnt, frames, 2 * WINDOW) > 0.5


def test_one_strange_docking_does_not_decide_for_a_window(known: Known) -> None:
    target, learnt = known
    window = docked(target, 2)[::7][:WINDOW].copy()
    assert not learnt.strange_together(window, THRESHOLD)
    window[0] = 0.0
    assert not learnt.strange_together(window, THRESHOLD)


def test_saving_and_loading_preserve_the_statistics(known: Known) -> None:
    target, learnt = known
    kept = Reliability(0.3, learnt)
    again = Reliability.from_dict(json.loads(json.dumps(kept.to_dict())))
    frames = docked(target, 2)
    one, two = kept.familiar.distances(frames, THRESHOLD), again.familiar.distances(frames, THRESHOLD)
    np.testing.assert_allclose(one[0], two[0], rtol=1e-3)
    np.testing.assert_allclose(one[1], two[1], rtol=1e-3)
    assert again.quantile == 0.3


def test_a_window_needs_enough_dockings(known: Known) -> None:
    target, learnt = known
    frames = docked(target, 2)[: WINDOW - 1]
    with pytest.raises(ModelError, match=f"at least {WINDOW}"):
        Reliability(0.3, learnt).drifted_together(frames, THRESHOLD)


def test_sets_of_held_out_frames_reach_nominal_coverage() -> None:
    random = np.random.default_rng(5)
    frames = docked("angle", 1)[:200]
    odds = random.gumbel(size=(200, 6))
    labels = np.argmax(odds + random.gumbel(size=(200, 6)), axis=1)
    shares = np.exp(odds) / np.exp(odds).sum(axis=1, keepdims=True)
    learnt = reliability.learn(shares, labels, frames, THRESHOLD)
    covered = learnt.sets(shares)[np.arange(200), labels].mean()
    assert reliability.NOMINAL <= covered <= reliability.NOMINAL + 0.015
    familiar = reliability.learn(shares, labels, frames, THRESHOLD, familiar=docked("angle", 3))
    assert familiar.quantile == learnt.quantile
    assert not np.array_equal(familiar.familiar.weights, learnt.familiar.weights)
