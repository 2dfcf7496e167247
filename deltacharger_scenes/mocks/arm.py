# SPDX-License-Identifier: Apache-2.0
"""The mock nodes' arm: it follows its goals, up to a plane that it presses on.

It has no mass and no friction: deltacharger_sim has the realistic arm; this one is for tests of nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from deltacharger_core.machine import (
    CURRENT_BOUND,
    DOCK_DISTANCE,
    GRAVITY,
    SERVO_DAMPING,
    SERVO_STIFFNESS,
    TORQUE_CONSTANT,
)
from deltacharger_kinematics.scalar import ScalarDelta

_GIVE = 0.05  # share of a way into the target that the platform goes; the servos' springs take the rest


class MockArm:
    """Three servos, each a spring and a damper between goal and angle, that carry the arm's weight and press.

    Args:
        target_z: m in charger_base, plane in which contact begins; a pressed platform sticks to it.

    Attributes:
        angles: rad, measured.
        velocities: rad/s.
        currents: A, signed: torque over torque constant.
        bounds: A, largest current of each servo.
        torque_enabled: per servo; without torque of all three the arm stays, for its gears hold it.
        jammed: nothing moves, as if the magnets did not release.
    """

    def __init__(self, target_z: float = DOCK_DISTANCE) -> None:
        self._target_z = target_z
        self._delta = ScalarDelta()
        self.angles = list(self._delta.inverse(0.0, 0.0, 0.0))
        self.velocities, self.currents = [0.0] * 3, [0.0] * 3
        self.bounds = [CURRENT_BOUND] * 3
        self.torque_enabled = [False] * 3
        self.jammed = False
        self._touched: tuple[float, float] | None = None

    @property
    def position(self) -> tuple[float, float, float]:
        """Platform position, m in charger_base."""
        return self._delta.forward(*self.angles)

    def follow(self, goals: Sequence[float], duration: float) -> None:
        """Go where these goals (rad) take the arm, for `duration` s."""
        before = list(self.angles)
        if all(self.torque_enabled) and not self.jammed:
            held = self._delta.holding_torque(*self.position, GRAVITY)
            free = [goal - hold / SERVO_STIFFNESS for goal, hold in zip(goals, held, strict=True)]
            ends = self._delta.inverse(*self._stopped(self._delta.forward(*free)))
            left = math.exp(-duration * SERVO_STIFFNESS / SERVO_DAMPING)
            self.angles = [end + left * (angle - end) for angle, end in zip(before, ends, strict=True)]
        for index, powered in enumerate(self.torque_enabled):
            velocity = (self.angles[index] - before[index]) / duration
            torque = SERVO_STIFFNESS * (goals[index] - self.angles[index]) - SERVO_DAMPING * velocity
            bound = self.bounds[index] if powered else 0.0
            self.currents[index] = min(max(torque / TORQUE_CONSTANT, -bound), bound)
            self.velocities[index] = velocity

    def _stopped(self, goal: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the place of a platform that would be at `goal` (m) if the target were not there."""
        x, y, z = goal
        if not z > self._target_z:
            self._touched = None
            return goal
        if self._touched is None:
            self._touched = (x, y)
        first_x, first_y = self._touched
        deep = self._target_z + _GIVE * (z - self._target_z)
        return first_x + _GIVE * (x - first_x), first_y + _GIVE * (y - first_y), deep
