# SPDX-License-Identifier: Apache-2.0
"""Check a scene's parameters against their declarations, without starting nodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from deltacharger_core.parameters import ParameterError, declared, did_you_mean, from_mapping
from deltacharger_scenes.node_table import NODES, load
from deltacharger_scenes.scene import Scene

_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def tables(node: str) -> list[type[Any]]:
    """Return the classes that declare the parameters of a node, by its executable's name."""
    return [load(path) for path in NODES[node].parameters]


def problems(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield key and problem of each parameter that its node would reject, the first of each class of parameters."""
    for node in scene.parameters:
        values = scene.node_parameters(node, {})
        names, entry = _named(node, values)
        sections = [("", table) for table in tables(node)] + [(f"{name}.", entry) for name in names]
        known = {before + each.name: (before, table) for before, table in sections for each in declared(table)}
        given: dict[tuple[str, type[Any]], dict[str, Any]] = {section: {} for section in sections if section[0]}
        for name, value in values.items():
            if name in known:
                before, table = known[name]
                given.setdefault((before, table), {})[name.removeprefix(before)] = value
            elif not name.startswith(_OF_ROS):
                yield f"parameters.{node}.{name}", f"unknown parameter{did_you_mean(name, known)}"
        for (before, table), own in given.items():
            try:
                from_mapping(own, table, f"parameters.{node}.{before}".rstrip("."))
            except ParameterError as error:
                yield error.key, error.problem


def _named(node: str, values: Mapping[str, Any]) -> tuple[list[str], type[Any]]:
    """Return the names that a node's parameter lists, and the class that declares the parameters of each."""
    parameter, entry = NODES[node].named
    names = values.get(parameter, [])
    if not parameter or not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return [], object
    return names, load(entry)
