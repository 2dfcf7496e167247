# SPDX-License-Identifier: Apache-2.0
"""Parameters of world, pads and docking from the values of a campaign's keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_core.parameters import declared, from_mapping
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import Vector
from deltacharger_lab.campaigns.assumed import assumed_gravity, tilted_gravity
from deltacharger_lab.campaigns.spread import Value
from deltacharger_lab.second.parameters import PlatformRestParameters, SecondParameters
from deltacharger_sim.parameters import WorldParameters
from deltacharger_tactile.parameters import PadContactParameters, TactileParameters

NOMINAL: Vector = (0.0, 0.0, DOCK_DISTANCE)  # m, charger_base; origin of a target's offsets
AXES = ("x", "y", "z", "roll")
_COMPLIANCE = {key.name: key for key in declared(PlatformRestParameters)}["compliance"]


def build_parts(values: Mapping[str, Value]) -> tuple[WorldParameters, TactileParameters, DockingParameters]:
    """Return the parameters of world, pads and docking for these values of the scene's keys.

    Raises:
        ParameterError: world, pads or docking refuses them.
    """
    place = {axis: float(values.get(f"target.{axis}", 0.0)) + float(values.get(f"shift.{axis}", 0.0)) for axis in AXES}
    gravity = tilted_gravity(float(values.get("gravity.tilt", 0.0)), float(values.get("gravity.azimuth", 0.0)))
    content = nested(values, "world")
    target = content.setdefault("target", {})
    target.update(place, z=NOMINAL[2] + place["z"])
    target["tilt_x"], target["tilt_y"] = target_lean(values)
    content.update(_axes(gravity))
    world = from_mapping(content, WorldParameters, "world")
    factor, constant = (float(values.get(f"assumed.{name}", 1.0)) for name in ("servo_stiffness", "torque_constant"))
    given: dict[str, Any] = {
        "servo_stiffness": factor * world.servo.stiffness,
        "torque_constant": constant * world.servo.torque_constant,
        "power": "none" if world.circuit.wired else "board",
        "gravity": assumed_gravity(values, gravity),
    }
    if world.magnets.force == 0.0:  # a charger built without magnets is known to have none
        given["magnet_force"] = 0.0
    docking = from_mapping(given | nested(values, "docking"), DockingParameters, "docking")
    contact = replace(PadContactParameters(), **nested(values, "electrode"))
    return world, TactileParameters(contact=contact), docking


def target_lean(values: Mapping[str, Value]) -> tuple[float, float]:
    """Return pitch and yaw of the target's faces against the platform, rad."""
    pitch, yaw = (float(values.get(f"world.target.tilt_{axis}", 0.0)) for axis in "xy")
    return pitch, yaw - float(values.get("parked.heading", 0.0))


def second_family(values: Mapping[str, Value]) -> SecondParameters | None:
    """Return the family of rigs of the second physics; None = its defaults.

    Its platform takes the world's compliance, if the world has one and the family has none.

    Raises:
        ParameterError: the values contradict each other.
    """
    content = nested(values, "second")
    if compliance := float(values.get("world.platform.compliance", 0.0)):
        content.setdefault("platform", {}).setdefault("compliance", max(compliance, _COMPLIANCE.low))
    return from_mapping(content, SecondParameters, "second") if content else None


def nested(values: Mapping[str, Value], section: str) -> dict[str, Any]:
    """Return a section's values as nested mappings."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        first, *path = name.split(".")
        if first != section:
            continue
        level = result
        for part in path[:-1]:
            level = level.setdefault(part, {})
        level[path[-1]] = value
    return result


def _axes(gravity: Vector) -> dict[str, float]:
    return {f"gravity_{axis}": value for axis, value in zip("xyz", gravity, strict=True)}
