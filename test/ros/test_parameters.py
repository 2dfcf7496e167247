# SPDX-License-Identifier: Apache-2.0
"""A node has exactly the parameters that its package declares, from parameters or files, and changes them together."""

import contextlib
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_core.machine import POSITION_P_GAIN, SERVO_STIFFNESS, TORQUE_CONSTANT
from deltacharger_core.parameters import Bounded, ParameterError, choice, flag, number, numbers, tunable, words
from deltacharger_core.ros.node_support import StartupError
from deltacharger_core.ros.parameters import Tuning, declare_all, reject_unknown
from deltacharger_docking.ros.docking_node import DockingNode
from deltacharger_driver.ports import PseudoTerminal
from deltacharger_driver.servos.servo_node import ServoNode
from deltacharger_kinematics.kinematics_node import KinematicsNode
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ..nodes import options
from ..plants import BenchArm

pytestmark = pytest.mark.ros


@dataclass(frozen=True)
class Rates(Bounded):
    rate: float = number(50.0, 1.0, 500.0, "Hz", "how often")
    count: int = number(3, 1, 9, "", "how many")
    corner: tuple[float, ...] = numbers((0.0, 1.0), -2.0, 2.0, "m", "of the box")
    mode: str = choice("soft", ("soft", "stiff"), "how it yields", tunable=True)
    files: tuple[str, ...] = words(("",), "to read")
    on: bool = flag(True, "whether it is")


def test_the_node_describes_its_declared_parameters(context: Any, namespace: str) -> None:
    node = Node("subject", **options(context, namespace, corner=[1.0, 2.0], files=["a", "b"]))
    try:
        given = declare_all(node, Rates, defaults=Rates(rate=60.0))
        assert given == Rates(rate=60.0, corner=(1.0, 2.0), files=("a", "b"))
        described = {name: node.describe_parameter(name) for name in Rates.__dataclass_fields__}
    finally:
        node.destroy_node()
    assert described["rate"].description == "how often (Hz)"
    assert described["rate"].floating_point_range[0].to_value == 500.0
    assert described["count"].integer_range[0].from_value == 1
    assert described["corner"].additional_constraints == "-2.0 to 2.0"
    assert described["mode"].additional_constraints == "one of: soft, stiff"
    assert not described["files"].additional_constraints
    assert [each.read_only for each in described.values()] == [True, True, True, False, True, True]


@pytest.mark.version
@pytest.mark.parametrize("source", ["-p", "--params-file"])
def test_integers_are_accepted_for_floats_from_command_line_and_files(
    context: Any, namespace: str, tmp_path: Path, source: str
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text("/**:\n  ros__parameters: {rate: 60, corner: [0, 1]}\n")
    words = ["-p", "rate:=60", "-p", "corner:=[0, 1]"] if source == "-p" else [source, str(file)]
    node = Node("subject", cli_args=["--ros-args", *words], **options(context, namespace))
    try:
        assert declare_all(node, Rates) == Rates(rate=60.0, corner=(0.0, 1.0))
        reject_unknown(node)
    finally:
        node.destroy_node()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rate": 900.0}, "'rate'"),
        ({"count": 2.0}, "'count'"),
        ({"rat": 5.0}, "did you mean 'rate'"),
    ],
)
def test_a_wrong_parameter_stops_the_node_with_its_name(
    context: Any, namespace: str, given: dict[str, Any], message: str
) -> None:
    class Subject(Node):
        def __init__(self) -> None:
            super().__init__("subject", **options(context, namespace, **given))
            declare_all(self, Rates)
            reject_unknown(self)

    with pytest.raises(StartupError, match=message):
        Subject()


@pytest.mark.parametrize(
    ("name", "section", "refused"),
    [
        ("mine.yaml", "/**", False),
        ("mine.yaml", "/robot/subject", True),
        ("launch_params_x", "/**", True),
    ],
)
def test_only_a_section_for_all_nodes_may_name_parameters_of_others(
    context: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    name: str,
    section: str,
    refused: bool,
) -> None:
    file = tmp_path / name
    file.write_text(section + ": {ros__parameters: {map: {frame: earth}}}")
    arguments = ["--ros-args", "--params-file", str(file)]
    monkeypatch.setattr(sys, "argv", ["node", *arguments])
    node = Node("subject", cli_args=arguments, **options(context, "/robot"))
    try:
        with pytest.raises(StartupError, match=r"map\.frame") if refused else contextlib.nullcontext():
            reject_unknown(node)
    finally:
        node.destroy_node()
    assert capfd.readouterr().err.count("ignored: map.frame") == (not refused)


