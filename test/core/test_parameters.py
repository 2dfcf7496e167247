# SPDX-License-Identifier: Apache-2.0
"""A declared parameter refuses invalid values by name, from any source."""

import math
from dataclasses import dataclass, field
from typing import Any

import pytest

from deltacharger_core import parameters
from deltacharger_core.parameters import choice, entries, flag, number, numbers, words


@dataclass(frozen=True)
class Spring(parameters.Bounded):
    stiffness: float = number(15.0, 2.5, 20.0, "N·m/rad", "of the joint")
    turns: int = number(3, 1, 9, "", "of its wire")


@dataclass(frozen=True)
class Arm(parameters.Bounded):
    spring: Spring = field(default_factory=Spring)
    springs: tuple[Spring, ...] = entries("further ones")
    name: str = words("left", "on the label")
    files: tuple[str, ...] = words(("",), "where it is described")
    on: bool = flag(True, "whether it is")
    mode: str = choice("soft", ("soft", "stiff"), "how it yields")
    corner: tuple[float, ...] = numbers((0.0, 1.0), -2.0, 2.0, "m", "of its box")
    limit: float | None = number(None, 0.0, 1.0, "A", "{unit} at most; none = whatever comes")
    share: float = parameters.like(Spring, "stiffness", high=18.0)


WRONG: list[tuple[dict[str, Any], str, str]] = [
    ({"spring": {"stiffness": 2.4}}, "arm.spring.stiffness", "2.4 is outside 2.5 to 20 N·m/rad"),
    ({"spring": {"stiffness": math.nan}}, "arm.spring.stiffness", "not finite"),
    *(({"spring": {"stiffness": wrong}}, "arm.spring.stiffness", "not a number") for wrong in ("15", True, None)),
    ({"spring": {"trns": 2}}, "arm.spring.trns", "did you mean 'turns'?"),
    ({"qqq": 2}, "arm.qqq", "known are spring, "),
    ({"spring": 3}, "arm.spring", "not a mapping"),
    ({"springs": [{}, {"turns": 0}]}, "arm.springs[1].turns", "outside 1 to 9"),
    ({"name": 3}, "arm.name", "not text"),
    ({"on": 1}, "arm.on", "not true or false"),
    ({"mode": "hard"}, "arm.mode", "not one of soft, stiff"),
    ({"corner": [0.0, 3.0]}, "arm.corner", "3.0 is outside -2 to 2 m"),
    ({"share": 19.0}, "arm.share", "outside 2.5 to 18"),
]


@pytest.mark.parametrize(("content", "key", "problem"), WRONG, ids=str)
def test_a_refusal_names_the_key_and_the_allowed_values(content: dict[str, Any], key: str, problem: str) -> None:
    with pytest.raises(parameters.ParameterError) as refusal:
        parameters.from_mapping(content, Arm, "arm")
    assert refusal.value.key == key
    assert problem in refusal.value.problem


def test_a_mapping_sets_its_keys_and_leaves_other_defaults() -> None:
    arm = parameters.from_mapping(
        {"spring": {"stiffness": 5}, "springs": [{"turns": 2}], "corner": [0, 1], "limit": None}, Arm
    )
    assert arm == Arm(spring=Spring(5.0), springs=(Spring(turns=2),), corner=(0.0, 1.0))
    assert isinstance(arm.spring.stiffness, float)
    assert parameters.from_mapping({}, Arm) == Arm()


def test_declarations_provide_name_bounds_default_and_text() -> None:
    known = {each.name: each for each in parameters.declared(Arm, "arm")}
    assert list(known)[:3] == ["arm.spring.stiffness", "arm.spring.turns", "arm.springs"]
    stiffness = known["arm.spring.stiffness"]
    assert (stiffness.default, stiffness.low, stiffness.high, stiffness.kind) == (15.0, 2.5, 20.0, float)
    assert stiffness.description() == "of the joint (N·m/rad)"
    assert known["arm.limit"].description() == "A at most; none = whatever comes"
    assert known["arm.mode"].choices == ("soft", "stiff")
