# SPDX-License-Identifier: Apache-2.0
"""`deltacharger up` and `deltacharger dock` as separate processes: signals and exit codes."""

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from ..chargers import Process
from ..marks import night, rest
from .command import Capture, answer

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


def result(process: Process, code: int) -> dict[str, object]:
    """Return the one object of a command that ends with this code."""
    assert process.end() == code, process.err
    assert not any("Traceback" in line for line in process.err), process.err
    return dict(json.loads("\n".join(process.out)))


@pytest.mark.version
@pytest.mark.rest
def test_up_is_ready_then_dock_and_undock_use_it_and_sigterm_ends_it_with_0(up: Run, run: Run) -> None:
    charger = up()
    dock = run("dock", "--json", "--no-picture", "--request-id", "r1")
    docked = result(dock, 0)
    assert (docked["success"], docked["charger"], docked["error_name"]) == (True, "running", "NONE")
    assert any("contact" in line for line in dock.err)
    assert result(run("undock", "--json"), 0)["success"] is True
    assert charger.end(signal.SIGTERM) == 0
    assert charger.out == []


@pytest.mark.rest
def test_a_closed_terminal_ends_up_in_order_and_a_second_charger_is_refused_at_once(up: Run, run: Run) -> None:
    charger = up()
    second = run("up")
    assert second.end() == 2
    assert any(f"process {charger.process.pid}" in line for line in second.err)
    assert charger.end(signal.SIGHUP) == 0
    assert up().end(signal.SIGINT) == 130


@pytest.mark.parametrize("presses", [rest(1), night(2)])
def test_ctrl_c_ends_dock_and_the_charger_it_started_with_130_and_one_object(run: Run, presses: int) -> None:
    dock = run("dock", "--json", "--no-picture")
    dock.wait_for_line(" s  contact ", dock.err)  # the phase: a log line may mention contact before
    for _ in range(presses):
        dock.process.send_signal(signal.SIGINT)
    ended = result(dock, 130)
    assert ended["success"] is False
    if presses == 1:  # a second one abandons the result, unless both arrive as one
        assert (ended["charger"], ended["error_name"]) == ("started", "CANCELED")


@pytest.mark.rest
@pytest.mark.parametrize(
    "line",
    [
        "undock",
        "tactile record --out new.npz --set reference",
        "calibrate camera --views new --take 5 --board-x-mm 0 --board-y-mm 0 --board-z-mm 0",
    ],
)
def test_without_a_charger_every_command_ends_with_1(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, line: str
) -> None:
    if "views" in line:
        pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    monkeypatch.chdir(tmp_path)
    code, found = answer(capsys, *line.split(), "--namespace", "nobody_here")
    assert (code, "deltacharger up" in found["error"]) == (1, True)
    assert list(tmp_path.iterdir()) == []