@dataclass(frozen=True)
class Band(Bounded):
    low: float = tunable(0.4, 0.1, 2.0, "A", "lower end")
    high: float = tunable(0.5, 0.1, 2.0, "A", "upper end")
    tries: int = tunable(3, 1, 9, "", "how often")
    files: tuple[str, ...] = words(("",), "to read", tunable=True)
    port: str = words("/dev/ttyUSB0", "of the servos")
    rate: float = number(100.0, 20.0, 200.0, "Hz", "of the bus")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low > self.high:
            raise ParameterError("low", self.low, "low must not lie above high")


class Subject(Node):
    """Keeps the accepted values."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("subject", **kwargs)
        self.refusal = ""
        self.taken: list[Band] = []
        given = declare_all(self, Band)
        reject_unknown(self)
        Tuning(self, given, self._take)

    def _take(self, given: Band) -> str:
        if not self.refusal:
            self.taken.append(given)
        return self.refusal

    def each(self, **values: Any) -> list[str]:
        """Set values one after the other and return the reasons of refusals."""
        results = self.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        assert all(result.successful == (not result.reason) for result in results)
        return [result.reason for result in results]

    def together(self, **values: Any) -> str:
        """Set values at once and return the reason of a refusal."""
        result = self.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])
        assert result.successful == (not result.reason)
        return str(result.reason)

    def values_now(self) -> dict[str, Any]:
        return {name: self.get_parameter(name).value for name in Band.__dataclass_fields__}


@pytest.fixture
def subject(context: Any, namespace: str) -> Iterator[Subject]:
    subject = Subject(**options(context, namespace))
    yield subject
    subject.destroy_node()


@pytest.mark.version
def test_new_values_are_applied_and_logged(subject: Subject) -> None:
    assert subject.each(low=0.45, tries=5) == ["", ""]
    assert subject.taken == [Band(low=0.45), Band(low=0.45, tries=5)]
    assert subject.together(files=["a", "b"], high=0.6) == ""
    assert subject.taken[2:] == [Band(low=0.45, high=0.6, tries=5, files=("a", "b"))]
    assert (subject.values_now()["low"], subject.values_now()["high"]) == (0.45, 0.6)
    assert subject.each(high=1) == [""], "so does `ros2 param set` send it"
    assert subject.values_now()["high"] == 1.0


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"low": 0.45, "tries": 10}, "tries"),
        ({"low": 0.45, "high": math.nan}, "high"),
        ({"low": 0.45, "high": True}, "Wrong parameter type"),
        ({"low": 0.45, "port": "/dev/ttyUSB1"}, "read-only parameter: port"),
    ],
)
def test_one_wrong_value_refuses_all_of_the_call(subject: Subject, values: dict[str, Any], reason: str) -> None:
    before = subject.values_now()
    assert reason in subject.together(**values)
    assert subject.values_now() == before
    assert subject.taken == []


def test_values_that_the_node_refuses_stay_unchanged(subject: Subject) -> None:
    subject.refusal = "a goal is running"
    assert subject.each(low=0.45) == ["low not set: a goal is running"]
    assert subject.together(low=0.45, high=0.6) == "low, high not set: a goal is running"
    assert subject.values_now()["low"] == 0.4


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
    constant, stiffness = (1.31, 9.5) if given else (TORQUE_CONSTANT, SERVO_STIFFNESS)
    gain, braking = (300, 4) if given else (POSITION_P_GAIN, 2715)  # nothing but its D gain brakes a servo in mode 5
    emulator = ServoBusEmulator(BenchArm())
    with PseudoTerminal(emulator, tmp_path / "servo") as terminal:
        node = ServoNode(**options(context, namespace, port=terminal.path, **file))
        values = parameters(node, "torque_constant", "position_p_gain", "position_d_gain")
    assert values == [constant, gain, braking]
    assert [emulator.servo(servo).table.get("position_p_gain") for servo in (1, 2, 3)] == [gain] * 3
    docking = DockingNode(**options(context, namespace, **file))
    assert docking._settings.servo_stiffness == stiffness
    assert parameters(docking, "servo_stiffness", "torque_constant") == [stiffness, constant]
    kinematics = KinematicsNode(**options(context, namespace, torque_constant=constant, **file))
    assert parameters(kinematics, "torque_constant") == [constant]


@pytest.mark.parametrize(
    ("kind", "content", "beside", "reason"),
    [
        (ServoNode, CONTENT, {"position_p_gain": 434}, r"'position_p_gain' is 434, .*'servos_file'.* has 300"),
        (KinematicsNode, "stifness: 9.0", {}, "did you mean 'stiffness'"),
        (DockingNode, "stiffness: 180.0", {}, "0.5 to 160"),
        (KinematicsNode, "position_p_gain: 434.5", {}, "position_p_gain"),
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
