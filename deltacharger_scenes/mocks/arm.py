# SPDX-License-Identifier: Apache-2.0
"""The mock nodes' arm: three first-order servos on the real geometry, and one elastic wall to press on.

It is deliberately simple: servos are spring and damper with a torque bound, the target is a plane with friction, and
magnets act on friction only, not along z. deltacharger_sim has the realistic model; this one is for tests of nodes, not
of physics.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_core.machine import (
    CURRENT_BOUND,
    DOCK_DISTANCE,
    GRAVITY,
    MAGNET_FORCE,
    SERVO_DAMPING,
    SERVO_INERTIA,
    SERVO_STIFFNESS,
    TORQUE_CONSTANT,
)
from deltacharger_kinematics.scalar import ScalarDelta

Vector = tuple[float, float, float]

_STEP = 0.002  # s; the stiffest motion (contact, all three servos) decays in 9 ms, so explicit steps stay stable


@dataclass(frozen=True)
class MockTarget:
    """The plane that the arm presses on, and the electrodes' pose in it.

    Attributes:
        x: m, y: m, z: m, midpoint of the electrodes in charger_base; contact begins at z.
        angle: rad about +z.
        stiffness: N/m of the contact.
        friction: coefficient.
        grip: N, normal force of the magnets, for friction only.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = DOCK_DISTANCE
    angle: float = 0.0
    stiffness: float = 2e4
    friction: float = 0.3
    grip: float = MAGNET_FORCE


class MockArm:
    """Three servos that follow their goals and a platform that presses on a `MockTarget`.

    Args:
        target: to press on.
        stiffness: N·m/rad of a servo's position loop.
        damping: N·m·s/rad of a servo.

    Attributes:
        angles: rad, measured.
        goals: rad.
        bounds: A, largest current of each servo.
        torque_enabled: per servo; a servo without torque keeps its angle (its gear holds it).
        jammed: nothing moves, as if the magnets did not release.
    """

    def __init__(self, target: MockTarget, stiffness: float = SERVO_STIFFNESS, damping: float = SERVO_DAMPING) -> None:
        self.target = target
        self._delta = ScalarDelta()
        self._stiffness = stiffness
        self._damping = damping
        self.angles = list(self._delta.inverse(0.0, 0.0, 0.0))
        self.goals = list(self.angles)
        self.bounds = [CURRENT_BOUND] * 3
        self.torque_enabled = [False, False, False]
        self.jammed = False
        self._velocity = [0.0, 0.0, 0.0]
        self._anchor: tuple[float, float] | None = None
        self._torque = [0.0, 0.0, 0.0]

    @property
    def position(self) -> Vector:
        """Platform position, m in charger_base."""
        return self._delta.forward(*self.angles)

    @property
    def velocities(self) -> list[float]:
        """rad/s of each servo."""
        return list(self._velocity)

    @property
    def currents(self) -> list[float]:
        """A of each servo, signed: torque over torque constant."""
        return [torque / TORQUE_CONSTANT for torque in self._torque]

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
                self._torque[index] = self._velocity[index] = 0.0
                continue
            bound = self.bounds[index] * TORQUE_CONSTANT
            wanted = self._stiffness * (self.goals[index] - self.angles[index]) - self._damping * self._velocity[index]
            self._torque[index] = min(max(wanted, -bound), bound)
            if not self.jammed:
                self._velocity[index] += dt * (self._torque[index] - hold - press) / SERVO_INERTIA
                self.angles[index] += dt * self._velocity[index]
        if not math.isfinite(self.position[0]):
            self.angles, self._velocity = before, [0.0, 0.0, 0.0]  # the rods' end stop

    def _contact_force(self, position: Vector) -> Vector:
        """Return the platform's force on the target (N); friction is a spring that slides at its cone."""
        x, y, z = position
        depth = z - self.target.z
        if depth <= 0.0:
            self._anchor = None
            return 0.0, 0.0, 0.0
        if self._anchor is None:
            self._anchor = (x, y)
        normal = self.target.stiffness * depth
        fx = self.target.stiffness * (x - self._anchor[0])
        fy = self.target.stiffness * (y - self._anchor[1])
        limit = self.target.friction * (normal + self.target.grip)
        size = math.hypot(fx, fy)
        if size > limit:
            fx, fy = fx * limit / size, fy * limit / size
            self._anchor = (x - fx / self.target.stiffness, y - fy / self.target.stiffness)
        return fx, fy, normal
