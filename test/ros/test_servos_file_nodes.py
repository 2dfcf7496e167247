# SPDX-License-Identifier: Apache-2.0
"""All nodes that use servo properties take them from one file; contradicting parameters are refused."""

from __future__ import annotations

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

from ..nodes import options

pytestmark = pytest.mark.ros

CONTENT = "{stiffness: 9.5, torque_constant: 1.31, position_p_gain: 300, position_d_gain: 4}"


def parameters(node: Any, *names: str) -> list[Any]:
    try:
        return [node.get_parameter(name).value for name in names]
    finally:
        node.close()
        node.destroy_node()


@pytest.mark.parametrize("given", [True, False])
def test_every_node_uses_the_values_of_the_file_or_the_defaults(
    context: Any, namespace: str, tmp_path: Path, given: bool
) -> None:
    path = tmp_path / "servos.yaml"
    path.write_text(CONTENT)
    file = {"servos_file": str(path)} if given else {}
    constant, stiffness, gain = (1.31, 9.5, 300) if given else (TORQUE_CONSTANT, SERVO_STIFFNESS, POSITION_P_GAIN)
    emulator = ServoBusEmulator(BenchArm())
    with PseudoTerminal(emulator, tmp_path / "servo") as terminal:
        node = ServoNode(**options(context, namespace, port=terminal.path, **file))
        values = parameters(node, "torque_constant", "position_p_gain", "position_i_gain", "position_d_gain")
    assert values == [constant, gain, 0, 4 if given else 0]
    assert [emulator.servo(servo).table.get("position_p_gain") for servo in (1, 2, 3)] == [gain] * 3
    docking = DockingNode(**options(context, namespace, **file))
    assert docking._settings.servo_stiffness == stiffness
    assert parameters(docking, "servo_stiffness", "torque_constant") == [stiffness, constant]
    kinematics = KinematicsNode(**options(context, namespace, torque_constant=constant, **file))
    assert parameters(kinematics, "torque_constant") == [constant]


def test_a_file_may_have_any_stiffness_that_docking_accepts() -> None:
    bounds = {each.name: (each.low, each.high) for each in declared(DockingParameters)}["servo_stiffness"]
    assert bounds == (STIFFNESS_MIN, STIFFNESS_MAX)


@pytest.mark.parametrize(
    ("kind", "content", "beside", "reason"),
    [
        (ServoNode, CONTENT, {"position_p_gain": 434}, r"'position_p_gain' is 434, .*'servos_file'.* has 300"),
        (KinematicsNode, CONTENT, {"torque_constant": 1.4}, r"'torque_constant' is 1.4, .*'servos_file'"),
        (DockingNode, CONTENT, {"servo_stiffness": 15.0}, r"'servo_stiffness' is 15.0, .*'servos_file'.* has 9.5"),
        (KinematicsNode, "stifness: 9.0", {}, "did you mean 'stiffness'"),
        (DockingNode, "stiffness: 180.0", {}, "0.5 to 160"),
        (ServoNode, None, {}, "cannot be read"),
    ],
)
def test_a_contradicting_parameter_or_a_wrong_file_stops_the_node(
    context: Any,
    namespace: str,
    tmp_path: Path,
    kind: type[Node],
    content: str | None,
    beside: dict[str, Any],
    reason: str,
) -> None:
    path = tmp_path / "mine.yaml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(StartupError, match=reason):
        kind(**options(context, namespace, servos_file=str(path), **beside))
