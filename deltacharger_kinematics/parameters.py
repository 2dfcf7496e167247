# SPDX-License-Identifier: Apache-2.0
"""Parameters for the arm's dimensions, used by several nodes, and parameters of kinematics_node."""

from dataclasses import dataclass

from deltacharger_core.machine import GRAVITY, TORQUE_CONSTANT
from deltacharger_core.parameters import Bounded, number, numbers, words


@dataclass(frozen=True)
class GeometryFileParameters(Bounded):
    """Where the arm's dimensions are."""

    geometry_file: str = words("", "YAML file of the arm's dimensions; empty = those of the drawing")


SERVOS_FOLLOW = {"torque_constant": "torque_constant"}
"""Parameters of kinematics_node that a file of measured servos sets, and their keys in the file."""


@dataclass(frozen=True)
class KinematicsNodeParameters(Bounded):
    """Parameters for the force on the end effector."""

    gravity: tuple[float, float, float] = numbers(
        GRAVITY, -20.0, 20.0, "m/s²", "gravity in charger_base ({unit}), +z toward the target, +y up"
    )
    torque_constant: float = number(TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current of a servo")
