# SPDX-License-Identifier: Apache-2.0
"""Ends of `deltacharger calibrate servos` with an arm that fails in a given step."""

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

GAINS = {"torque_constant": 1.3, "position_p_gain": 500, "position_i_gain": 0, "position_d_gain": 3}
MEASURED = SimpleNamespace(fit=SimpleNamespace(common=lambda what: (12.0, 0.2)))


class Arm:
    """Replaces `MeasuringArm`."""

    trouble: Mapping[str, str] = MappingProxyType({})
    servo: Mapping[str, Any] = GAINS
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

    def parameters_of(self, name: str) -> Mapping[str, Any]:
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
    monkeypatch.setattr(command, "measure_servos", lambda body, task, progress: body.measure())
    return OneArm


def measured() -> Any:
    parser = argparse.ArgumentParser()
    command.add_servos(parser)
    return command._measured(parser.parse_args([]))


@pytest.mark.parametrize(
    ("where", "released", "named"),
    [("wait", True, False), ("start", True, True), ("measure", True, True), ("measure", False, False)],
)
def test_torque_is_reported_off_only_if_it_was_switched_off(
    arm: type[Arm], where: str, released: bool, named: bool
) -> None:
    arm.trouble, arm.released = {where: "docking_node is at work"}, released
    with pytest.raises(CommandError) as caught:
        measured()
    assert caught.value.exit_code == FAILED
    assert "docking_node is at work; nothing was written" in str(caught.value)
    assert ("the torque is off" in str(caught.value)) is named


def test_a_failed_way_home_keeps_the_measurement(arm: type[Arm], capsys: pytest.CaptureFixture[str]) -> None:
    arm.trouble = {"retire": "the arm cannot go that way"}
    task, gains, found = measured()
    assert (task.torque_constant, gains, found) == (1.3, Gains(500, 0, 3), MEASURED)
    assert "did not go home: the arm cannot go that way" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("servo", "reason"), [({}, "does not report its gains"), ({**GAINS, "position_i_gain": 7}, "position_i_gain.*is 7")]
)
def test_unknown_gains_and_i_gains_are_refused_before_anything_moves(
    arm: type[Arm], servo: dict[str, Any], reason: str
) -> None:
    arm.servo, arm.trouble = servo, {"start": "the arm was moved"}
    with pytest.raises(CommandError, match=reason):
        measured()
