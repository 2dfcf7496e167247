# SPDX-License-Identifier: Apache-2.0
"""The paper's protocol by docking's own movements on the simulated charger, compared with the generated set."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltacharger_lab.campaigns.recording import Protocol, dataset, record_part
from deltacharger_lab.reports.tactile.measure import accuracy, fitted
from deltacharger_lab.reports.tactile.plan import TARGETS, TactilePlan
from deltacharger_lab.training import splits
from deltacharger_tactile.classifiers import labels
from deltacharger_tactile.dataset import SUBSET_ANGLE


def judge(rig: int, seed: int, plan: TactilePlan) -> dict[str, Any]:
    """Record both sets on one rig, and judge every model on them, each third by training on the others.

    Returns:
        rig; `left` (2,) m, root mean square of the offset that vision left along x and y; `models`, by name and
        target the correct share.
    """
    recording = Protocol(rig, seed, threshold=0.0)
    data = dataset(recording, [(part, touch) for part in recording.parts() for touch in record_part(recording, part)])
    found: dict[str, Any] = {"rig": rig, "models": {name: {} for name in plan.names}}
    of_angle = data.subset == SUBSET_ANGLE
    commanded = np.column_stack([data.horizontal, data.vertical])[of_angle]
    found["left"] = np.sqrt(np.mean(commanded**2, axis=0)).tolist()
    for target in TARGETS:
        rows = labels.examples(data, target)
        for name in plan.names:
            right = [
                accuracy(fitted(name, target, rows.part(learns), seed), rows.part(judges))
                for learns, judges in splits.thirds(rows, seed)
            ]
            found["models"][name][target] = float(np.mean(right))
    return found


def table(measured: list[dict[str, Any]], generated: list[dict[str, Any]]) -> dict[str, Any]:
    """Return by model and target the correct share of the recorded and generated sets of the same rigs."""
    if not measured:
        return {}
    rigs = {row["rig"] for row in measured}
    rows = {}
    for name in measured[0]["models"]:
        rows[name] = {
            target: {
                "recorded": float(np.mean([row["models"][name][target] for row in measured])),
                "generated": float(
                    np.mean(
                        [
                            row["accuracy"]
                            for row in generated
                            if (row["model"], row["target"]) == (name, target) and row["rig"] in rigs
                        ]
                    )
                ),
            }
            for target in TARGETS
        }
    left = np.sqrt(np.mean([np.square(row["left"]) for row in measured], axis=0)).tolist()
    return {"rigs": sorted(rigs), "left": left, "models": rows}
