# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate servos`: with an arm that fails in a given step, and over the real bytes."""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import pytest

import deltacharger_bringup.cli.calibrate_servos as command
import deltacharger_bringup.records.arm_client as measuring
from deltacharger_bringup.cli.output import FAILED, CommandError
from deltacharger_bringup.records.arm_client import ArmError
from deltacharger_core import servo_types, yaml_file

from ..chargers import Process, wait_until

pytestmark = pytest.mark.ros

GAINS = {"torque_constant": 1.3, "position_p_gain": 500, "position_d_gain": 3}
MEASURED = SimpleNamespace(fit=SimpleNamespace(common=lambda what: (12.0, 0.2)))


@pytest.fixture
def arm(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Replaces the `MeasuringArm`: its methods can be made to fail."""
    arm = mock.MagicMock(is_released=False, releases=True)
    arm.__enter__.return_value = arm
    arm.__exit__.side_effect = lambda *end: setattr(arm, "is_released", arm.start.called and arm.releases)
    arm.parameters_of.side_effect = lambda name: GAINS if name == "servo_node" else {}
    arm.measure.return_value = MEASURED
    monkeypatch.setattr(measuring, "MeasuringArm", lambda *given: arm)
    monkeypatch.setattr(command, "measure_servos", lambda body, task, progress: body.measure())
    return arm


def measured() -> Any:
    parser = argparse.ArgumentParser()
    command.add_servos(parser)
    return command._measured(parser.parse_args([]))


@pytest.mark.parametrize(
    ("where", "releases", "is_off"),
    [("wait_until_ready", True, False), ("measure", True, True), ("measure", False, False)],
)
def test_torque_is_reported_off_only_if_it_was_switched_off(arm: Any, where: str, releases: bool, is_off: bool) -> None:
    arm.releases, getattr(arm, where).side_effect = releases, ArmError("docking_node is at work")
    with pytest.raises(CommandError, match="docking_node") as caught:
        measured()
    assert (caught.value.exit_code, "the torque is off" in str(caught.value)) == (FAILED, is_off)


WORLD = {
    "target": {"present": False},
    "servo": {"stiffness": 10.0, "friction": 0.08, "backlash": 0.004, "torque_constant": 1.3},
}


@pytest.mark.night
@pytest.mark.timeout(400)  # it takes 90 s
def test_servos_are_measured_over_the_real_bytes(context: Any, start: Callable[..., Process], tmp_path: Path) -> None:
    from deltacharger_bringup.scenes.scene import parse_scene

    from ..running_charger import RunningCharger

    path = tmp_path / "servos.yaml"
    words = ("-m", "deltacharger_bringup.cli", "calibrate", "servos", "--json", "--out", str(path), "--seconds", "80")
    with RunningCharger(parse_scene({"simulation": {"seed": 1, "world": WORLD}}, "free"), context) as charger:
        process = start(sys.executable, *words, "--namespace", charger.namespace)
        process.process.wait(300.0)
        assert process.end() == 0, (process.out, process.err)
        wait_until(lambda: not any(charger.world.torque), "torque off")
    result = json.loads(process.out[0])
    assert (result["success"], result["written"], result["doubts"]) == (True, str(path), [])
    found = yaml_file.read_declared(path, servo_types.MeasuredServos)
    assert (found.stiffness, found.torque_constant) == pytest.approx((10.0, 1.3), rel=0.05)
    assert result["friction"][3][0] == pytest.approx(0.08, rel=0.2)
    assert found.position_p_gain == 434
