# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report tactile` and `tactile compare`: the comparison on simulated data, and the command's contract."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import pytest

from deltacharger_lab.reports.page import write_html
from deltacharger_lab.reports.pool import ReportFailed, ReportTask, work
from deltacharger_lab.reports.tactile import plan as tactile_plan
from deltacharger_lab.reports.tactile import splits as tactile_splits
from deltacharger_lab.reports.tactile.pictures import PICTURES
from deltacharger_lab.reports.tactile.report import FIRES, HOLDS, NEITHER, accuracies, shifts
from deltacharger_lab.reports.tactile.shifts import SHIFTS
from deltacharger_tactile.classifiers.classifier import Classifier

from .conftest import Quick

TARGETS = ("angle", "vertical", "horizontal")

REPORT = ("tactile",)
MEASURES_WITH = ("sklearn", "torch", "matplotlib")


def test_every_model_is_better_than_chance_and_every_shift_is_judged(quick_report: Quick) -> None:
    figures = quick_report[2]
    for name in figures["models"]:
        for target in TARGETS:
            assert figures["accuracy"][name][target]["mean"] > 0.6, (name, target)
            assert 0.0 < figures["times"][name][target]["median_ms"] <= figures["times"][name][target]["p99_ms"]
    judged = {(row["model"], row["target"], row["shift"]) for row in figures["shifts"]}
    assert judged == {
        (name, target, shift.name) for name in figures["judged"] for target in TARGETS for shift in SHIFTS
    }
    assert {row["verdict"] for row in figures["shifts"]} <= {HOLDS, FIRES, NEITHER}


def test_a_random_split_by_frame_is_optimistic(quick_report: Quick) -> None:
    found = {(row["model"], row["target"], row["split"]): row["accuracy"] for row in quick_report[2]["splits"]}
    honest = found["forest", "horizontal", tactile_splits.BY_DOCKING]
    assert found["forest", "horizontal", tactile_splits.BY_FRAME] > honest + 0.02
    assert found["forest", "horizontal", tactile_splits.RIG_OUT] < honest


def test_more_dockings_improve_the_accuracy(quick_report: Quick) -> None:
    found = {row["name"].split(",")[0]: row["horizontal"] for row in quick_report[2]["ceiling"]}
    assert found["1 docking"] < found["3 dockings"] >= 0.98


def test_every_judged_model_and_both_estimates_are_tested_on_unseen_physics(quick_report: Quick) -> None:
    _, _, figures, page = quick_report
    found = figures["second"]
    assert {(row["model"], row["target"]) for row in found["models"]} == {
        (name, target) for name in figures["judged"] for target in TARGETS
    }
    assert {(row["physics"], row["threshold"]) for row in found["estimates"]} == {
        (physics, cut) for physics in ("first", "second") for cut in (0.25, 1.0)
    }
    section = page.split("## On contact physics that no model has seen")[1].split("\n## ")[0]
    assert section.count("\n| ") == 3 + len(found["models"]) + len(found["estimates"]) + len(found["variants"])
    assert found["digest"] in section
    assert sum("second physics" in row["name"] for row in figures["targets"]) == 3


def test_every_table_and_picture_is_marked_as_simulated(quick_report: Quick) -> None:
    folder, _, _, page = quick_report
    lines = page.splitlines()
    heads = [lines[index - 1] for index, line in enumerate(lines) if line.startswith("|---")]
    assert heads
    assert all("simulated" in head for head in heads), heads
    assert all("simulated" in each for each in re.findall(r"!\[(.*?)\]", page))
    whole = (folder / "tactile.html").read_text("utf-8")
    assert whole.count("data:image/png;base64,") == len(PICTURES)
    assert 'src="tactile' not in whole
    assert whole.count("<table>") == len(heads)


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


def test_results_are_in_the_order_of_tasks() -> None:
    tasks = [ReportTask("sum", sum, ([index, 1],), float(weight)) for index, weight in enumerate((1, 5, 2))]
    messages: list[str] = []
    assert work(tasks, messages.append) == {"sum": [1, 2, 3]}
    assert messages[-1].startswith("100 %")


def test_a_task_that_fails_ends_the_work_with_its_trace() -> None:
    tasks = [ReportTask("sum", max, (1, 2)), ReportTask("model", Classifier.load, ("/nowhere.npz",))]
    with pytest.raises(ReportFailed, match=r"model.*nowhere\.npz"):
        work(tasks, lambda message: None)


def test_a_task_without_its_library_names_it() -> None:
    with pytest.raises(ModuleNotFoundError) as missing:
        work([ReportTask("import", importlib.import_module, ("no_such_library",))], lambda message: None)
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
