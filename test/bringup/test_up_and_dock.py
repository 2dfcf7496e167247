# SPDX-License-Identifier: Apache-2.0
"""`deltacharger up` and `deltacharger dock` as separate processes: signals and exit codes."""

from __future__ import annotations

import json
import os
import shlex
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from deltacharger_core import environment, runtime
from deltacharger_scenes.scene import Scene

from ..chargers import Process, wait_until
from ..scenes.test_processes import arguments

pytestmark = pytest.mark.ros


Run = Callable[..., Process]


@pytest.fixture
def run(start: Run, deltacharger: tuple[str, ...], quick_file: Path, namespace: str) -> Run:
    """Start a command on the quick scene in the namespace of the test."""
    where = ("--scene", str(quick_file), "--namespace", namespace)
    return lambda command, *words: start(*deltacharger, command, *where, *words)


@pytest.fixture
def up(run: Run) -> Run:
    def ready() -> Process:
        charger = run("up")
        charger.wait_for_line("ready", charger.err)
        return charger

    return ready


def test_up_is_ready_then_dock_and_undock_use_it_and_sigterm_ends_it_with_0(up: Run, run: Run, tmp_path: Path) -> None:
    charger = up()
    picture = tmp_path / "run.png"
    dock = run("dock", "--json", "--picture", str(picture), "--request-id", "r1")
    assert dock.end() == 0, dock.err
    result = json.loads("\n".join(dock.out))
    assert (result["success"], result["charger"], result["error_name"]) == (True, "running", "NONE")
    assert next(phase["phase"] for phase in result["phases"]) == "approach"
    assert result["picture"] is None or picture.is_file()
    assert any("contact" in line for line in dock.err)
    assert any("using the running charger; only the goal of scene 'quick'" in line for line in dock.err)
    undock = run("undock", "--json")
    assert undock.end() == 0, undock.err
    assert json.loads("\n".join(undock.out))["success"] is True
    assert charger.end(signal.SIGTERM) == 0
    assert charger.out == []


def test_up_ends_with_130_on_sigint_and_with_2_on_refused_parameters(
    up: Run, start: Run, deltacharger: tuple[str, ...], quick_file: Path, namespace: str, tmp_path: Path
) -> None:
    assert up().end(signal.SIGINT) == 130
    bad = tmp_path / "bad.yaml"
    bad.write_text(quick_file.read_text(encoding="utf-8").replace("standoff", "standof"), encoding="utf-8")
    refused = start(*deltacharger, "up", "--scene", str(bad), "--namespace", namespace)
    assert refused.end() == 2
    assert any("did you mean 'standoff'" in line for line in refused.err)


def test_a_closed_terminal_ends_up_in_order_and_a_second_charger_is_refused_at_once(up: Run, run: Run) -> None:
    charger = up()
    second = run("up")
    assert second.end() == 2
    assert [line for line in second.err if "already answers" in line and f"process {charger.process.pid}" in line]
    assert charger.end(signal.SIGHUP) == 0


def test_a_charger_of_separate_processes_uses_the_same_lock(
    start: Run, run: Run, quick_scene: Scene, namespace: str
) -> None:
    words, lock = arguments(quick_scene, "docking_node", namespace), runtime.charger(environment.domain(), namespace)

    def holder() -> str:
        path = lock.with_suffix(".lock")
        return path.read_text(encoding="utf-8").strip() if path.exists() else ""

    first = start(*words)
    wait_until(lambda: holder() == str(first.process.pid), "the lock of the first process")
    for second, text in ((start(*words), "already runs in ROS domain"), (run("up"), "already answers in ROS domain")):
        assert second.end() == 2, second.err
        refusals = [line for line in second.err if text in line]
        assert len(refusals) == 1, second.err
        assert f"process {first.process.pid}" in refusals[0]
    assert first.end(signal.SIGKILL) == -signal.SIGKILL
    third = start(*words)
    wait_until(lambda: holder() == str(third.process.pid), "the lock of the next process")
    assert third.end(signal.SIGTERM) == 0, third.err


