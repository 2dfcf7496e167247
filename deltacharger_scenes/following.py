# SPDX-License-Identifier: Apache-2.0
"""Parameters of a simulated scene's nodes that follow its world: arm, gravity, power, unless the scene sets them."""

from __future__ import annotations

import operator
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from deltacharger_core.files import brief
from deltacharger_core.machine import POSITION_P_GAIN
from deltacharger_sim.parameters import WorldParameters

_GRAVITY = ("gravity_x", "gravity_y", "gravity_z")
_CONSTANT = ("servo.torque_constant",)
_FOLLOWS: dict[str, dict[str, tuple[str, ...]]] = {
    "servo_node": {"torque_constant": _CONSTANT},
    "kinematics_node": {"gravity": _GRAVITY, "torque_constant": _CONSTANT},
    "docking_node": {
        "servo_stiffness": ("servo.stiffness",),
        "power": ("circuit.wired",),
        "torque_constant": _CONSTANT,
        "gravity": _GRAVITY,
    },
}
"""For each node: its parameters, and the keys of the world that they follow."""
_LITHIUM_7S = {"empty_voltage": 19.0, "full_voltage": 29.4, "current": 10.0, "end_current": 0.5}
SIMULATED_TARGET = {
    "target_profiles": ["lithium_7s"],
    **{f"lithium_7s.{key}": value for key, value in _LITHIUM_7S.items()},
}
"""Parameters of docking_node: the profile of a simulated or mock target, unless the scene has `target_profiles`."""
_PARAMETER_VALUES = {"circuit.wired": {False: "board", True: "none"}}
"""For a key of the world: each of its values, and the value of the parameter that follows it."""


def followed(node: str, world: WorldParameters, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the parameters of a node that follow the world.

    A node with a `servos_file` takes its servos from that file. A position gain in servo_node's parameters scales their
    stiffness.

    Args:
        node: its executable's name.
        world: of the scene.
        parameters: of each node, as the scene sets them.
    """
    found = {name: _value(world, keys) for name, keys in _FOLLOWS.get(node, {}).items()}
    if parameters.get(node, {}).get("servos_file"):
        return {name: value for name, value in found.items() if not _FOLLOWS[node][name][0].startswith("servo.")}
    gain = parameters.get("servo_node", {}).get("position_p_gain", POSITION_P_GAIN)
    if "servo_stiffness" in found and isinstance(gain, int):
        found["servo_stiffness"] *= gain / POSITION_P_GAIN
    return found


def contradictions(parameters: Mapping[str, Mapping[str, Any]], world: WorldParameters) -> Iterator[tuple[str, str]]:
    """Yield key and problem of each parameter whose value differs from the scene's own world.

    Args:
        parameters: of each node by its executable's name, as the scene sets them.
        world: of the scene.
    """
    for node, values in parameters.items():
        for name, true in followed(node, world, parameters).items():
            if name in values and values[name] != true:
                keys = ", ".join(f"simulation.world.{key}" for key in _FOLLOWS[node][name])
                yield (
                    f"parameters.{node}.{name}",
                    f"is {brief(values[name])}, but {keys} is {true!r}: leave one of them out",
                )


def servos_apart(nodes: Collection[str], parameters: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield key and problem of each node whose `servos_file` differs from the first one.

    Gains, stiffness and torque constant must be from one file.

    Args:
        nodes: of the scene.
        parameters: of each, as the scene sets them.
    """
    files = {node: parameters.get(node, {}).get("servos_file", "") for node in _FOLLOWS if node in nodes}
    first = next((node for node, file in files.items() if file), "")
    for node, file in files.items():
        if first and file != files[first]:
            yield (
                f"parameters.{node}.servos_file",
                f"is {brief(file)}, but {first}'s is {brief(files[first])}: give {', '.join(files)} the same file",
            )


def _value(world: WorldParameters, keys: tuple[str, ...]) -> Any:
    values = [_parameter_value(key, operator.attrgetter(key)(world)) for key in keys]
    return values if len(values) > 1 else values[0]


def _parameter_value(key: str, value: Any) -> Any:
    return _PARAMETER_VALUES.get(key, {}).get(value, value)
