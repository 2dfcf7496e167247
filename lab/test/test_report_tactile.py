# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report tactile` and `tactile compare`: its plan, its arithmetic and its workers."""

import importlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deltacharger_lab.reports.pool import ReportFailed, ReportTask, work
from deltacharger_lab.reports.tactile import second
from deltacharger_lab.reports.tactile.report import FIRES, HOLDS, NEITHER, shifts
from deltacharger_lab.training.estimator import to_seat
from deltacharger_sim.pads import generate_continuous
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.estimator import Estimate


def telling(pose: np.ndarray, stddev: float) -> Any:
    """Return an estimator of given poses (N, 3), or one for all frames, with `stddev`."""

    def predict(left: np.ndarray, _: np.ndarray) -> Estimate:
        x, y, angle = np.broadcast_to(pose, (len(left), 3)).T
        small, yes, none = np.full(len(left), stddev), np.ones(len(left), dtype=bool), np.zeros(len(left))
        chances, forces = [np.zeros((len(left), 6))] * 3, [none] * 2
        across = to_seat(np.column_stack([x, y, angle]))[:, 1]
        return Estimate(angle, small, y, small, x, small, yes, yes, yes, *chances, *forces, across, small)

    return SimpleNamespace(predict=predict, drifted=lambda left, _: np.zeros(len(left), dtype=bool))


@pytest.mark.rest
@pytest.mark.parametrize(("exact", "most"), [(True, 0.0), (False, 0.9)])
def test_an_act_without_clearance_is_unsafe(monkeypatch: pytest.MonkeyPatch, exact: bool, most: float) -> None:
    data = generate_continuous(rigs=(860,), count=600, seed=3, threshold=0.0)
    told = telling(data.contact_pose, 1e-6) if exact else telling(np.zeros(3), 1e-4)
    monkeypatch.setattr(second, "default_model", lambda cut: told)
    row = second._counts(data, 0.25)
    assert row["acts"] > 50
    assert 0.2 * most * row["n"] <= row["unsafe"] <= most * row["n"], "most of ±12 mm and ±20° leaves no clearance"


def test_a_verdict_needs_coverage_or_an_alarm() -> None:
    base = {"model": "m", "target": "angle", "accuracy": 0.9, "act_rate": 0.9, "drift_rate": 0.0, "n": 600}
    cases = {"held": (0.95, 0.0, HOLDS), "lost": (0.5, 0.0, NEITHER), "told": (0.5, 0.9, FIRES)}
    rows = [
        {**base, "shift": name, "coverage": coverage, "windows": [0.0, windows], "seed": seed}
        for name, (coverage, windows, _) in cases.items()
        for seed in range(3)
    ]
    assert {row["shift"]: row["verdict"] for row in shifts(rows)} == {name: case[2] for name, case in cases.items()}


@pytest.mark.rest
def test_results_are_in_the_order_of_tasks_and_a_failing_one_ends_the_work_with_its_trace() -> None:
    tasks = [ReportTask("sum", sum, ([index, 1],), float(weight)) for index, weight in enumerate((1, 5, 2))]
    messages: list[str] = []
    assert work(tasks, messages.append) == {"sum": [1, 2, 3]}
    assert messages[-1].startswith("100 %")
    with pytest.raises(ReportFailed, match=r"model.*nowhere\.npz"):
        work([*tasks, ReportTask("model", Classifier.load, ("/nowhere.npz",))], messages.append)
    with pytest.raises(ModuleNotFoundError) as missing:
        work([ReportTask("import", importlib.import_module, ("no_such_library",))], messages.append)
    assert missing.value.name == "no_such_library"
