# SPDX-License-Identifier: Apache-2.0
"""The arm's dimensions as parameters of every node that needs them, and those of kinematics_node."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_core.machine import GRAVITY, TORQUE_CONSTANT
from deltacharger_core.parameters import Bounded, number, numbers, words
from deltacharger_kinematics.geometry import DeltaGeometry

_USUAL = DeltaGeometry()


@dataclass(frozen=True)
class GeometryFileParameters(Bounded):
    """Where the arm's dimensions stand."""

    geometry_file: str = words("", "YAML file that alone decides the arm's geometry; empty = the single parameters")


@dataclass(frozen=True)
class GeometryParameters(Bounded):
    """The arm's dimensions; a node takes a machine's, where `DeltaGeometry` itself takes any."""

    base_radius: float = number(_USUAL.base_radius, 0.001, 1.0, "m", "motor axis from the centre of the setup ring")
    arm: float = number(_USUAL.arm, 0.001, 1.0, "m", "driven link, motor axis to elbow")
    rod: float = number(_USUAL.rod, 0.001, 1.0, "m", "passive link, elbow to platform joint")
    platform_radius: float = number(
        _USUAL.platform_radius, 0.001, 1.0, "m", "platform joint from the centre of the platform"
    )
    z_offset: float = number(_USUAL.z_offset, -1.0, 1.0, "m", "motor plane to the plane z = 0 of charger_base")
    joint_min: float = number(_USUAL.joint_min, -math.pi, math.pi, "rad", "smallest arm angle")
    joint_max: float = number(_USUAL.joint_max, -math.pi, math.pi, "rad", "largest arm angle")
    workspace_min: tuple[float, float, float] = numbers(
        _USUAL.workspace_min, -1.0, 1.0, "m", "lower corner of the workspace in charger_base, x, y, z"
    )
    workspace_max: tuple[float, float, float] = numbers(
        _USUAL.workspace_max, -1.0, 1.0, "m", "upper corner of the workspace in charger_base, x, y, z"
    )
    swing_max: float = number(
        _USUAL.swing_max, 0.01, math.pi / 2, "rad", "largest angle between a rod and the plane its arm turns in"
    )
    platform_mass: float = number(
        _USUAL.platform_mass, 0.0, 10.0, "kg", "end effector with electrodes, magnets and pads"
    )
    rod_mass: float = number(_USUAL.rod_mass, 0.0, 10.0, "kg", "one rod pair")


@dataclass(frozen=True)
class KinematicsNodeParameters(Bounded):
    """What the force on the end effector is computed with."""

    gravity: tuple[float, float, float] = numbers(
        GRAVITY, -20.0, 20.0, "m/s²", "gravity in charger_base ({unit}), +z toward the target, +y up"
    )
    torque_constant: float = number(TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current of a servo")
