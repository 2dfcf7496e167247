# SPDX-License-Identifier: Apache-2.0
"""`deltacharger tactile record` with a running charger: real nodes, real bytes, simulated world."""

import json
import math
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.output import FAILED, INTERRUPTED, WRONG_INPUT
from deltacharger_bringup.scenes.scene import parse_scene
from deltacharger_tactile.dataset import Dataset

from ..chargers import DEADLINE, Process, wait_until
from ..marks import night, rest
from ..quick import PATIENT
from ..running_charger import RunningCharger

pytestmark = pytest.mark.ros

STEPS = {
    "standoff": 0.006,
    "search_depth": 0.005,
    "search_speed": 0.1,
    "press_speed": 0.1,
    "travel_speed": 0.5,
}
WORLD = {"target": {"x": 0.0, "y": 0.0, "z": 0.080, "roll": 0.0}}
SCENE = {
    "nodes": ["servo_node", "tactile_node", "docking_node"],
    "simulation": {"seed": 3, "rig_seed": 602, "world": WORLD},
    "parameters": {"docking_node": {**STEPS, **PATIENT["docking_node"]}, "servo_node": {"reply_margin": 0.1}},
}
"""A simulated charger with its target level at (0, 0, 80) mm."""
Recorder = Callable[..., Process]


class Recorded(RunningCharger):
    def touches(self) -> bool:
        return self.world.snapshot().misalignment is not None

    def assert_safe(self, told: str = "") -> None:
        """Check that the arm is home, or its user was told, without torque, and nothing was ever live."""
        is_home = math.dist(self.world.snapshot().position, (0.0, 0.0, 0.0)) < 0.003
        assert is_home or "by hand" in told  # the magnets may hold it if this computer is too busy
        assert not any(self.world.torque)
        assert self.world.record.energised == 0.0


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Recorded]:
    with Recorded(parse_scene(SCENE, "recorded"), context) as charger:
        yield charger


@pytest.fixture
def record(start: Callable[..., Process], deltacharger: tuple[str, ...], charger: Recorded, tmp_path: Path) -> Recorder:
    """Start the command on the charger; F.npz is the data set unless the options differ."""

    def begin(*words: str) -> Process:
        place = ("--namespace", charger.namespace, "--out", str(tmp_path / "F.npz"), "--json")
        return start(*deltacharger, "tactile", "record", *place, *words)

    return begin


def answer(process: Process, code: int, number: int | None = None) -> dict[str, Any]:
    assert process.end(number) == code, (process.out, process.err)
    assert len(process.out) == 1
    return dict(json.loads(process.out[0]))


@pytest.mark.parametrize("number", [rest(signal.SIGINT), night(signal.SIGTERM)])
def test_a_signal_ends_it_without_torque_and_with_the_data_set_written(
    record: Recorder, charger: Recorded, tmp_path: Path, number: signal.Signals
) -> None:
    process = record("--set", "reference", "--repeat", "9")
    process.wait_for_line("1 of 9", process.err)
    wait_until(charger.touches, "the second contact")
    result = answer(process, INTERRUPTED, number)
    charger.assert_safe(result["error"])
    assert (result["success"], result["recorded"], result["remaining"]) == (False, 1, 8)
    assert len(Dataset.load(tmp_path / "F.npz")) == 1


@pytest.mark.rest
def test_an_arm_powered_by_another_program_is_left_alone_and_places_out_of_reach_are_refused(
    record: Recorder, charger: Recorded, context: Any
) -> None:
    from deltacharger_bringup.records.arm_client import ArmClient
    from deltacharger_kinematics import DeltaGeometry

    contacts = charger.world.record.contacts
    assert "reach" in answer(record("--set", "position", "--x-mm", "80"), WRONG_INPUT)["error"]
    charger.assert_safe()
    with ArmClient(context, DeltaGeometry(), charger.namespace) as arm:
        arm.wait_until_ready(DEADLINE)
        arm.start()
        assert "another program" in answer(record("--set", "reference"), FAILED)["error"]
        assert any(charger.world.torque)
    wait_until(lambda: not any(charger.world.torque), "torque off")
    assert charger.world.record.contacts == contacts
