# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the world refuses invalid values, by name."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from typing import Any

from deltacharger_core.parameters import declared
from deltacharger_sim.parameters import WorldParameters


def test_every_parameter_has_bounds_that_contain_its_default_and_a_description() -> None:
    known = {each.name: each for each in declared(WorldParameters)}
    for each in known.values():
        assert not each.problem(each.default), each.name
        assert each.text, each.name
        assert each.kind is bool or math.isfinite(each.low + each.high), each.name
    assert set(numbers(WorldParameters())) == set(known)


def numbers(instance: Any, path: str = "") -> list[str]:
    found = []
    for item in fields(instance):
        value = getattr(instance, item.name)
        if is_dataclass(value):
            found += numbers(value, f"{path}{item.name}.")
        else:
            found.append(f"{path}{item.name}")
    return found
