# SPDX-License-Identifier: Apache-2.0
"""Every parameter of the world refuses what it cannot be, by name."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from pathlib import Path
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


def test_the_documented_table_is_the_code() -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")
    rows = {line for line in page.splitlines() if line.startswith("| ")}
    for each in declared(WorldParameters):
        row = f"| {each.name} | {each.default:.4g} | {each.low:g} to {each.high:g} | {each.unit} | {each.text} |"
        told = each.kind is bool or row in rows
        assert told, "run python benchmarks/world.py --parameters and put its table into docs/simulation.md"


def numbers(instance: Any, path: str = "") -> list[str]:
    found = []
    for item in fields(instance):
        value = getattr(instance, item.name)
        if is_dataclass(value):
            found += numbers(value, f"{path}{item.name}.")
        else:
            found.append(f"{path}{item.name}")
    return found
