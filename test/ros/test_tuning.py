# SPDX-License-Identifier: Apache-2.0
"""One call sets all its live parameters or none, and refusals state the reason; other parameters are read-only."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_core.parameters import Bounded, ParameterError, number, tunable, words
from deltacharger_ros.parameters import declare_all, reject_unknown
from deltacharger_ros.regularly import Regularly
from deltacharger_ros.tuning import Tuning

from ..nodes import call, options
from ..waiting import DEADLINE, wait_until

pytestmark = pytest.mark.ros


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


class Setter:
    """A client of the subject's parameters."""

    def __init__(self, node: Node, subject: Subject) -> None:
        self.subject = subject
        self._single = node.create_client(SetParameters, "subject/set_parameters")
        self._atomic = node.create_client(SetParametersAtomically, "subject/set_parameters_atomically")
        for client in (self._single, self._atomic):
            assert client.wait_for_service(DEADLINE)

    def each(self, **values: Any) -> list[str]:
        """Set values one after the other and return the reasons of refusals."""
        results = call(self._single, SetParameters.Request(parameters=_messages(values))).results
        assert all(result.successful == (not result.reason) for result in results)
        return [result.reason for result in results]

    def together(self, **values: Any) -> str:
        """Set values at once and return the reason of a refusal."""
        result = call(self._atomic, SetParametersAtomically.Request(parameters=_messages(values))).result
        assert result.successful == (not result.reason)
        return str(result.reason)

    def values_now(self) -> dict[str, Any]:
        return {name: self.subject.get_parameter(name).value for name in Band.__dataclass_fields__}


def _messages(values: dict[str, Any]) -> list[Any]:
    return [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]


@pytest.fixture
def setter(context: Any, namespace: str, spin: Callable[[Any], Any]) -> Setter:
    subject = spin(Subject(**options(context, namespace)))
    return Setter(spin(Node("setter", **options(context, namespace))), subject)


@pytest.mark.version
def test_new_values_are_applied_and_logged(setter: Setter) -> None:
    assert setter.each(low=0.45, tries=5) == ["", ""]
    assert setter.subject.taken == [Band(low=0.45), Band(low=0.45, tries=5)]
    assert setter.together(files=["a", "b"], high=0.6) == ""
    assert setter.subject.taken[2:] == [Band(low=0.45, high=0.6, tries=5, files=("a", "b"))]
    assert (setter.values_now()["low"], setter.values_now()["high"]) == (0.45, 0.6)
    assert setter.together(high=0.6) == ""
    assert len(setter.subject.taken) == 3, "nothing to take"


def test_an_integer_is_accepted_for_a_float(setter: Setter) -> None:
    assert setter.each(high=1) == [""], "so does `ros2 param set` send it"
    assert setter.subject.taken == [Band(high=1.0)]
    assert "high" in setter.each(high=3)[0]
    assert "Wrong parameter type" in setter.each(high=True)[0]


def test_coupled_values_must_be_set_together(setter: Setter) -> None:
    assert "low must not lie above high" in setter.each(low=0.7)[0]
    assert setter.values_now()["low"] == 0.4
    assert setter.together(low=0.9, high=1.0) == ""
    assert "low must not lie above high" in setter.together(low=1.0, high=0.9)
    assert setter.subject.taken[-1] == Band(low=0.9, high=1.0)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"low": 0.45, "tries": 10}, "tries"),
        ({"low": 0.45, "high": math.nan}, "high"),
        ({"low": 0.45, "tries": 2.5}, "Wrong parameter type"),
        ({"low": 0.45, "port": "/dev/ttyUSB1"}, "read-only parameter: port"),
        ({"low": 0.45, "lower": 0.1}, "undeclared parameter"),
    ],
)
def test_one_wrong_value_refuses_all_of_the_call(setter: Setter, values: dict[str, Any], reason: str) -> None:
    before = setter.values_now()
    assert reason in setter.together(**values)
    assert setter.values_now() == before
    assert setter.subject.taken == []


def test_values_that_the_node_refuses_stay_unchanged(setter: Setter) -> None:
    setter.subject.refusal = "a goal is running"
    assert setter.each(low=0.45) == ["low not set: a goal is running"]
    assert setter.together(low=0.45, high=0.6) == "low, high not set: a goal is running"
    assert setter.values_now()["low"] == 0.4
    setter.subject.refusal = ""
    assert setter.together(low=0.45) == ""


def test_a_rate_can_change_and_a_stop_is_final() -> None:
    working: list[tuple[float, threading.Event]] = []

    def work(period: float, stopping: threading.Event) -> None:
        working.append((period, stopping))
        assert stopping.wait(DEADLINE)

    regularly = Regularly(work, "subject")
    regularly.start(0.0)
    assert not working
    regularly.start(10.0)
    regularly.start(20.0)
    wait_until(lambda: len(working) == 2)
    (first, ended), (second, goes_on) = working
    assert (first, second) == (0.1, 0.05)
    assert ended.is_set()
    assert not goes_on.is_set()
    regularly.stop()
    regularly.start(30.0)
    assert goes_on.is_set()
    assert len(working) == 2
