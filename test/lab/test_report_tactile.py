# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report tactile` and `tactile compare`: its plan, its arithmetic and its workers."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from deltacharger_lab.reports.page import write_html
from deltacharger_lab.reports.pool import ReportFailed, ReportTask, work
from deltacharger_lab.reports.tactile import plan as tactile_plan
from deltacharger_lab.reports.tactile.report import FIRES, HOLDS, NEITHER, accuracies, shifts
from deltacharger_tactile.classifiers.classifier import Classifier

TARGETS = ("angle", "vertical", "horizontal")


def test_without_libraries_their_rows_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("xgboost", "torch"):
        monkeypatch.setitem(sys.modules, module, None)
    assert set(tactile_plan.absent()) == {"xgboost", "torch"}
    names = tactile_plan.full_plan(1).names
    assert not {"xgboost", "nn", "cnn"} & set(names)
    assert "forest" in names
    monkeypatch.setitem(sys.modules, "sklearn", None)
    assert tactile_plan.full_plan(1).names == ()


def test_a_verdict_needs_coverage_or_an_alarm() -> None:
    base = {"model": "m", "target": "angle", "accuracy": 0.9, "act_rate": 0.9, "drift_rate": 0.0, "n": 600}
    cases = {"held": (0.95, 0.0, HOLDS), "lost": (0.5, 0.0, NEITHER), "told": (0.5, 0.9, FIRES)}
    rows = [
        {**base, "shift": name, "coverage": coverage, "windows": [0.0, windows], "seed": seed}
        for name, (coverage, windows, _) in cases.items()
        for seed in range(3)
    ]
    assert {row["shift"]: row["verdict"] for row in shifts(rows)} == {name: case[2] for name, case in cases.items()}


def test_the_interval_is_over_rigs() -> None:
    rows = [
        {"model": "m", "target": target, "rig": rig, "accuracy": 0.9 + 0.02 * rig + 0.01 * seed, "fit_s": 1.0}
        for target in TARGETS
        for rig in range(3)
        for seed in (-1, 1)
    ]
    found = accuracies(rows, ["m"])["m"]["angle"]
    assert found["mean"] == pytest.approx(0.92)
    assert found["half"] == pytest.approx(4.303 * 0.02 / 3**0.5, rel=1e-3)


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


def test_the_html_file_contains_its_pictures(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x89PNG")
    (tmp_path / "page.md").write_text(
        "# A & B\n\n| x | y |\n|---|---|\n| 1 | **2** |\n\n![c](a.png)\n\n- one\n", "utf-8"
    )
    write_html(tmp_path / "page.md", tmp_path / "page.html")
    whole = (tmp_path / "page.html").read_text("utf-8")
    assert "<h1>A &amp; B</h1>" in whole
    assert "<td><strong>2</strong></td>" in whole
    assert 'src="data:image/png;base64,iVBORw=="' in whole
