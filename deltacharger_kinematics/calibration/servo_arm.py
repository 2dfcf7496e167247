# SPDX-License-Identifier: Apache-2.0
"""What the measuring of servos asks of an arm, and what it learns at a place of rest.

The same procedure runs over ROS and in virtual time; each gives it a `ServoArm`.
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
"""Relative standard deviation of what platform and rods weigh, where nobody says otherwise."""


class ServoTrouble(RuntimeError):
    """The servos cannot be measured, or what was measured cannot be believed; the message says why and what to do."""


@dataclass(frozen=True)
class ServoTask:
    """What is known of the arm whose servos are measured.

    Attributes:
        geometry: its dimensions and masses.
        gravity: in charger_base, m/s².
        torque_constant: N·m/A that servo_node turns torque bounds into currents with.
        weight_tolerance: relative standard deviation of the weight of platform and rods.
        seconds: how long to measure.
        seed: of the order of the poses.
    """

    geometry: DeltaGeometry = field(default_factory=DeltaGeometry)
    gravity: Vector = GRAVITY
    torque_constant: float = TORQUE_CONSTANT
    weight_tolerance: float = WEIGHT_TOLERANCE
    seconds: float = 150.0
    seed: int = 0


@dataclass(frozen=True)
class ArmReadings:
    """Readings of a while, one row each: angles (n, 3) rad and currents (n, 3) A, signed, as servo_state tells them."""

    angles: Array
    currents: Array


class ServoArm(Protocol):
    """An arm with its torque on whose goals may be led."""

    def clock(self) -> float:
        """Return the time, s from any beginning."""

    def goals(self) -> Vector:
        """Return the commanded angles, rad."""

    def follow(self, line: Sequence[tuple[float, Vector]], bound: Vector) -> None:
        """Lead the goals straight from point to point (s from now, rad), torque bounded (N·m); return at the end."""

    def read(self, seconds: float) -> ArmReadings:
        """Return what the servos tell in the next `seconds`."""


@dataclass(frozen=True)
class StaticReading:
    """The arm at rest.

    Attributes:
        goals: commanded angles, rad, whole ticks.
        angles: as the encoders tell them, rad.
        currents: means, A.
        current_errors: their standard errors, A.
        directions: +1 or −1 where a servo came to rest turning that way, so that its friction is known; 0 = unknown.
    """

    goals: Vector
    angles: Vector
    currents: Vector
    current_errors: Vector
    directions: tuple[int, int, int]


def whole_ticks(angles: Sequence[float]) -> Vector:
    """Return the nearest goals that a servo can hold (rad)."""
    first, second, third = (round(angle / TICK) * TICK for angle in angles)
    return first, second, third


def at_rest(goals: Vector, readings: ArmReadings, directions: tuple[int, int, int]) -> StaticReading:
    """Return the means of readings at rest."""
    count = len(readings.currents)
    spread = np.std(readings.currents, axis=0, ddof=1)
    # The register's own steps of 3.36 mA are dithered by the noise; a quiet one still tells no better than these.
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
