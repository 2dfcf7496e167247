# SPDX-License-Identifier: Apache-2.0
"""`deltacharger fault` on running simulated chargers, in this process and as separate processes."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.scenes.scene import parse_scene
from deltacharger_core import runtime
from deltacharger_sim.charger import faults, simulated_charger

from ..sim.test_simulated_charger import answer
from ..waiting import wait_until
from . import command

pytestmark = pytest.mark.ros

SIMULATED = parse_scene({"nodes": [], "simulation": {}}, "test").simulation
Command = Callable[..., tuple[int, dict[str, Any]]]


@pytest.fixture(autouse=True)
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Isolate the test from other chargers of this machine."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()


@pytest.fixture
def charger(tmp_path: Path) -> Iterator[simulated_charger.SimulatedCharger]:
    with simulated_charger.SimulatedCharger(SIMULATED, tmp_path / "ports") as charger:
        yield charger


@pytest.fixture
def fault(capsys: pytest.CaptureFixture[str]) -> Command:
    """Run the command, and return its exit code and JSON object."""
    return lambda *words: command.answer(capsys, "fault", *words)


def silent(port: str, servo: int) -> bool:
    """Whether a servo does not answer a ping; remains of an earlier answer do not count."""
    return answer(port, servo)[4:5] != bytes((servo,))


def answers(port: str, servo: int) -> None:
    wait_until(lambda: not silent(port, servo), f"servo {servo}")


def test_lasting_faults_are_listed_replaced_and_cleared(
    charger: simulated_charger.SimulatedCharger, fault: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    fault("servo_missing")
    fault("board_drop", "--amount", "0.3", "--for-s", "0.1")
    active = fault("board_drop", "--amount", "0.5")[1]["active"]
    assert [(each["amount"], each["remaining_s"]) for each in active] == [(None, None), (0.5, None)]
    fault("board_silent", "--for-s", "0.2")
    wait_until(lambda: fault("--list")[1]["active"] == active, "the other's end")  # later than 0.1 s
    code, listed, _ = command.run(capsys, "fault", "--list")
    assert code == 0
    assert "active: servo_missing of servo 2; board_drop (0.5)" in listed
    assert all(kind in listed for kind in faults.KINDS)
    assert silent(charger.servo_port, 2)
    answers(charger.servo_port, 1)
    assert fault("--clear") == (0, {"success": True, "active": []})
    answers(charger.servo_port, 2)


@pytest.mark.parametrize(
    ("words", "noun"),
    [
        ("servo_mising", "servo_missing"),
        ("servo_drop --amount 1.5", "share"),
        ("servo_reboot --for-s 1", "momentary"),
        ("--clear --amount 1", "KIND"),
    ],
)
def test_an_invalid_fault_is_wrong_usage_with_the_allowed_values(
    capsys: pytest.CaptureFixture[str], words: str, noun: str
) -> None:
    command.refuses(capsys, f"fault {words}", noun)


def test_a_folder_of_another_user_is_not_used(tmp_path: Path, fault: Command) -> None:
    runtime.charger(0, "").parent.symlink_to(tmp_path)  # as another user might prepare it in a world-writable folder
    with simulated_charger.SimulatedCharger(SIMULATED, tmp_path / "ports"):
        assert fault("--clear")[0] == 1
        assert fault("servo_missing", "--directory", str(tmp_path / "ports"))[0] == 0
