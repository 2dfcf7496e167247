# SPDX-License-Identifier: Apache-2.0
"""From the values of a campaign's keys to the parameters of world, pads and docking."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from deltacharger_core.machine import DOCK_DISTANCE, GRAVITY, GRAVITY_STRENGTH
from deltacharger_core.parameters import from_mapping
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import Vector
from deltacharger_lab.campaigns.spread import Value
from deltacharger_sim.parameters import WorldParameters
from deltacharger_tactile.parameters import TactileParameters

NOMINAL: Vector = (0.0, 0.0, DOCK_DISTANCE)  # m, charger_base; where a target stands from which its offsets count
AXES = ("x", "y", "z", "roll")


def build_parts(
    values: Mapping[str, Value], approach: str
) -> tuple[WorldParameters, TactileParameters, DockingParameters]:
    """Return the parameters of world, pads and docking that these values of the scene's keys make.

    Raises:
        ParameterError: a part refuses them.
    """
    place = {axis: float(values.get(f"target.{axis}", 0.0)) + float(values.get(f"shift.{axis}", 0.0)) for axis in AXES}
    gravity = _gravity(float(values.get("gravity.tilt", 0.0)), float(values.get("gravity.azimuth", 0.0)))
    content = nested(values, "world")
    content.setdefault("target", {}).update(place, z=NOMINAL[2] + place["z"])
    content.update(_axes(gravity))
    world = from_mapping(content, WorldParameters, "world")
    told = gravity if values.get("gravity.known", False) else GRAVITY
    given: dict[str, Any] = {"servo_stiffness": world.servo.stiffness, "approach": approach, **_axes(told)}
    docking = from_mapping(given | nested(values, "docking"), DockingParameters, "docking")
    pads = nested(values, "tactile")
    pads.setdefault("contact", {}).update(nested(values, "electrode"))
    return world, from_mapping(pads, TactileParameters, "tactile"), docking


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


def _gravity(tilt: float, azimuth: float) -> Vector:
    """Return gravity (m/s², charger_base) of a robot tilted by `tilt` toward `azimuth` (0 = +z, π/2 = +x)."""
    level = GRAVITY_STRENGTH * math.sin(tilt)
    return level * math.sin(azimuth), -GRAVITY_STRENGTH * math.cos(tilt), level * math.cos(azimuth)


def _axes(gravity: Vector) -> dict[str, float]:
    return {f"gravity_{axis}": value for axis, value in zip("xyz", gravity, strict=True)}
