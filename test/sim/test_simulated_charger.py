# SPDX-License-Identifier: Apache-2.0
"""The simulated hardware: two ports that answer like the robot's, in this process or in a separate one."""

import json
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from deltacharger_bringup.scenes.scene import parse_scene
from deltacharger_driver.packets import PING, instruction_packet
from deltacharger_sim.charger.simulated_charger import SimulatedCharger
from deltacharger_sim.charger.simulation import Simulation

from ..chargers import Process, wait_until


def answer(port: str, servo: int) -> bytes:
    """Return the reply to a ping, 14 bytes; empty if there is none within 0.2 s."""
    with serial.Serial(port, 1_000_000, timeout=0.2) as line:
        line.write(instruction_packet(servo, PING))
        return bytes(line.read(14))


def simulated(**keys: object) -> Simulation:
    simulation = parse_scene({"nodes": [], "simulation": keys}, "test").simulation
    assert simulation is not None
    return simulation


def test_three_servos_and_a_board_answer_until_it_stops(tmp_path: Path) -> None:
    with SimulatedCharger(simulated(), tmp_path) as charger:
        assert (charger.servo_port, charger.board_port) == (str(tmp_path / "servo"), str(tmp_path / "board"))
        for servo in (1, 2, 3):
            assert answer(charger.servo_port, servo)[4] == servo
        with serial.Serial(charger.board_port, 1_000_000, timeout=0.05) as board:
            received = bytearray()
            wait_until(lambda: received.extend(board.read(64)) or received.count(0) >= 4, "packets of the board")
        assert charger.errors() == []
        assert charger.record()["energised_shorts"] == 0
    assert list(tmp_path.iterdir()) == []


def test_a_scenes_faults_begin_and_end_on_schedule(tmp_path: Path) -> None:
    scheduled = [{"kind": "servo_missing", "servo": 2, "last": 0.3}, {"kind": "board_unplugged", "at": 0.1}]
    with SimulatedCharger(simulated(faults=scheduled), tmp_path) as charger:
        path, faults = Path(charger.board_port), charger.faults
        assert faults is not None
        wait_until(lambda: not path.exists(), "the port to vanish")
        wait_until(lambda: [each["kind"] for each in faults.active()] == ["board_unplugged"], "the other's end")
        wait_until(lambda: answer(charger.servo_port, 2), "servo 2 back")
        faults.clear()
        wait_until(path.exists, "the port to come back")


def test_it_waits_until_its_hosts_are_quiet(tmp_path: Path) -> None:
    with SimulatedCharger(simulated(), tmp_path) as charger:
        assert answer(charger.servo_port, 1)
        assert charger.wait_until_quiet(0.1, 5.0, threading.Event())
        hurry = threading.Event()
        hurry.set()
        assert answer(charger.servo_port, 1)
        assert not charger.wait_until_quiet(5.0, 5.0, hurry)


@pytest.mark.rest
def test_as_a_process_it_prints_ready_and_ends_cleanly(
    start: Callable[..., Process], deltacharger: tuple[str, ...], tmp_path: Path
) -> None:
    ports, record = tmp_path / "ports", tmp_path / "record.json"
    process = start(*deltacharger, "simulate", "--directory", str(ports), "--record", str(record), "--json")
    process.wait_for_line("ready", process.out)
    assert answer(str(ports / "servo"), 3)[4] == 3
    assert process.end(signal.SIGINT) == 130
    assert json.loads("\n".join(process.out))["servo"] == str(ports / "servo")
    assert list(ports.iterdir()) == []
    assert json.loads(record.read_text())["energised_shorts"] == 0
