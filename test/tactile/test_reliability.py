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
from deltacharger_tactile.parameters import TactileParameters

from ..marks import rest
from .small_paper import small_paper

Frames = NDArray[np.float64]
RIG, THRESHOLD = 311, 0.25


def docked(target: str, seed: int, parameters: TactileParameters | None = None, rig: int = RIG) -> Frames:
    data = small_paper((rig,), seed, 0.0, parameters, angles=60, positions=12)
    return np.nan_to_num(examples(data, target).frames)


Known = tuple[Familiarity, Frames]


@pytest.fixture(scope="module", params=["angle", rest("horizontal")])
def known(request: pytest.FixtureRequest) -> Known:
    """What was learnt from a rig, and frames of other dockings of the same rig."""
    learnt, other = (docked(request.param, seed) for seed in (1, 2))
    return familiarity.learn(learnt, THRESHOLD), other


def fired(known: Familiarity, frames: Frames, size: int = WINDOW) -> float:
    random = np.random.default_rng(0)
    windows = [frames[random.choice(len(frames), size, replace=False)] for _ in range(20)]
    return float(np.mean([known.strange_together(window, THRESHOLD) for window in windows]))


def force(share: float) -> TactileParameters:
    base = TactileParameters()
    weaker = {name: share * getattr(base.docking, name) for name in ("magnet_force", "push_per_ampere")}
    return dataclasses.replace(base, docking=dataclasses.replace(base.docking, **weaker))


def test_other_dockings_of_the_same_rig_are_familiar(known: Known) -> None:
    learnt, frames = known
    assert learnt.strange(frames, THRESHOLD).mean() <= 0.01
    assert fired(learnt, frames) <= 0.05
    window = frames[::7][:WINDOW].copy()
    window[0] = 0.0
    assert not learnt.strange_together(window, THRESHOLD), "one strange docking does not decide"


@pytest.mark.parametrize("change", ["weaker", "another rig"])
def test_a_slow_change_shows_in_a_window_though_not_in_a_frame(known: Known, change: str) -> None:
    learnt, usual = known
    target = "angle" if len(usual) == 360 else "horizontal"
    frames = docked(target, 2, force(0.8)) if change == "weaker" else docked(target, 2, rig=RIG + 1)
    assert learnt.strange(frames, THRESHOLD).mean() < 0.5
    assert fired(learnt, frames) > 0.9


def test_gross_changes_show_in_each_frame_and_lost_rows_in_a_window(known: Known) -> None:
    learnt, frames = known
    for strange in (0.4 * frames, 2.5 * frames, np.zeros_like(frames)):
        assert learnt.strange(strange, THRESHOLD).mean() > 0.9
    lost = frames.copy()
    lost[:, 0, 4:6] = 0.0
    assert fired(learnt, lost, 2 * WINDOW) > 0.5


def test_saving_and_loading_preserve_the_statistics(known: Known) -> None:
    learnt, frames = known
    again = Reliability.from_dict(json.loads(json.dumps(Reliability(0.3, learnt).to_dict())))
    for one, two in zip(*(each.distances(frames, THRESHOLD) for each in (learnt, again.familiar)), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-3)
    assert again.quantile == 0.3
    with pytest.raises(ModelError, match=f"at least {WINDOW}"):
        again.drifted_together(frames[: WINDOW - 1], THRESHOLD)


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
