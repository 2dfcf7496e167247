# SPDX-License-Identifier: Apache-2.0
"""Each declared parameter of docking and mission is read, and the machine uses the scene's value."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest

from deltacharger_core.parameters import Declaration, declared
from deltacharger_docking.parameters import DockingNodeParameters, DockingParameters
from deltacharger_docking.ros.docking_node import DockingNode
from deltacharger_lab.campaigns.keys import TAKEN, known_keys
from deltacharger_lab.campaigns.parts import build_parts
from deltacharger_mission.parameters import MissionNodeParameters, MissionParameters
from deltacharger_scenes.parameter_check import problems
from deltacharger_scenes.scene import parse_scene

from ..nodes import options

ROOT = Path(__file__).resolve().parents[2]
TABLES = (DockingParameters, DockingNodeParameters, MissionParameters, MissionNodeParameters)


def other(each: Declaration) -> Any:
    """Return an allowed value near the default, so that no two parameters contradict each other."""
    if each.name == "power":  # its other value allows one approach alone; see test_wired
        return each.default
    if isinstance(each.default, tuple):
        return [*each.default[:-1], 0.51]
    if each.kind is bool:
        return not each.default
    if each.kind is str:
        return next((word for word in each.choices if word != each.default), "elsewhere")
    if each.kind is int:
        return each.default + (1 if each.default < each.high else -1)
    return each.default + 1e-3 * min(each.high - each.default, each.default - each.low or each.high)


def values(node: str) -> dict[str, Any]:
    tables = TABLES[:2] if node == "docking_node" else TABLES[2:]
    return {each.name: other(each) for table in tables for each in declared(table)}


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_every_declared_parameter_is_read(table: type[Any]) -> None:
    """Read as an attribute somewhere in the package that declares it."""
    read = {
        node.attr
        for path in (ROOT / table.__module__.partition(".")[0]).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load)
    }
    assert not {each.name for each in declared(table)} - read


@pytest.mark.parametrize("node", ["docking_node", "mission_node"])
def test_a_scene_may_set_each_parameter_and_wrong_values_are_refused(node: str) -> None:
    given = values(node)
    assert not list(problems(parse_scene({"nodes": [node], "parameters": {node: given}}, "mine")))
    tables = TABLES[:2] if node == "docking_node" else TABLES[2:]
    for each in (each for table in tables for each in declared(table) if each.kind in (int, float)):
        wrong = {node: {each.name: "much"}}
        ((key, _),) = problems(parse_scene({"nodes": [node], "parameters": wrong}, "mine"))
        assert key == f"parameters.{node}.{each.name}"


@pytest.mark.ros
def test_the_node_uses_the_values_of_the_scene(context: Any, namespace: str) -> None:
    given = parse_scene({"nodes": ["docking_node"], "parameters": {"docking_node": values("docking_node")}}, "mine")
    node = DockingNode(held=True, **options(context, namespace, **given.node_parameters("docking_node", {})))
    try:
        decides_by = node._machine.parameters
    finally:
        node.destroy_node()
    assert decides_by == DockingParameters(**{each.name: other(each) for each in declared(DockingParameters)})


def test_a_campaign_uses_the_values_of_its_scene() -> None:
    numbers = {each.name: other(each) for each in declared(DockingParameters) if each.kind in (bool, int, float)}
    given = {f"docking.{name}": value for name, value in numbers.items() if f"docking.{name}" not in TAKEN}
    assert set(given) <= set(known_keys())
    _, _, docking = build_parts(given, "guarded")
    assert {f"docking.{name}": getattr(docking, name) for name in numbers if f"docking.{name}" in given} == given
