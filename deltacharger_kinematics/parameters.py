# SPDX-License-Identifier: Apache-2.0
"""Parameters for the arm's dimensions, used by several nodes, and parameters of kinematics_node."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_core.machine import GRAVITY, TORQUE_CONSTANT
from deltacharger_core.parameters import Bounded, like, number, numbers, words
from deltacharger_kinematics.geometry import DeltaGeometry


@dataclass(frozen=True)
class GeometryFileParameters(Bounded):
    """Path of the file of the arm's dimensions."""

    geometry_file: str = words("", "YAML file, the only source of the arm's geometry; empty = the single parameters")


@dataclass(frozen=True)
class GeometryParameters(Bounded):
    """The arm's dimensions, with closer bounds than in `DeltaGeometry`."""

    base_radius: float = like(DeltaGeometry, "base_radius", low=0.001, high=1.0)
    arm: float = like(DeltaGeometry, "arm", low=0.001, high=1.0)
    rod: float = like(DeltaGeometry, "rod", low=0.001, high=1.0)
    platform_radius: float = like(DeltaGeometry, "platform_radius", low=0.001, high=1.0)
    z_offset: float = like(DeltaGeometry, "z_offset", low=-1.0, high=1.0)
    joint_min: float = like(DeltaGeometry, "joint_min")
    joint_max: float = like(DeltaGeometry, "joint_max")
    workspace_min: tuple[float, float, float] = like(DeltaGeometry, "workspace_min", low=-1.0, high=1.0)
    workspace_max: tuple[float, float, float] = like(DeltaGeometry, "workspace_max", low=-1.0, high=1.0)
    swing_max: float = like(DeltaGeometry, "swing_max", low=0.01)
    platform_mass: float = like(DeltaGeometry, "platform_mass", high=10.0)
    rod_mass: float = like(DeltaGeometry, "rod_mass", high=10.0)


SERVOS_FOLLOW = {"torque_constant": "torque_constant"}
"""Parameters of kinematics_node that a file of measured servos sets, and their keys in the file."""


@dataclass(frozen=True)
class KinematicsNodeParameters(Bounded):
    """Parameters for the force on the end effector."""

    gravity: tuple[float, float, float] = numbers(
        GRAVITY, -20.0, 20.0, "m/s²", "gravity in charger_base ({unit}), +z toward the target, +y up"
    )
    torque_constant: float = number(TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current of a servo")
