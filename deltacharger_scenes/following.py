# SPDX-License-Identifier: Apache-2.0
"""What a simulated scene's nodes take arm, gravity and power for: what its world has, unless the scene differs."""

from __future__ import annotations

import operator
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from deltacharger_core.bounded_file import brief
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
        **{axis: (axis,) for axis in _GRAVITY},
    },
}
"""Of each node, its parameters with the keys of the world that they follow."""
_TOLD_AS = {"circuit.wired": {False: "board", True: "none"}}
"""Of a key, what the parameter that follows it is called for each of its values."""


def followed(node: str, world: WorldParameters, parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the parameters of a node that follow from the world.

    A node with a `servos_file` takes its servos from there. A position gain that the scene gives to servo_node makes
    them as much stiffer as it is larger.

    Args:
        node: its executable's name.
        world: the scene's own.
        parameters: of each node, as the scene gives them.
    """
    found = {name: _value(world, keys) for name, keys in _FOLLOWS.get(node, {}).items()}
    if parameters.get(node, {}).get("servos_file"):
        return {name: value for name, value in found.items() if not _FOLLOWS[node][name][0].startswith("servo.")}
    gain = parameters.get("servo_node", {}).get("position_p_gain", POSITION_P_GAIN)
    if "servo_stiffness" in found and isinstance(gain, int):
        found["servo_stiffness"] *= gain / POSITION_P_GAIN
    return found


def contradictions(parameters: Mapping[str, Mapping[str, Any]], world: WorldParameters) -> Iterator[tuple[str, str]]:
    """Yield key and problem of each parameter that a scene sets otherwise than its own world is.

    Args:
        parameters: of each node by its executable's name, as the scene gives them.
        world: the scene's own.
    """
    for node, values in parameters.items():
        for name, true in followed(node, world, parameters).items():
            if name in values and values[name] != true:
                keys = ", ".join(f"simulation.world.{key}" for key in _FOLLOWS[node][name])
                yield (
                    f"parameters.{node}.{name}",
                    f"is {brief(values[name])}, but {keys} is {true!r}; leave one of them out",
                )


def servos_apart(nodes: Collection[str], parameters: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield key and problem of each node that takes its servos from elsewhere than the first that has a `servos_file`.

    Gains, stiffness and torque constant of one file belong together.

    Args:
        nodes: of the scene.
        parameters: of each, as the scene gives them.
    """
    files = {node: parameters.get(node, {}).get("servos_file", "") for node in _FOLLOWS if node in nodes}
    first = next((node for node, file in files.items() if file), "")
    for node, file in files.items():
        if first and file != files[first]:
            yield (
                f"parameters.{node}.servos_file",
                f"is {brief(file)}, but that of {first} is {brief(files[first])}; give {', '.join(files)} one",
            )


def _value(world: WorldParameters, keys: tuple[str, ...]) -> Any:
    values = [_told_as(key, operator.attrgetter(key)(world)) for key in keys]
    return values if len(values) > 1 else values[0]


def _told_as(key: str, value: Any) -> Any:
    return _TOLD_AS.get(key, {}).get(value, value)
