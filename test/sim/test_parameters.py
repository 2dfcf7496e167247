# SPDX-License-Identifier: Apache-2.0
"""The world's parameters have bounds and descriptions."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from typing import Any

from deltacharger_core.parameters import declared
from deltacharger_sim.parameters import WorldParameters


def names(instance: Any, path: str = "") -> set[str]:
    """Return the dotted names of all numbers."""
    found = set()
    for item in fields(instance):
        value = getattr(instance, item.name)
        found |= names(value, f"{path}{item.name}.") if is_dataclass(value) else {f"{path}{item.name}"}
    return found


def test_every_parameter_has_bounds_that_contain_its_default_and_a_description() -> None:
    known = {each.name: each for each in declared(WorldParameters)}
    for each in known.values():
        assert not each.problem(each.default), each.name
        assert each.text, each.name
        assert each.kind is bool or math.isfinite(each.low + each.high), each.name
    assert names(WorldParameters()) == set(known)
