# SPDX-License-Identifier: Apache-2.0
"""What gives way around the arm: the cable at the platform, and the two robots on their wheels.

Both use radial return, as the gears' friction does: a spring whose force is cut back to what its friction holds.
"""

from __future__ import annotations

import math

from deltacharger_core.machine import GRAVITY_STRENGTH
from deltacharger_kinematics.geometry import Vector
from deltacharger_sim.parameters import CableParameters, StandParameters

_SETTLES = 0.002  # m of the platform over which a cable's friction builds up (assumed)
_ROLLING = 0.012  # rolling resistance over weight of rubber wheels on a hard floor: 0.008 to 0.015
_TYRES = 0.1  # damping ratio of a braked robot on its tyres (assumed)
_REST = 1e-10  # m in a step, below which rest is tried


class Cable:
    """A cable that pulls the platform back to where it started, and drags.

    Args:
        parameters: of the cable.
        start: of the platform, m, charger_base.
    """

    def __init__(self, parameters: CableParameters, start: Vector) -> None:
        self._stiffness, self._drag, self._start = parameters.stiffness, parameters.drag, start
        self._bristle = self._drag / _SETTLES  # N/m
        self._force: Vector = (0.0, 0.0, 0.0)  # N of its friction
        self._found = self._force

    def forces(self, position: Vector, dx: float, dy: float, dz: float) -> tuple[Vector, float]:
        """Return the force (N) on a platform that moves from `position` by (dx, dy, dz) m, and its stiffness (N/m)."""
        bristle, k = self._bristle, self._stiffness
        fx, fy, fz = self._force
        rx, ry, rz = fx - bristle * dx, fy - bristle * dy, fz - bristle * dz
        size, stiff = math.sqrt(rx * rx + ry * ry + rz * rz), bristle
        if size > self._drag:
            share = self._drag / size
            rx, ry, rz, stiff = share * rx, share * ry, share * rz, share * bristle
        self._found = rx, ry, rz
        (x, y, z), (x0, y0, z0) = position, self._start
        return (rx - k * (x + dx - x0), ry - k * (y + dy - y0), rz - k * (z + dz - z0)), k + stiff

    def keep(self) -> None:
        """End the step with the last forces."""
        self._force = self._found


class Stand:
    """How far both robots together yield: their reduced mass on tyres, with play, on brakes that may slip.

    Along z they move and roll; sideways only the tyres yield, at once.

    Attributes:
        move: displacement of the target in this step along z, m.
    """

    def __init__(self, parameters: StandParameters) -> None:
        self._stiffness, self._mass, self._play = parameters.stiffness, parameters.mass, parameters.play
        self._rolling = _ROLLING * parameters.mass * GRAVITY_STRENGTH
        self._damping = 2.0 * _TYRES * math.sqrt(parameters.stiffness * parameters.mass)
        self.set_brakes(parameters.brakes)
        self._place = self._speed = self._stretch = self._roll = self.move = 0.0
        self._dt = 1.0

    def set_brakes(self, force: float) -> None:
        """Let the brakes slip from this force on, N."""
        self._brakes = force
        self._farthest = self._play + force / self._stiffness  # m of the body from its braked wheels

    def begin(self, dt: float) -> float:
        """Begin a step of `dt` s and return its first guess of `move`."""
        way = self._speed * dt
        self._dt, self.move = dt, way if not -_REST < way < _REST else 0.0
        return self.move

    def forces(self, push: float) -> tuple[float, float]:
        """Return the imbalance (N) at `move` under a push (N) along +z, and its tangent (N/m)."""
        dt, move, k = self._dt, self.move, self._stiffness
        rate = self._mass / (dt * dt)
        stretch, tangent = self._stretch + move, rate
        beyond = stretch - min(max(stretch, -self._play), self._play)
        held, rolls = k * beyond, self._roll + k * move
        if held > self._brakes or held < -self._brakes:
            held = math.copysign(self._brakes, held)
        elif beyond:
            held, tangent = held + self._damping / dt * move, tangent + k + self._damping / dt
        if rolls > self._rolling or rolls < -self._rolling:
            rolls = math.copysign(self._rolling, rolls)
        else:
            tangent += k
        return push + rate * (self._speed * dt - move) - held - rolls, tangent

    def keep(self, dt: float) -> bool:
        """End a step of `dt` s; return whether nothing moved."""
        still = self._speed == self.move == 0.0
        self._speed = self.move / dt
        self._place += self.move
        self._stretch = min(max(self._stretch + self.move, -self._farthest), self._farthest)
        self._roll = min(max(self._roll + self._stiffness * self.move, -self._rolling), self._rolling)
        self.move = 0.0
        return still

    def shift(self, rub: tuple[float, float]) -> Vector:
        """Return the target's displacement (m) along x, y and z; `rub` (N) is its friction on the platform."""
        return -rub[0] / self._stiffness, -rub[1] / self._stiffness, self._place
