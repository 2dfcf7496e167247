# SPDX-License-Identifier: Apache-2.0
"""How `deltacharger calibrate servos` ends, with an arm that fails where it should; the whole in another file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from types import MappingProxyType, SimpleNamespace
from typing import Any

import pytest

import deltacharger_bringup.cli.calibrate_servos as command
import deltacharger_records.datasets.measuring_arm as measuring
from deltacharger_bringup.cli.output import FAILED, CommandError
from deltacharger_kinematics.calibration.servo_checks import Gains
from deltacharger_records.datasets.arm_guest import ArmError

pytestmark = pytest.mark.ros

TOLD = {"torque_constant": 1.3, "position_p_gain": 500, "position_i_gain": 0, "position_d_gain": 3}
MEASURED = SimpleNamespace(fit=SimpleNamespace(common=lambda what: (12.0, 0.2)))


class Arm:
    """Stands in for `MeasuringArm`."""

    trouble: Mapping[str, str] = MappingProxyType({})
    servo: Mapping[str, Any] = TOLD
    released = True

    def __init__(self, *given: Any) -> None:
        self.is_released = False
        self.started = False

    def __enter__(self) -> Arm:
        return self

    def __exit__(self, *exception: object) -> None:
        self.is_released = self.started and self.released

    def wait_until_ready(self, timeout: float) -> None:
        self._do("wait")

    def told(self, name: str) -> Mapping[str, Any]:
        return self.servo if name == "servo_node" else {}

    def start(self) -> None:
        self.started = True
        self._do("start")

    def measure(self) -> Any:
        self._do("measure")
        return MEASURED

    def retire(self, stiffness: float) -> None:
        self._do("retire")

    def _do(self, what: str) -> None:
        if what in self.trouble:
            raise ArmError(self.trouble[what])


@pytest.fixture
def arm(monkeypatch: pytest.MonkeyPatch) -> type[Arm]:
    class OneArm(Arm):
        pass

    monkeypatch.setattr(measuring, "MeasuringArm", OneArm)
    monkeypatch.setattr(command, "measure_servos", lambda body, task, say: body.measure())
    return OneArm


def measured() -> Any:
    parser = argparse.ArgumentParser()
    command.add_servos(parser)
    return command._measured(parser.parse_args([]))


@pytest.mark.parametrize(
    ("where", "released", "said"),
    [("wait", True, False), ("start", True, True), ("measure", True, True), ("measure", False, False)],
)
def test_the_torque_is_said_to_be_off_where_it_was_switched_off_and_nowhere_else(
    arm: type[Arm], where: str, released: bool, said: bool
) -> None:
    arm.trouble, arm.released = {where: "docking_node is at work"}, released
    with pytest.raises(CommandError) as caught:
        measured()
    assert caught.value.exit_code == FAILED
    assert "docking_node is at work; nothing was written" in str(caught.value)
    assert ("the torque is off" in str(caught.value)) is said


def test_a_way_home_that_fails_costs_no_measurement(arm: type[Arm], capsys: pytest.CaptureFixture[str]) -> None:
    arm.trouble = {"retire": "the arm cannot go that way"}
    task, gains, found = measured()
    assert (task.torque_constant, gains, found) == (1.3, Gains(500, 0, 3), MEASURED)
    assert "did not go home: the arm cannot go that way" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("servo", "reason"), [({}, "does not report its gains"), ({**TOLD, "position_i_gain": 7}, "position_i_gain.*is 7")]
)
def test_gains_that_are_unknown_or_hide_the_spring_are_refused_before_anything_moves(
    arm: type[Arm], servo: dict[str, Any], reason: str
) -> None:
    arm.servo, arm.trouble = servo, {"start": "the arm was moved"}
    with pytest.raises(CommandError, match=reason):
        measured()
