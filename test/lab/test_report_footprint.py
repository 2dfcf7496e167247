# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report footprint`: measurements of a known process and of a scene, and the command's contract."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_lab.reports import formats
from deltacharger_lab.reports.footprint import plan as footprint_plan
from deltacharger_lab.reports.footprint import process as footprint_process
from deltacharger_lab.reports.footprint import report as footprint_report
from deltacharger_lab.reports.footprint.start import ONE, SEPARATE, WAYS, CannotRun, Started
from deltacharger_scenes.scene import load_scene, packaged_scenes

from ..chargers import DEADLINE, wait_until

pytest.importorskip("jinja2", reason="writes with deltacharger[report]")
psutil = pytest.importorskip("psutil", reason="measures with deltacharger[report]")
pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(bool(footprint_process.unsupported()), reason="only Linux reports what a process uses"),
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


def test_memory_of_a_process_is_counted(child: Child) -> None:
    plain, heavy = (footprint_process.usage([child(code).pid]) for code in ("", "held = b'x' * 50_000_000"))
    for key in ("pss", "rss"):
        assert getattr(heavy, key) - getattr(plain, key) == pytest.approx(50 * MEGA, abs=3 * MEGA)
    assert heavy.pss <= heavy.rss
    assert heavy.processes == heavy.threads == 1


def test_processor_time_is_counted_to_the_tick_and_waiting_is_not(child: Child) -> None:
    burn = "import time\nwhile time.process_time() < {}: pass\ntime.sleep(0.2)"
    spent = [footprint_process.usage([child(burn.format(seconds)).pid]).cpu for seconds in (0.2, 0.7)]
    assert spent[0] == pytest.approx(0.2, abs=0.1)  # including Python's start and printing
    assert spent[1] - spent[0] == pytest.approx(0.5, abs=0.1)


def test_children_threads_and_the_time_of_ended_children_count(child: Child) -> None:
    lazy = child(
        "import threading\n[threading.Thread(target=threading.Event().wait, daemon=True).start() for _ in '123']"
    )
    assert footprint_process.usage([lazy.pid]).threads == 4
    begun = "import subprocess, sys\n"
    living = child(begun + "p = subprocess.Popen([sys.executable, '-c', 'input()'], stdin=subprocess.PIPE)")
    assert len(footprint_process.family([living.pid])) == 2
    wait_until(lambda: footprint_process.usage([living.pid]).processes == 2, "both")
    burn = "import time\\nwhile time.process_time() < 0.5: pass"
    parent = child(begun + f"subprocess.run([sys.executable, '-c', '{burn}'])")
    alone = footprint_process.usage([parent.pid])
    assert alone.processes == 1
    assert alone.cpu >= 0.45
    together = footprint_process.usage([lazy.pid, living.pid])
    assert together.processes == 3


def test_an_ended_process_is_an_error(child: Child) -> None:
    process = child("")
    process.kill()
    wait_until(lambda: psutil.Process(process.pid).status() == psutil.STATUS_ZOMBIE, "its end")
    for _ in ("nobody has asked how it ended", "somebody has"):
        with pytest.raises(psutil.NoSuchProcess, match=str(process.pid)):
            footprint_process.usage([process.pid])
        process.wait(DEADLINE)


def test_only_libraries_in_memory_are_found(child: Child) -> None:
    pytest.importorskip("PIL")
    assert footprint_process.mapped([child("").pid]) == set()
    assert footprint_process.mapped([child("import PIL._imaging").pid]) == {"PIL"}


def test_a_library_in_plain_python_is_found_when_its_process_ends(tmp_path: Path, monkeypatch: Any) -> None:
    (tmp_path / "mcap").mkdir()
    (tmp_path / "mcap" / "__init__.py").touch()
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    started = Started(tmp_path)
    started.start("imports", "import importlib; importlib.import_module('mcap')")
    started.start("does not", "import json")
    for process in started.processes.values():
        assert process.wait(DEADLINE) == 0
    started.end()
    assert started.libraries == {"mcap"}
    assert {"json", "importlib"} <= started.modules


def test_a_process_that_ends_early_is_reported_with_its_last_line(tmp_path: Path) -> None:
    started = Started(tmp_path)
    started.start("some node", "import sys; sys.exit('the port is taken')")
    started.processes["some node"].wait(DEADLINE)
    with pytest.raises(CannotRun, match="some node ended with 1: the port is taken"):
        started.check()


def test_every_packaged_scene_is_measured_or_left_out_with_a_reason() -> None:
    plan = footprint_plan.make_plan()
    assert set(plan.scenes) | set(plan.left_out) == {load_scene(name).name for name in packaged_scenes()}
    assert not set(plan.scenes) & set(plan.left_out)
    assert {"bench", "simulated"} <= set(plan.scenes)
    assert all(plan.left_out.values())


