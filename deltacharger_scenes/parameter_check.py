# SPDX-License-Identifier: Apache-2.0
"""Check a scene's parameters against their declarations, without starting nodes."""

from __future__ import annotations

from collections.abc import Iterator
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
    for node, values in scene.parameters.items():
        known = {each.name: (each, table) for table in tables(node) for each in declared(table)}
        given: dict[type[Any], dict[str, Any]] = {}
        for name, value in values.items():
            if name in known:
                given.setdefault(known[name][1], {})[name] = value
            elif not name.startswith(_OF_ROS):
                yield f"parameters.{node}.{name}", f"unknown parameter{did_you_mean(name, known)}"
        for table, own in given.items():
            try:
                from_mapping(own, table, f"parameters.{node}")
            except ParameterError as error:
                yield error.key, error.problem
