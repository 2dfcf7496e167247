# SPDX-License-Identifier: Apache-2.0
"""`deltacharger fault` on running simulated chargers, in this process and as separate processes."""

from __future__ import annotations

import json
import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from deltacharger_core import runtime
from deltacharger_scenes.scene import parse_scene
from deltacharger_sim.charger.fault_channel import ask
from deltacharger_sim.charger.fault_kinds import KINDS
from deltacharger_sim.charger.simulated_charger import SimulatedCharger

from ..chargers import Process, wait_until
from ..sim.test_simulated_charger import answer, ping
from . import command

pytestmark = pytest.mark.ros

SIMULATED = parse_scene({"nodes": [], "simulation": {}}, "test").simulation


@pytest.fixture(autouse=True)
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Isolate the test from other chargers of this machine."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()


@pytest.fixture
def charger(tmp_path: Path) -> Iterator[SimulatedCharger]:
    with SimulatedCharger(SIMULATED, tmp_path / "ports") as charger:
        yield charger


def silent(port: str, servo: int) -> bool:
    """Whether a servo does not answer a ping; remains of an earlier answer do not count."""
    try:
        return answer(port, servo)[4:5] != bytes((servo,))
    except serial.SerialException:  # the port is being removed or restored
        return True


def answers(port: str, servo: int) -> bool:
    """Whether a servo answers one of many pings, because a loaded machine may lose some."""
    return any(not silent(port, servo) for _ in range(50))


def heard(port: str) -> bytes:
    """Return the bytes of a port within 0.2 s; b'' also while it is removed or restored."""
    try:
        with serial.Serial(port, 1_000_000, timeout=0.2) as line:
            return bytes(line.read(256))
    except serial.SerialException:
        return b""


class Output:
    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def json(self) -> dict[str, Any]:
        value = json.loads(self.out)
        assert isinstance(value, dict)
        return value


Command = Callable[..., Output]


@pytest.fixture
def fault(capsys: pytest.CaptureFixture[str]) -> Command:
    return lambda *words: Output(*command.run(capsys, "fault", *words))


def test_a_servo_is_missing_for_a_given_time(charger: SimulatedCharger, fault: Command) -> None:
    assert answers(charger.servo_port, 3)
    done = fault("servo_missing", "--servo", "3", "--for-s", "3", "--json")
    assert (done.code, done.json["kind"], done.json["servo"], done.json["for_s"]) == (0, "servo_missing", 3, 3.0)
    assert [each["kind"] for each in done.json["active"]] == ["servo_missing"]
    assert silent(charger.servo_port, 3)
    assert answers(charger.servo_port, 1)
    assert answers(charger.servo_port, 3)
    assert fault("--list", "--json").json["active"] == []


def test_lasting_faults_are_listed_and_end_with_clear(charger: SimulatedCharger, fault: Command) -> None:
    assert fault("servo_missing").code == 0
    assert fault("board_drop", "--amount", "0.5").code == 0
    listed = fault("--list")
    assert listed.code == 0
    assert "active: servo_missing of servo 2; board_drop (0.5)" in listed.out
    assert all(kind in listed.out for kind in KINDS)
    assert silent(charger.servo_port, 2)
    assert fault("--clear", "--json").json == {"success": True, "active": []}
    assert answers(charger.servo_port, 2)


def test_a_repeated_fault_replaces_the_first_one(charger: SimulatedCharger, fault: Command) -> None:
    fault("servo_delay", "--amount", "0.3", "--for-s", "0.2")
    active = fault("servo_delay", "--amount", "0.01", "--json").json["active"]
    assert [(each["amount"], each["remaining_s"]) for each in active] == [(0.01, None)]
    fault("board_silent", "--for-s", "0.4")
    wait_until(lambda: len(fault("--list", "--json").json["active"]) == 1, "the other's end")  # later than 0.2 s
    assert fault("--list", "--json").json["active"] == active
    assert fault("--clear").code == 0
    assert answers(charger.servo_port, 1)


def test_a_servo_at_another_speed_answers_only_there(charger: SimulatedCharger, fault: Command) -> None:
    assert fault("servo_wrong_baud", "--servo", "2", "--amount", "57600").code == 0
    assert silent(charger.servo_port, 2)
    assert answers(charger.servo_port, 1)

    def reply() -> bool:
        with serial.Serial(charger.servo_port, 57600, timeout=0.2) as line:
            line.write(ping(2))
            return bytes(line.read(14))[4:5] == b"\2"

    wait_until(reply, "servo 2 at 57600 bit/s")
    assert fault("--clear").code == 0
    assert answers(charger.servo_port, 2)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_can_be_injected_and_cleared(charger: SimulatedCharger, fault: Command, kind: str) -> None:
    ordered = fault(kind, "--json")
    assert (ordered.code, ordered.json["success"]) == (0, True)
    assert [each["kind"] for each in ordered.json["active"]] == ([kind] if KINDS[kind].lasts else [])
    assert fault("--clear", "--json").json["active"] == []
    for servo in (1, 2, 3):
        assert answers(charger.servo_port, servo)
    wait_until(lambda: heard(charger.board_port).count(0) >= 4, "packets of the board")
    assert charger.errors() == []


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("servo_mising",), "servo_missing"),
        (("servo_drop", "--amount", "1.5"), "--amount: 1.5 is not a share of 0 to 1"),
        (("servo_delay", "--amount", "-1"), "a delay of 0 to 2 s"),
        (("servo_undervoltage", "--amount", "12"), "6 to 9.4 V"),
        (("servo_wrong_baud", "--amount", "38400"), "57600, 115200"),
        (("servo_duplicate_id", "--servo", "1"), "servo 1 already has that id"),
        (("board_trip", "--amount", "2.5"), "fault code of ChargerPower, 1 to 9"),
        (("board_dead_taxel", "--amount", "200"), "0 to 99 left"),
        (("servo_unplugged", "--amount", "1"), "takes no amount"),
        (("servo_reboot", "--for-s", "1"), "momentary"),
        (("board_drop", "--servo", "1"), "does not affect a single servo"),
        (("servo_missing", "--servo", "4"), "outside 1 to 3"),
        (("servo_missing", "--for-s", "-1"), "outside 0 to"),
        (("servo_missing", "--list"), "exactly one of"),
        ((), "exactly one of KIND"),
        (("--clear", "--amount", "1"), "need a KIND"),
    ],
)
def test_an_invalid_fault_is_wrong_usage_with_the_allowed_values(
    fault: Command, words: tuple[str, ...], reason: str
) -> None:
    done = fault(*words)
    assert done.code == 2
    assert reason in done.err
    assert fault(*words, "--json").json["success"] is False


