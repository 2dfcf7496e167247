# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate servos`: with an arm that fails in a given step, and over the real bytes."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import pytest

import deltacharger_bringup.cli.calibrate_servos as command
import deltacharger_records.datasets.arm_client as measuring
from deltacharger_bringup.cli.output import FAILED, CommandError
from deltacharger_core.servo_types import MeasuredServos
from deltacharger_core.yaml_file import read_declared
from deltacharger_kinematics.calibration.servo_procedure import Gains
from deltacharger_kinematics.geometry import DeltaGeometry, save_geometry
from deltacharger_records.datasets.arm_client import ArmError

from ..chargers import Process, wait_until
from ..marks import night, rest

pytestmark = pytest.mark.ros

GAINS = {"torque_constant": 1.3, "position_p_gain": 500, "position_d_gain": 3}
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
    ("where", "released", "is_off"),
    [("wait", True, False), ("start", True, True), ("measure", True, True), ("measure", False, False)],
)
def test_torque_is_reported_off_only_if_it_was_switched_off(
    arm: type[Arm], where: str, released: bool, is_off: bool
) -> None:
    arm.trouble, arm.released = {where: "docking_node is at work"}, released
    with pytest.raises(CommandError, match="docking_node") as caught:
        measured()
    assert (caught.value.exit_code, "the torque is off" in str(caught.value)) == (FAILED, is_off)


def test_a_failed_way_home_keeps_the_measurement(arm: type[Arm], capsys: pytest.CaptureFixture[str]) -> None:
    arm.trouble = {"retire": "cannot go that way"}
    task, gains, found = measured()
    assert (task.torque_constant, gains, found) == (1.3, Gains(500, 3), MEASURED)
    assert "cannot go that way" in capsys.readouterr().err


def test_unknown_gains_are_refused_before_anything_moves(arm: type[Arm]) -> None:
    arm.servo, arm.trouble = {}, {"start": "the arm was moved"}
    with pytest.raises(CommandError, match="gains"):
        measured()


WORLD = {
    "target": {"present": False},
    "servo": {"stiffness": 10.0, "friction": 0.08, "backlash": 0.004, "torque_constant": 1.3},
}
OLD = "stiffness: 7.0\n"


def test_docking_nodes_gravity_counts_also_with_another_geometry(tmp_path: Path) -> None:
    save_geometry(DeltaGeometry(arm=0.103), tmp_path / "arm.yaml")
    options = argparse.Namespace(geometry=str(tmp_path / "arm.yaml"), weight_percent=2.0, seconds=1.0, seed=1)
    docking = {"gravity": (0.0, 0.0, -9.81), "geometry_file": "/nowhere/arm.yaml"}
    task, _ = command._task(options, docking, GAINS)
    assert (task.gravity, task.geometry.arm) == ((0.0, 0.0, -9.81), 0.103)


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Any]:
    from deltacharger_scenes.scene import parse_scene

    from ..running_charger import RunningCharger

    with RunningCharger(parse_scene({"simulation": {"seed": 1, "world": WORLD}}, "free"), context) as charger:
        yield charger


@pytest.fixture
def measure(charger: Any, start: Callable[..., Process]) -> Iterator[Callable[..., Process]]:
    """Start the command on the running charger, whose torque is off afterwards."""

    def begin(*words: object) -> Process:
        cli = (sys.executable, "-m", "deltacharger_bringup.cli", "calibrate", "servos", "--json", "--namespace")
        return start(*cli, charger.namespace, *map(str, words))

    yield begin
    wait_until(lambda: not any(charger.world.torque), "torque off")


@pytest.mark.night
@pytest.mark.timeout(400)  # it takes 90 s
def test_servos_are_measured_over_the_real_bytes(measure: Callable[..., Process], tmp_path: Path) -> None:
    path = tmp_path / "servos.yaml"
    process = measure("--out", path, "--seconds", "80")
    process.process.wait(300.0)
    assert process.end() == 0, (process.out, process.err)
    result = json.loads(process.out[0])
    assert (result["success"], result["written"], result["doubts"]) == (True, str(path), [])
    found = read_declared(path, MeasuredServos)
    assert (found.stiffness, found.torque_constant) == pytest.approx((10.0, 1.3), rel=0.05)
    assert result["friction"][3][0] == pytest.approx(0.08, rel=0.2)
    assert found.position_p_gain == 434


@pytest.mark.parametrize("how", [rest(signal.SIGINT), night(signal.SIGTERM), night(signal.SIGHUP)])
def test_after_an_interruption_the_torque_is_off_and_the_old_file_is_unchanged(
    measure: Callable[..., Process], charger: Any, tmp_path: Path, how: signal.Signals
) -> None:
    old = tmp_path / "servos.yaml"
    old.write_text(OLD)
    refused = measure("--out", old)
    assert (refused.end(), "--force" in refused.out[0]) == (2, True)
    process = measure("--out", old, "--force")
    process.wait_for_line("Ctrl-C", process.err)
    start = list(charger.servos.position)
    wait_until(lambda: max(abs(a - b) for a, b in zip(charger.servos.position, start, strict=True)) > 0.05, "motion")
    assert any(charger.world.torque)
    assert process.end(how) == 130, process.err
    assert "torque is off" in json.loads(process.out[0])["error"]
    assert old.read_text() == OLD
