# SPDX-License-Identifier: Apache-2.0
"""The same models under four splits of data with several rows per docking."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltacharger_lab.reports.tactile.measure import accuracy, fitted
from deltacharger_lab.training import splits
from deltacharger_lab.training.splits import Rows
from deltacharger_sim.pads.generator import generate_paper
from deltacharger_tactile.classifiers import labels
from deltacharger_tactile.classifiers.labels import Examples
from deltacharger_tactile.errors import DatasetError

ROWS = 3
"""Rows of each docking in this comparison; the paper has one."""
SPLITS = ("by docking", "random by frame", "leave one rig out", "leave one session out")
BY_DOCKING, BY_FRAME, RIG_OUT, SESSION_OUT = SPLITS
_SHARE = 0.67
_DOCKINGS = 0.34  # of the dockings of a rig, to bound the total time


def compare(name: str, target: str, rigs: tuple[int, ...], seed: int) -> list[dict[str, Any]]:
    """Return the accuracy of one model under every split; data of all rigs together, some of their dockings.

    Args:
        name: of the model.
        target: of the prediction.
        rigs: seeds of the devices.
        seed: of dockings and splits.
    """
    every = labels.examples(generate_paper(rigs=rigs, seed=seed, threshold=0.0, rows=ROWS), target)
    rows = every.part(splits.by_docking(every, seed, _DOCKINGS)[0])
    parts = {
        BY_DOCKING: [splits.by_docking(rows, seed, _SHARE)],
        BY_FRAME: [by_frame(rows, seed, _SHARE)],
        RIG_OUT: leave_one_out(rows, "rigs"),
        SESSION_OUT: leave_one_out(rows, "sessions")[:: len(rigs)],
    }
    found = []
    for split, pairs in parts.items():
        right = [accuracy(fitted(name, target, rows.part(learns), seed), rows.part(judges)) for learns, judges in pairs]
        found.append({"model": name, "target": target, "split": split, "accuracy": float(np.mean(right))})
    return found


def by_frame(examples: Examples, seed: int, share: float) -> tuple[Rows, Rows]:
    """Split frames at random, ignoring dockings; optimistic if a docking has several frames."""
    order = np.random.default_rng([0xF4A3E, seed]).permutation(len(examples))
    count = round(share * len(order))
    return np.sort(order[:count]), np.sort(order[count:])


def leave_one_out(examples: Examples, what: str) -> list[tuple[Rows, Rows]]:
    """Return one split for each rig or session, which alone is the test set.

    Args:
        examples: to split.
        what: `rigs` or `sessions`.

    Raises:
        DatasetError: there is only one.
    """
    owners = getattr(examples, what)
    every = np.unique(owners)
    if len(every) < 2:
        raise DatasetError(what, "there is only one; generate or record more of them")
    return [(np.flatnonzero(owners != owner), np.flatnonzero(owners == owner)) for owner in every]
