# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report footprint`: measurements of a known process and of a scene, and the command's contract."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from deltacharger_lab.reports.footprint import measure as footprint
from deltacharger_lab.reports.footprint import report as footprint_report
from deltacharger_lab.reports.footprint.measure import ONE, SEPARATE
from deltacharger_scenes.scene import load_scene, packaged_scenes
from test.chargers import wait_until

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(bool(footprint.unsupported()), reason="only Linux reports what a process uses"),
]
MEGA = 1_000_000
PAUSE = "\nimport sys\nprint('ready', flush=True)\nsys.stdin.read()"

Child = Callable[[str], "subprocess.Popen[str]"]


@pytest.fixture
def child() -> Iterator[Child]:
    """Start Python code that prints 'ready' and then waits; it ends with the test."""
    running: list[subprocess.Popen[str]] = []

    def start(code: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", code + PAUSE]
        running.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        assert running[-1].stdout is not None
        assert running[-1].stdout.readline() == "ready\n"
        return running[-1]

    yield start
    for each in running:
        each.kill()
        each.communicate()


@pytest.mark.rest
def test_memory_threads_and_children_of_a_process_are_counted(child: Child) -> None:
    plain = child("")
    heavy = child("import threading\nheld = b'x' * 50_000_000\nthreading.Thread(target=input, daemon=True).start()")
    begun = child("import subprocess, sys\np = subprocess.Popen([sys.executable, '-c', 'input()'], stdin=-1)")
    alone, more = (footprint.usage([each.pid]) for each in (plain, heavy))
    for key in ("pss", "rss"):
        assert getattr(more, key) - getattr(alone, key) == pytest.approx(50 * MEGA, abs=3 * MEGA)
    assert (alone.processes, alone.threads, more.threads) == (1, 1, 2)
    assert len(footprint.family([begun.pid])) == 2
    wait_until(lambda: footprint.usage([plain.pid, begun.pid]).processes == 3, "all")
    plain.kill()
    wait_until(lambda: psutil.Process(plain.pid).status() == psutil.STATUS_ZOMBIE, "its end")
    with pytest.raises(psutil.NoSuchProcess, match=str(plain.pid)):
        footprint.usage([plain.pid])


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
