# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate servos` with a running charger: once over the real bytes, and its interruptions."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from std_srvs.srv import SetBool

from deltacharger_core.servos_file import load_servos
from deltacharger_ros import qos

from ..chargers import Process, wait_until
from ..marks import rest
from ..nodes import call
from .running import Charger, running

pytestmark = pytest.mark.ros

WORLD = "{target: {present: false}, servo: {stiffness: 10.0, friction: 0.08, backlash: 0.004, torque_constant: 1.3}}"
OLD = "stiffness: 7.0\n"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "free.yaml"
    path.write_text(f"simulation: {{seed: 1, world: {WORLD}}}\n")
    return path


@pytest.fixture(scope="module")
def charger(scene: Path) -> Iterator[Charger]:
    with running(scene) as charger:
        yield charger


@pytest.fixture
def measure(charger: Charger, start: Callable[..., Process], deltacharger: tuple[str, ...]) -> Callable[..., Process]:
    """Start the command on the running charger."""

    def begin(*words: str) -> Process:
        return start(*deltacharger, "calibrate", "servos", "--namespace", charger.namespace, "--json", *words)

    return begin


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A file of earlier values."""
    path = tmp_path / "servos.yaml"
    path.write_text(OLD)
    return path


def moves(charger: Charger, process: Process) -> None:
    """Wait until the arm moves."""
    process.wait_for_line("Ctrl-C ends it", process.err)
    start = list(charger.state.position)
    wait_until(lambda: max(abs(a - b) for a, b in zip(charger.state.position, start, strict=True)) > 0.05, "motion")


@pytest.mark.rest
@pytest.mark.timeout(400)  # it takes 90 s
def test_servos_are_measured_over_the_real_bytes(
    measure: Callable[..., Process], charger: Charger, tmp_path: Path
) -> None:
    path = tmp_path / "servos.yaml"
    process = measure("--out", str(path), "--seconds", "80")
    process.process.wait(300.0)
    assert process.end() == 0, (process.out, process.err)
    result = json.loads(process.out[0])
    assert result["success"]
    assert result["written"] == str(path)
    assert not result["doubts"]
    found = load_servos(path)
    assert found.stiffness == pytest.approx(10.0, rel=0.05)
    assert found.torque_constant == pytest.approx(1.3, rel=0.05)
    assert found.friction == pytest.approx(0.08, rel=0.2)
    assert found.backlash == pytest.approx(0.004, abs=0.002)
    assert found.position_p_gain == 434
    wait_until(lambda: not charger.torque(), "torque off")


@pytest.mark.parametrize("how", [signal.SIGINT, rest(signal.SIGTERM), rest(signal.SIGHUP)])
def test_after_an_interruption_the_torque_is_off_and_the_old_file_is_unchanged(
    measure: Callable[..., Process], charger: Charger, old: Path, how: signal.Signals
) -> None:
    process = measure("--out", str(old), "--force")
    moves(charger, process)
    assert charger.torque()
    assert process.end(how) == 130, process.err
    assert json.loads(process.out[0])["success"] is False
    assert "interrupted; nothing was written, and the torque is off" in json.loads(process.out[0])["error"]
    wait_until(lambda: not charger.torque(), "torque off")
    assert old.read_text() == OLD


def test_a_lost_servo_ends_it(
    measure: Callable[..., Process], charger: Charger, old: Path, start: Callable[..., Process], deltacharger: Any
) -> None:
    process = measure("--out", str(old), "--force")
    moves(charger, process)
    fault = start(
        *deltacharger, "fault", "servo_missing", "--servo", "2", "--for-s", "2", "--namespace", charger.namespace
    )
    assert fault.end() == 0, fault.err
    assert process.end() == 1, process.err
    assert "nothing was written" in json.loads(process.out[0])["error"]
    wait_until(lambda: not charger.torque(), "torque off")
    assert old.read_text() == OLD
    wait_until(lambda: all(charger.state.valid), "the return of the servo")


def test_torque_switched_on_by_another_program_stays_on(
    measure: Callable[..., Process], charger: Charger, tmp_path: Path
) -> None:
    client = charger.node.create_client(SetBool, f"/{charger.namespace}/set_torque", qos_profile=qos.SERVICE)
    wait_until(client.service_is_ready, "set_torque")
    assert call(client, SetBool.Request(data=True)).success
    try:
        process = measure("--out", str(tmp_path / "servos.yaml"))
        assert process.end() == 1
        error = json.loads(process.out[0])["error"]
        assert "another program moves the arm" in error
        assert "the torque is off" not in error
        assert charger.torque()
    finally:
        call(client, SetBool.Request(data=False))
    wait_until(lambda: not charger.torque(), "torque off")
    assert not (tmp_path / "servos.yaml").exists()


def test_an_old_file_is_refused_before_anything_moves(
    measure: Callable[..., Process], charger: Charger, old: Path
) -> None:
    process = measure("--out", str(old))
    assert process.end() == 2
    assert "--force" in json.loads(process.out[0])["error"]
    assert not charger.torque()
    assert old.read_text() == OLD


def test_without_a_charger_it_ends_with_1(start: Callable[..., Process], tmp_path: Path) -> None:
    command = (sys.executable, "-m", "deltacharger_bringup.cli", "calibrate", "servos", "--json")
    process = start(*command, "--namespace", "nobody_here", "--out", str(tmp_path / "servos.yaml"))
    assert process.end() == 1
    assert "deltacharger up" in json.loads(process.out[0])["error"]
    assert not (tmp_path / "servos.yaml").exists()
