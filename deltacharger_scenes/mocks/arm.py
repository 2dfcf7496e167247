# SPDX-License-Identifier: Apache-2.0
"""The mock nodes' arm: three servos on the real geometry, and one elastic plane to press on and stick to.

It is deliberately simple: deltacharger_sim has the realistic arm; this one is for tests of nodes, not of physics. Its
servos have a rotor, because docking measures their damping by a jump.
"""

from __future__ import annotations

import math

from deltacharger_core.machine import (
    CURRENT_BOUND,
    DOCK_DISTANCE,
    GRAVITY,
    SERVO_INERTIA,
    SERVO_STIFFNESS,
    TORQUE_CONSTANT,
)
from deltacharger_kinematics.scalar import ScalarDelta

Vector = tuple[float, float, float]
_DAMPING = 0.3  # N·m·s/rad of a servo, little, so that tests are quick
_CONTACT = 2e4  # N/m of the plane, in every direction
_STEP = 0.002  # s; the stiffest motion (contact, all three servos) decays in 9 ms, so explicit steps stay stable


class MockArm:
    """Three servos that follow their goals, and a platform that presses on a plane.

    Args:
        target_z: m in charger_base, plane in which contact begins.

    Attributes:
        angles: rad, measured.
        velocities: rad/s.
        currents: A, signed: torque over torque constant.
        goals: rad.
        bounds: A, largest current of each servo.
        torque_enabled: per servo; a servo without torque keeps its angle (its gear holds it).
        jammed: nothing moves, as if the magnets did not release.
    """

    def __init__(self, target_z: float = DOCK_DISTANCE) -> None:
        self._target_z = target_z
        self._delta = ScalarDelta()
        self.angles = list(self._delta.inverse(0.0, 0.0, 0.0))
        self.goals = list(self.angles)
        self.velocities, self.currents = [0.0] * 3, [0.0] * 3
        self.bounds = [CURRENT_BOUND] * 3
        self.torque_enabled = [False] * 3
        self.jammed = False
        self._touched: Vector | None = None

    @property
    def position(self) -> Vector:
        """Platform position, m in charger_base."""
        return self._delta.forward(*self.angles)

    def advance(self, duration: float) -> None:
        """Advance by `duration` s."""
        steps = max(1, math.ceil(duration / _STEP))
        for _ in range(steps):
            self._step(duration / steps)

    def _step(self, dt: float) -> None:
        position = self.position
        held = self._delta.holding_torque(*position, GRAVITY)
        pressed = self._delta.torque(*position, self._contact_force(position))
        before = list(self.angles)
        for index, (hold, press) in enumerate(zip(held, pressed, strict=True)):
            if not self.torque_enabled[index]:
                self.currents[index] = self.velocities[index] = 0.0
                continue
            bound = self.bounds[index] * TORQUE_CONSTANT
            wanted = SERVO_STIFFNESS * (self.goals[index] - self.angles[index]) - _DAMPING * self.velocities[index]
            torque = min(max(wanted, -bound), bound)
            self.currents[index] = torque / TORQUE_CONSTANT
            if not self.jammed:
                self.velocities[index] += dt * (torque - hold - press) / SERVO_INERTIA
                self.angles[index] += dt * self.velocities[index]
        if not math.isfinite(self.position[0]):
            self.angles, self.velocities = before, [0.0] * 3  # the rods' end stop

    def _contact_force(self, position: Vector) -> Vector:
        """Return the platform's force on the plane (N); it sticks where it touched."""
        if position[2] <= self._target_z:
            self._touched = None
            return 0.0, 0.0, 0.0
        x, y, _ = self._touched = self._touched or position
        return _CONTACT * (position[0] - x), _CONTACT * (position[1] - y), _CONTACT * (position[2] - self._target_z)