def test_without_a_charger_injection_fails_and_the_list_does_not(
    fault: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    done = fault("servo_missing")
    assert done.code == 1
    assert "domain 87 or 0" in done.err
    assert "deltacharger up" in done.err
    assert fault("--clear", "--directory", str(tmp_path)).code == 1
    listed = fault("--list", "--json")
    assert (listed.code, listed.json["active"]) == (0, None)
    assert {each["kind"] for each in listed.json["kinds"]} == set(KINDS)
    assert "no simulated charger runs" in fault("--list").out


def test_each_namespace_and_each_folder_has_its_own_faults(fault: Command, tmp_path: Path) -> None:
    deep = tmp_path / ("a" * 100) / "ports"  # longer than the address of a socket
    with (
        SimulatedCharger(SIMULATED, deep, "robot_1") as one,
        SimulatedCharger(SIMULATED, tmp_path / "two", "robot_2") as two,
    ):
        assert fault("servo_missing", "--servo", "1", "--namespace", "robot_1").code == 0
        assert fault("servo_missing", "--servo", "2", "--directory", str(tmp_path / "two")).code == 0
        assert silent(one.servo_port, 1)
        assert answers(one.servo_port, 2)
        assert answers(two.servo_port, 1)
        assert silent(two.servo_port, 2)
        assert fault("--clear", "--namespace", "robot_3").code == 1
        assert fault("--clear", "--directory", str(deep)).code == 0
        assert answers(one.servo_port, 1)


def test_a_charger_keeps_its_socket_until_it_ends_and_leaves_nothing(fault: Command, tmp_path: Path) -> None:
    place = runtime.charger(int(os.environ["ROS_DOMAIN_ID"]), "")
    first = SimulatedCharger(SIMULATED, tmp_path / "one").start()
    second = SimulatedCharger(SIMULATED, tmp_path / "two").start()
    assert fault("servo_missing").code == 0
    assert silent(first.servo_port, 2)
    assert answers(second.servo_port, 2)
    second.stop()
    assert fault("--clear").code == 0
    first.stop()
    assert not os.path.lexists(place)
    assert list((tmp_path / "one").iterdir()) == list((tmp_path / "two").iterdir()) == []
    place.symlink_to(tmp_path / "two" / "control")  # as a killed process leaves it
    assert fault("--clear").code == 1
    with SimulatedCharger(SIMULATED, tmp_path / "two"):
        assert fault("--clear").code == 0


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"nonsense\n", "JSON"),
        (b"[1]\n", "unknown command"),
        (b'{"command": "begin", "kind": "board_drop", "amount": 7}\n', "share of 0 to 1"),
        (b'{"command": "begin", "kind": "board_drop", "until": 7}\n', "unknown key"),
    ],
)
def test_the_socket_survives_invalid_requests(
    charger: SimulatedCharger, tmp_path: Path, line: bytes, reason: str
) -> None:
    control = tmp_path / "ports" / "control"
    with socket.socket(socket.AF_UNIX) as silent, socket.socket(socket.AF_UNIX) as client:
        silent.connect(str(control))
        client.connect(str(control))
        client.settimeout(10.0)
        client.sendall(line)
        assert reason in json.loads(client.makefile().readline())["error"]
    assert ask(control, {"command": "active"}) == {"success": True, "active": []}
    assert control.stat().st_mode & 0o077 == 0


def test_a_folder_of_another_user_is_not_used(tmp_path: Path, fault: Command) -> None:
    runtime.charger(0, "").parent.symlink_to(tmp_path)  # as another user might prepare it in a world-writable folder
    with SimulatedCharger(SIMULATED, tmp_path / "ports") as charger:
        assert fault("--clear").code == 1
        assert fault("servo_missing", "--directory", str(tmp_path / "ports")).code == 0
        assert silent(charger.servo_port, 2)


def test_faults_reach_the_nodes_of_a_running_charger(
    start: Callable[..., Process], deltacharger: tuple[str, ...], tmp_path: Path, fault: Command
) -> None:
    scene = tmp_path / "servos.yaml"
    scene.write_text("nodes: [servo_node]\nsimulation: {}\n", encoding="utf-8")
    process = start(*deltacharger, "up", "--scene", str(scene))
    process.wait_for_line("ready", process.err)
    assert fault("servo_unplugged", "--for-s", "0.5").code == 0
    process.wait_for_line("the port disappeared", process.err)
    process.wait_for_line("connected again", process.err)
    assert process.end(signal.SIGTERM) == 0


def test_the_page_on_emulators_names_every_kind() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "emulators.md").read_text(encoding="utf-8")
    assert [kind for kind in KINDS if f"`{kind}`" not in page] == []
