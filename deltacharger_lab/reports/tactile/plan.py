# SPDX-License-Identifier: Apache-2.0
"""What the tactile report measures: models, rigs, seeds, shifts; and which libraries are absent."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_tactile.classifiers.classifier import DEFAULT, NAMES
from deltacharger_tactile.estimator import THRESHOLD

TARGETS = ("angle", "vertical", "horizontal")
SETS = {"angle": ("angle",), "position": ("vertical", "horizontal")}
"""The paper's two data sets, and what is learnt from each."""
KINDS = {"shallow": "shallow", "deep": "deep", "physical": "physical features"}
"""Kinds of model, as pictures tell them apart."""
_TITLES = {"logistic": "LR", "tree": "DT", "forest": "RF", "xgboost": "XGBoost", "pose": "pose"}  # no mere capitals
_LIBRARIES = {"xgboost": "xgboost", "nn": "torch", "cnn": "torch"}  # scikit-learn trains the others


@dataclass(frozen=True)
class TactilePlan:
    """What is measured.

    Attributes:
        rigs: seeds of simulated devices that served no tuning.
        seeds: of the dockings, on each rig.
        names: models.
        judged: those of the table of shifts, of reliability and confusion.
        split_rigs: devices of the comparison of splits.
        ceiling_sets: paper-size sets of one rig that the ceiling is learnt from.
        ceiling_rigs: devices of the section on one and several dockings.
        windows: windows of dockings drawn from each data set.
        repeats: single predictions that are timed.
        second_count: dockings of the second contact physics on each rig by which the pretrained estimates are judged.
        quick: whether this is the short plan.
    """

    rigs: tuple[int, ...]
    seeds: tuple[int, ...]
    names: tuple[str, ...]
    judged: tuple[str, ...]
    split_rigs: tuple[int, ...]
    ceiling_sets: int
    ceiling_rigs: tuple[int, ...]
    windows: int
    repeats: int
    second_count: int
    quick: bool


def full_plan(seed: int) -> TactilePlan:
    """Return what the report measures by default: 10 rigs, each docked once through the protocol."""
    names = _trainable(tuple(NAMES))
    judged = _trainable(("forest", "cnn", "lda", "pose"))
    seeds = (3 * seed,)
    rigs = tuple(range(860, 870))
    return TactilePlan(rigs, seeds, names, judged, (860, 861, 862), 18, (860, 861), 60, 2000, 600, quick=False)


def quick_plan(seed: int) -> TactilePlan:
    """Return what a quick look and the tests measure: one rig, one seed, few models."""
    names = _trainable(("forest", "nn", "lda", "pose"))
    judged = _trainable(("lda", "pose"))
    return TactilePlan((860,), (3 * seed,), names, judged, (860, 861), 3, (860,), 20, 200, 60, quick=True)


def default(plan: TactilePlan) -> str:
    """Return the default estimator, or the best of those that can be trained here; '' where there is none."""
    return next((name for name in (DEFAULT, "lda", *plan.names) if name in plan.names), "")


def title(name: str) -> str:
    """Return how pictures and tables call a model."""
    return _TITLES.get(name, name.upper())


def kind(name: str) -> str:
    """Return the kind of a model: a key of `KINDS`."""
    if NAMES[name][1] != "taxels":
        return "physical"
    return NAMES[name][0]


def threshold(name: str) -> float:
    """Return what a model counts as nothing, N: the paper's 1 N, or that of the packaged pose model."""
    return THRESHOLD if NAMES[name][1] == "pose" else CONTACT_FORCE


def absent() -> dict[str, str]:
    """Return for each library that is not installed what is left out."""
    found = {}
    for module, what in (("sklearn", "scikit-learn's models"), ("xgboost", "XGBoost"), ("torch", "NN and CNN")):
        if find_spec(module) is None:
            found[module] = f"{what} left out; install deltacharger[train]"
    return found


def _trainable(names: tuple[str, ...]) -> tuple[str, ...]:
    gone = absent()
    return tuple(name for name in names if _LIBRARIES.get(name, "sklearn") not in gone)
