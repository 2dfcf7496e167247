# SPDX-License-Identifier: Apache-2.0
"""All nodes that use servo properties take them from one file; contradicting parameters are refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node

from deltacharger_core.machine import POSITION_P_GAIN, SERVO_STIFFNESS, TORQUE_CONSTANT
from deltacharger_core.parameters import declared
from deltacharger_core.servos_file import STIFFNESS_MAX, STIFFNESS_MIN
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.ros.docking_node import DockingNode
from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.servo_node import ServoNode
from deltacharger_kinematics.kinematics_node import KinematicsNode
from deltacharger_ros.node_support import StartupError

from ..chargers import new_namespace
from ..nodes import options

pytestmark = pytest.mark.ros

CONTENT = "{stiffness: 9.5, torque_constant: 1.31, position_p_gain: 300, position_d_gain: 4}"


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "servos.yaml"
    path.write_text(CONTENT)
    return str(path)


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[tuple[ServoBusEmulator, str]]:
    emulator = ServoBusEmulator(BenchArm())
    with PseudoTerminal(emulator, tmp_path / "servo") as terminal:
        yield emulator, terminal.path


def parameters(node: Any, *names: str) -> list[Any]:
    try:
        return [node.get_parameter(name).value for name in names]
    finally:
        node.close()
        node.destroy_node()


def test_servo_node_uses_the_gains_of_the_file(context: Any, file: str, emulator: tuple[ServoBusEmulator, str]) -> None:
    bus, port = emulator
    node = ServoNode(**options(context, new_namespace(), port=port, servos_file=file))
    values = parameters(node, "torque_constant", "position_p_gain", "position_i_gain", "position_d_gain")
    assert values == [1.31, 300, 0, 4]
    assert [bus.servo(servo).table.get("position_p_gain") for servo in (1, 2, 3)] == [300, 300, 300]


def test_docking_node_and_kinematics_node_use_the_file(context: Any, file: str) -> None:
    docking = DockingNode(**options(context, new_namespace(), servos_file=file))
    assert docking._settings.servo_stiffness == 9.5
    assert parameters(docking, "servo_stiffness", "torque_constant") == [9.5, 1.31]
    kinematics = KinematicsNode(**options(context, new_namespace(), servos_file=file, torque_constant=1.31))
    assert parameters(kinematics, "torque_constant") == [1.31]


def test_a_file_may_have_any_stiffness_that_docking_accepts() -> None:
    bounds = {each.name: (each.low, each.high) for each in declared(DockingParameters)}["servo_stiffness"]
    assert bounds == (STIFFNESS_MIN, STIFFNESS_MAX)


def test_without_a_file_defaults_are_used(context: Any, emulator: tuple[ServoBusEmulator, str]) -> None:
    docking = DockingNode(**options(context, new_namespace()))
    assert parameters(docking, "servo_stiffness", "torque_constant") == [SERVO_STIFFNESS, TORQUE_CONSTANT]
    servo = ServoNode(**options(context, new_namespace(), port=emulator[1]))
    assert parameters(servo, "position_p_gain", "position_i_gain") == [POSITION_P_GAIN, 0]


@pytest.mark.parametrize(
    ("kind", "beside", "reason"),
    [
        (ServoNode, {"position_p_gain": 434}, r"'position_p_gain' is 434, .*'servos_file'.* has 300"),
        (KinematicsNode, {"torque_constant": 1.4}, r"'torque_constant' is 1\.4, .*'servos_file'"),
        (DockingNode, {"servo_stiffness": 15.0}, r"'servo_stiffness' is 15\.0, .*'servos_file'.* has 9\.5"),
    ],
)
def test_a_contradicting_parameter_stops_the_node_with_both_names(
    context: Any, file: str, kind: type[Node], beside: dict[str, Any], reason: str
) -> None:
    with pytest.raises(StartupError, match=reason):
        kind(**options(context, new_namespace(), servos_file=file, **beside))


@pytest.mark.parametrize(
    ("content", "reason"),
    [("stifness: 9.0", "did you mean 'stiffness'"), ("stiffness: 180.0", "0.5 to 160"), (None, "read")],
)
def test_a_refused_file_stops_the_node_with_the_reason(
    context: Any, tmp_path: Path, content: str | None, reason: str
) -> None:
    path = tmp_path / "bad.yaml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(StartupError, match=reason) as caught:
        KinematicsNode(**options(context, new_namespace(), servos_file=str(path)))
    assert "bad.yaml" in str(caught.value)