def test_a_scene_that_needs_a_camera_or_a_recording_is_left_out_with_the_reason(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("nodes: [camera_node]\n", "utf-8")
    assert "OAK-D" in footprint_plan.make_plan([str(file)]).left_out["mine"]
    file.write_text("nodes: [camera_node]\nparameters: {camera_node: {replay: shots.mcap}}\n", "utf-8")
    assert list(footprint_plan.make_plan([str(file)]).scenes) == ["mine"]


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any], str]:
    """Run the command for real, on one small scene that runs and one that does not: its folder, answer and messages."""
    folder = tmp_path_factory.mktemp("footprint")
    small, broken = folder / "small.yaml", folder / "broken.yaml"
    small.write_text("simulation: {servos: board}\nnodes: [tactile_node, servo_node]\n", "utf-8")
    broken.write_text("nodes: [kinematics_node]\nparameters: {kinematics_node: {no_such: 1}}\n", "utf-8")
    command = [sys.executable, "-m", "deltacharger_bringup.cli", "report", "footprint", "--quick", "--json"]
    command += ["--scene", str(small), "--scene", str(broken), "--out", str(folder / "out")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ)
    assert ended.returncode == 0, ended.stderr
    return folder / "out", json.loads(ended.stdout), ended.stderr


@pytest.mark.rest
def test_both_ways_of_a_scene_are_measured(quick: tuple[Path, dict[str, Any], str]) -> None:
    folder, answer, messages = quick
    assert {Path(name) for name in answer["files"]} == set(folder.iterdir())
    rows = {row["way"]: row for row in answer["rows"]}
    assert set(rows) == set(WAYS)
    assert [rows[way]["processes"][0] for way in (ONE, SEPARATE)] == [1, 3]
    for row in rows.values():
        for key in ("ready_s", "pss_mb", "rss_mb", "rest_percent", "threads", "rest_tactile_frame_hz"):
            assert row[key][1] <= row[key][0] <= row[key][2]
            assert row[key][1] > 0.0
        assert row["docking_percent"] == [None] * 3
        assert not set(row["libraries"]) & set(footprint_report.NEVER)
    assert rows[ONE]["reports_ready_s"][0] > 0.0
    assert rows[SEPARATE]["reports_ready_s"] == [None] * 3
    assert rows[SEPARATE]["rss_mb"][0] > rows[SEPARATE]["pss_mb"][0] > 0.0
    assert "run 1 of 1" in messages


@pytest.mark.rest
def test_a_scene_that_does_not_run_is_reported_and_others_still_run(
    quick: tuple[Path, dict[str, Any], str],
) -> None:
    _, answer, messages = quick
    assert set(answer["left_out"]) == {f"broken, {way}" for way in WAYS}
    assert all("no_such" in why for why in answer["left_out"].values())
    assert "no_such" in messages


@pytest.mark.rest
def test_the_pages_tables_are_well_formed_and_have_the_measurements(quick: tuple[Path, dict[str, Any], str]) -> None:
    folder, answer, _ = quick
    page = (folder / "footprint.md").read_text("utf-8")
    tables = [block.split("\n") for block in page.strip().split("\n\n") if block.startswith("|")]
    assert len(tables) == 5
    for lines in tables:
        assert len({line.count("|") - line.count("\\|") for line in lines}) == 1, lines[0]
    costs = next(lines for lines in tables if "RSS" in lines[0])
    assert [line.split(" | ")[1] for line in costs[2:]] == list(WAYS)
    for line, row in zip(costs[2:], answer["rows"], strict=True):
        assert float(line.split(" | ")[7]) == pytest.approx(row["rss_mb"][0], abs=0.5)
    assert all(target["met"] is None for target in answer["targets"])
    assert "| not measured |" in page


def test_targets_are_judged_by_the_bench_scene_in_one_process() -> None:
    figures = {
        "rss_mb": 90.0,
        "rest_percent": 25.5,
        "docking_percent": float("nan"),
        "reports_ready_s": 4.0,
        "ready_s": 6.0,
    }
    figures |= {f"{when}_{name}_hz": 120.0 for when in ("rest", "docking") for name in ("tactile_frame", "servo_state")}
    run = {**figures, "libraries": ["scipy", "cv2"], "docking_problem": "x"}
    row = {"scene": "bench", "way": ONE, **footprint_report.summary([run, run])}
    other = {**row, "way": SEPARATE, "rest_percent": [1.0, 1.0, 1.0]}
    met = [target["met"] for target in footprint_report.targets([other, row])]
    assert met == [True, False, None, True, True, True, True, True, False, False]


def test_figures_of_several_runs_are_median_and_spread() -> None:
    runs = [{"a": value, "libraries": [], "docking_problem": ""} for value in (3.0, 1.0, float("nan"), 2.0)]
    assert footprint_report.summary(runs)["a"] == [2.0, 1.0, 3.0]
    assert formats.median([2.0, 1.0, 3.0], 1) == "2.0 (1.0–3.0)"
    assert formats.median([2.0, 2.01, 1.99], 1) == "2.0"
    assert formats.median([float("nan")] * 3, 1) == "–"


def test_a_missing_scene_exits_with_2_and_the_nearest_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(("report", "footprint", "--scene", "bensch", "--json")) == 2
    error = json.loads(capsys.readouterr().out)["error"]
    assert "--scene" in error
    assert "'bench'" in error


def test_with_nothing_to_measure_the_error_states_why(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("nodes: [camera_node]\n", "utf-8")
    assert main(("report", "footprint", "--scene", str(file), "--out", str(tmp_path / "out"), "--json")) == 1
    assert "OAK-D" in json.loads(capsys.readouterr().out)["error"]
    assert not (tmp_path / "out").exists()


def test_systems_other_than_linux_are_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert main(("report", "footprint", "--json")) == 1
    assert "only Linux" in json.loads(capsys.readouterr().out)["error"]
