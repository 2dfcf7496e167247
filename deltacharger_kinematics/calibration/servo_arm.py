# SPDX-License-Identifier: Apache-2.0
"""Interface to an arm whose servos are measured, and its readings at rest.

The same procedure runs over ROS and in virtual time; each provides a `ServoArm`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import GRAVITY, TORQUE_CONSTANT
from deltacharger_kinematics.calibration.data import TICK
from deltacharger_kinematics.geometry import DeltaGeometry, Vector

WEIGHT_TOLERANCE = 0.02
"""Default relative standard deviation of the weight of platform and rods."""


class ServoTrouble(RuntimeError):
    """The servos cannot be measured, or the result is not credible. The message states the reason and the remedy."""


@dataclass(frozen=True)
class ServoTask:
    """Task of a measurement: known properties of the arm, duration, seed.

    Attributes:
        geometry: dimensions and masses.
        gravity: in charger_base, m/s².
        torque_constant: N·m/A by which servo_node converts torque bounds to currents.
        weight_tolerance: relative standard deviation of the weight of platform and rods.
        seconds: duration of the measurement.
        seed: seed of the order of the poses.
    """

    geometry: DeltaGeometry = field(default_factory=DeltaGeometry)
    gravity: Vector = GRAVITY
    torque_constant: float = TORQUE_CONSTANT
    weight_tolerance: float = WEIGHT_TOLERANCE
    seconds: float = 150.0
    seed: int = 0


@dataclass(frozen=True)
class ArmReadings:
    """Readings over some time, one per row: angles (n, 3) rad and signed currents (n, 3) A, as in servo_state."""

    angles: Array
    currents: Array


class ServoArm(Protocol):
    """An arm with its torque on and free to move."""

    def clock(self) -> float:
        """Return the time, s, from an arbitrary zero."""

    def goals(self) -> Vector:
        """Return the commanded angles, rad."""

    def follow(self, line: Sequence[tuple[float, Vector]], bound: Vector) -> None:
        """Move the goals linearly from point to point (s from now, rad), torque bounded (N·m); return at the end."""

    def read(self, seconds: float) -> ArmReadings:
        """Return the servo readings of the next `seconds`."""


@dataclass(frozen=True)
class StaticReading:
    """The arm at rest.

    Attributes:
        goals: commanded angles, rad, whole ticks.
        angles: encoder angles, rad.
        currents: means, A.
        current_errors: their standard errors, A.
        directions: last direction of rotation of each servo, +1 or −1, which gives the sign of friction; 0 = unknown.
    """

    goals: Vector
    angles: Vector
    currents: Vector
    current_errors: Vector
    directions: tuple[int, int, int]


def whole_ticks(angles: Sequence[float]) -> Vector:
    """Return angles (rad) rounded to whole encoder ticks."""
    first, second, third = (round(angle / TICK) * TICK for angle in angles)
    return first, second, third


def at_rest(goals: Vector, readings: ArmReadings, directions: tuple[int, int, int]) -> StaticReading:
    """Average readings at rest."""
    count = len(readings.currents)
    spread = np.std(readings.currents, axis=0, ddof=1)
    # Noise dithers the register's steps of 3.36 mA; a reading without noise is no more precise than the steps.
    errors = np.maximum(spread, 2e-3) / math.sqrt(count)
    return StaticReading(
        goals,
        _vector(np.mean(readings.angles, axis=0)),
        _vector(np.mean(readings.currents, axis=0)),
        _vector(errors),
        directions,
    )


def _vector(row: Array) -> Vector:
    return float(row[0]), float(row[1]), float(row[2])
