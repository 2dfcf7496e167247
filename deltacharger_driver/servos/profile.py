# SPDX-License-Identifier: Apache-2.0
"""The motion profile inside the servo: a velocity trapezoid from the reference to the goal."""

from __future__ import annotations

import math

_STEP = 1e-3  # s, the servo's own control period
_STANDSTILL = 1e-9  # s; a shorter time counts as zero
_ARRIVED = 1e-4  # rad, a fifteenth of an encoder count


def shape(distance: float, velocity: float, acceleration: float) -> int:
    """Return the shape of the velocity over a move from rest: 0 step, 1 rectangle, 2 triangle, 3 trapezoid.

    Args:
        distance: rad.
        velocity: largest, rad/s; 0 = no limit.
        acceleration: largest, rad/s²; 0 = no limit.
    """
    if velocity <= 0.0:
        return 0
    if acceleration <= 0.0:
        return 1
    return 3 if distance * acceleration > velocity**2 else 2


class Profile:
    """The reference that the position loop follows.

    Attributes:
        position: present reference, rad.
        velocity: of the reference, rad/s.
    """

    def __init__(self) -> None:
        self.position = 0.0
        self.velocity = 0.0
        self._time = -math.inf

    def jump(self, position: float, now: float) -> None:
        """Set the reference to `position`, at rest."""
        self.position, self.velocity, self._time = position, 0.0, now

    def advance(self, goal: float, velocity: float, acceleration: float, now: float) -> bool:
        """Move the reference toward `goal` (rad) until `now` (s) and return whether it still moves.

        Args:
            goal: rad.
            velocity: largest, rad/s; 0 = no limit: the reference jumps.
            acceleration: largest, rad/s²; 0 = no limit.
            now: s.
        """
        if velocity <= 0.0:
            self.jump(goal, now)
            return False
        remaining = max(now - self._time, 0.0) if math.isfinite(self._time) else 0.0
        self._time = now
        while remaining > _STANDSTILL and not self._arrived(goal):
            step = min(_STEP, remaining)
            remaining -= step
            self._step(goal, velocity, acceleration, step)
        if self._arrived(goal):
            self.position, self.velocity = goal, 0.0
            return False
        return True

    def _arrived(self, goal: float) -> bool:
        return abs(goal - self.position) < _ARRIVED and abs(self.velocity) < 0.1

    def _step(self, goal: float, velocity: float, acceleration: float, step: float) -> None:
        distance = goal - self.position
        wanted = math.copysign(min(velocity, abs(distance) / step), distance)
        if acceleration > 0.0:
            # Fast enough to stop at the goal with the next steps, v = √(2 a s), and no faster.
            wanted = math.copysign(min(abs(wanted), math.sqrt(2.0 * acceleration * abs(distance))), distance)
            change = acceleration * step
            wanted = min(max(wanted, self.velocity - change), self.velocity + change)
        self.velocity = wanted
        self.position += wanted * step