def test_of_two_chargers_started_together_exactly_one_runs(run: Run) -> None:
    both = [run("up"), run("up")]
    wait_until(lambda: any(each.process.poll() is not None for each in both), "the end of one process")
    refused, runs = sorted(both, key=lambda each: each.process.poll() is None)
    assert refused.end() == 2
    runs.wait_for_line("ready", runs.err)
    assert runs.end(signal.SIGTERM) == 0


def test_a_charger_without_the_lock_is_found_over_ros_and_not_disturbed(
    up: Run, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = up()
    assert run("dock", "--json", "--no-picture").end() == 0
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # as for another user or another computer
    second = run("up")
    assert second.end() == 1
    assert any("already answers in ROS domain" in line for line in second.err)
    # Repeat if the computer was too busy: charging has then ended already, and the arm is retracting.
    undocks = [run("undock", "--json")]
    while undocks[-1].end() != 0 and len(undocks) < 4:
        undocks.append(run("undock", "--json"))
    assert undocks[-1].end() == 0, [each.out for each in undocks]
    assert first.end(signal.SIGTERM) == 0


@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_ends_dock_and_the_charger_it_started_with_130_and_one_object(run: Run, presses: int) -> None:
    dock = run("dock", "--json", "--no-picture")
    dock.wait_for_line(" s  contact ", dock.err)  # the phase: a log line may mention contact before
    if presses == 2:
        dock.process.send_signal(signal.SIGINT)
    assert dock.end(signal.SIGINT) == 130
    result = json.loads("\n".join(dock.out))
    assert not any("Traceback" in line for line in dock.err), dock.err
    assert result["success"] is False
    if presses == 1:  # a second one abandons the result, unless both arrive as one
        assert (result["charger"], result["error_name"]) == ("started", "CANCELED")


def test_a_refused_docking_ends_with_1_and_its_code(run: Run) -> None:
    dock = run("dock", "--x-mm", "200", "--json", "--no-picture")
    assert dock.end() == 1
    result = json.loads("\n".join(dock.out))
    assert (result["error_name"], result["success"]) == ("UNREACHABLE", False)
    assert result["suggested_base_pose"]


def test_undock_without_scene_domain_and_charger_ends_with_1_and_names_both_domains(
    start: Run, deltacharger: tuple[str, ...], namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    undock = start(*deltacharger, "undock", "--namespace", namespace)
    assert undock.end() == 1
    assert any("domain 0 or 87" in line for line in undock.err)
    assert any("deltacharger up" in line for line in undock.err)


def test_without_scene_and_domain_a_charger_in_the_default_domain_is_used(
    up: Run, start: Run, deltacharger: tuple[str, ...], namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    charger = up()
    monkeypatch.delenv("ROS_DOMAIN_ID")
    undock = start(*deltacharger, "undock", "--namespace", namespace, "--json")
    assert undock.end() == 0, undock.err
    assert any("ROS domain 0" in line for line in undock.err)
    assert charger.end(signal.SIGTERM) == 0


@pytest.mark.skipif("COLCON_PREFIX_PATH" in os.environ, reason="a colcon workspace has no venv prefix")
def test_the_command_sets_its_environment(up: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("AMENT_PREFIX_PATH", "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(name, raising=False)
    charger = up()
    assert any("ROS domain 87" in line for line in charger.err)
    assert charger.end(signal.SIGTERM) == 0


@pytest.mark.rest
@pytest.mark.parametrize("shell", ["exec {} >/dev/full 2>&-", "exec {} >&- 2>/dev/full"])
def test_a_docking_finishes_without_usable_output_streams(
    up: Run, run: Run, start: Run, deltacharger: tuple[str, ...], quick_file: Path, namespace: str, shell: str
) -> None:
    where = ("--scene", str(quick_file), "--namespace", namespace)
    charger = start("bash", "-c", shell.format(shlex.join((*deltacharger, "up", *where))))
    wait_until(lambda: run("undock").end() == 0, "a running charger")
    dock = start("bash", "-c", shell.format(shlex.join((*deltacharger, "dock", *where, "--json"))))
    assert dock.end() == 1, "its output is lost"
    assert (dock.out, dock.err) == ([], [])
    undock = run("undock", "--json")
    assert undock.end() == 0, undock.err
    assert charger.end(signal.SIGTERM) == 0, "it had no output"
