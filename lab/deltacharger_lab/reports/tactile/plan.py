# SPDX-License-Identifier: Apache-2.0
"""Plan of the tactile report: models, rigs, seeds, shifts; and missing libraries."""

from dataclasses import dataclass
from importlib.util import find_spec

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_lab.training import classifier, inputs
from deltacharger_tactile.estimator import THRESHOLD

TARGETS = ("angle", "vertical", "horizontal")
SETS = {"angle": ("angle",), "position": ("vertical", "horizontal")}
"""The paper's two data sets, and the targets learnt from each."""
KINDS = {"shallow": "shallow", "deep": "deep", "physical": "physical features"}
"""Kinds of model in pictures."""
_TITLES = {"logistic": "LR", "tree": "DT", "forest": "RF", "xgboost": "XGBoost", "pose": "pose"}  # not just upper case
_LIBRARIES = {"xgboost": "xgboost", "nn": "torch", "cnn": "torch"}  # scikit-learn trains the others


@dataclass(frozen=True)
class TactilePlan:
    """Extent of the measurement.

    Attributes:
        rigs: seeds of simulated devices; none was used for tuning.
        seeds: of the dockings, on each rig.
        names: models.
        judged: models in the tables of shifts, reliability and confusion.
        variant_rigs: devices on which families of the second contact physics are judged.
        windows: windows of dockings drawn from each data set.
        repeats: single predictions that are timed.
        second_count: dockings of the second contact physics on each rig, for the pretrained estimates.
        quick: whether this is the short plan.
    """

    rigs: tuple[int, ...]
    seeds: tuple[int, ...]
    names: tuple[str, ...]
    judged: tuple[str, ...]
    variant_rigs: tuple[int, ...]
    windows: int
    repeats: int
    second_count: int
    quick: bool


def full_plan(seed: int) -> TactilePlan:
    """Return the default plan: 10 rigs, each docked once through the protocol."""
    names = _trainable(tuple(inputs.NAMES))
    judged = _trainable(("forest", "cnn", "lda", "pose"))
    seeds = (3 * seed,)
    rigs = tuple(range(860, 870))
    return TactilePlan(rigs, seeds, names, judged, (860, 861), 60, 2000, 600, quick=False)


def quick_plan(seed: int) -> TactilePlan:
    """Return the short plan, also of the tests: one rig, one seed, few models."""
    names = _trainable(("forest", "nn", "lda", "pose"))
    judged = _trainable(("lda", "pose"))
    return TactilePlan((860,), (3 * seed,), names, judged, (860,), 20, 200, 60, quick=True)


def default(plan: TactilePlan) -> str:
    """Return the default estimator, or the best of those that can be trained here; '' for none."""
    return next((name for name in (classifier.DEFAULT, "lda", *plan.names) if name in plan.names), "")


def title(name: str) -> str:
    """Return the name of a model in pictures and tables."""
    return _TITLES.get(name, name.upper())


def kind(name: str) -> str:
    """Return the kind of a model: a key of `KINDS`."""
    return classifier.TRAINERS[name] if inputs.NAMES[name] == "taxels" else "physical"


def threshold(name: str) -> float:
    """Return the threshold of a model's readings, N: the paper's 1 N, or that of the packaged pose model."""
    return THRESHOLD if inputs.NAMES[name] == "pose" else CONTACT_FORCE


def absent() -> dict[str, str]:
    """Return for each missing library what is left out."""
    found = {}
    for module, what in (("sklearn", "scikit-learn's models"), ("xgboost", "XGBoost"), ("torch", "NN and CNN")):
        if find_spec(module) is None:
            found[module] = f"{what} left out; install deltacharger-lab[train]"
    return found


def _trainable(names: tuple[str, ...]) -> tuple[str, ...]:
    gone = absent()
    return tuple(name for name in names if _LIBRARIES.get(name, "sklearn") not in gone)
