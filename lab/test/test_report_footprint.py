# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report footprint`: which scenes it measures, its medians and targets."""

import math
from pathlib import Path

import pytest

from deltacharger_bringup.scenes.scene import load_scene, packaged_scenes
from deltacharger_lab.reports.footprint import measure as footprint, report as footprint_report
from deltacharger_lab.reports.footprint.measure import ONE, SEPARATE

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(bool(footprint.unsupported()), reason="only Linux reports what a process uses"),
]


def test_a_scene_is_measured_or_left_out_with_a_reason(tmp_path: Path) -> None:
    plan = footprint.make_plan()
    assert {"bench", "simulated"} <= set(plan.scenes)
    assert set(plan.scenes) | set(plan.left_out) == {load_scene(name).name for name in packaged_scenes()}
    assert not set(plan.scenes) & set(plan.left_out)
    file = tmp_path / "mine.yaml"
    file.write_text("nodes: [camera_node]\n", "utf-8")
    assert "OAK-D" in footprint.make_plan([str(file)]).left_out["mine"]


def test_targets_are_judged_by_the_bench_scene_in_one_process_and_figures_are_medians_with_their_range() -> None:
    figures = {"rss_mb": 90.0, "rest_percent": 25.5, "docking_percent": math.nan}
    figures |= {"reports_ready_s": 4.0, "ready_s": 6.0}
    figures |= {f"{when}_{name}_hz": 120.0 for when in ("rest", "docking") for name in ("tactile_frame", "servo_state")}
    run = {**figures, "docking_problem": "x"}
    row = {"scene": "bench", "way": ONE, **footprint_report.summary([run, run])}
    other = {**row, "way": SEPARATE, "rest_percent": [1.0, 1.0, 1.0]}
    met = [target["met"] for target in footprint_report.targets([other, row])]
    assert met == [True, False, None, True, True, True, True, True, False]
    runs = [{"a": value, "docking_problem": ""} for value in (3.0, 1.0, math.nan, 2.0)]
    assert footprint_report.summary(runs)["a"] == [2.0, 1.0, 3.0]
