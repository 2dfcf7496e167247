# SPDX-License-Identifier: Apache-2.0
"""Interface of simulated tactile arrays to a world, for any contact physics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from deltacharger_core.arrays import Array

Pose = tuple[float, float, float]
Turn = tuple[float, float]  # rad about x and about y


class Lean(NamedTuple):
    """Lean of the platform relative to its target: right-handed turns about x and y of end_effector.

    Attributes:
        residual: rad, with all moments in balance; affects the taxels.
        free: rad, without any moment.
    """

    residual: Turn = (0.0, 0.0)
    free: Turn = (0.0, 0.0)


def approach(turn: Turn) -> Array:
    """Convert a turn of a lean to the signs of contact models (2,), rad: about x brings +y closer, about y +x.

    A right-handed turn about y moves +x away.
    """
    about_x, about_y = turn
    return np.array([about_x, -about_y])


class DrawnContact(Protocol):
    """Random values of one contact."""

    @property
    def jitter(self) -> Array:
        """(N, 3) displacement of the relative pose (x, y, angle), m and rad."""


T = TypeVar("T", bound=DrawnContact)


class PadSource(ABC, Generic[T]):
    """Both pads of one rig, for a world that knows pose and force.

    One docking is one contact: `begin_docking` at its first touch, then `sample` with the relative pose plus the
    returned jitter, until `sample` with None ends it. Not thread-safe: the world's lock protects it.

    Args:
        random: source of all random values.
    """

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random
        self._contact: T | None = None
        self._last: float | None = None  # s, time of the last frame
        self._pressed: tuple[tuple[Pose, float, Lean | None], Array] | None = None  # arguments and forces on taxels

    def begin_docking(self) -> Pose:
        """Start a new contact with new random values.

        Returns:
            Displacement (x m, y m, angle rad) to add to the relative pose until contact ends.
        """
        self._end_contact()
        self._contact = self._draw()
        x, y, angle = self._contact.jitter[0]
        return float(x), float(y), float(angle)

    def sample(self, time: float, pose: Pose | None, force: float, lean: Lean | None = None) -> tuple[Array, Array]:
        """Read both pads once; arguments as in `frames`.

        Returns:
            left, right: (10, 10) N raw (before tare; NaN = dead); row 0 at +y, column 0 at +x.
        """
        left, right = self.frames(time, pose, force, 1, 0.0, lean)[0]
        return left, right

    @abstractmethod
    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, lean: Lean | None = None
    ) -> Array:
        """Return `count` frames (count, 2, 10, 10) N raw at one pose, `period` (s) apart, the last at `time`.

        Args:
            time: of the last frame, s, increasing.
            pose: (x m, y m, angle rad) of the target in end_effector, including jitter; None = no contact.
            force: total contact force, N; electrode bars carry part of it, if the physics has them.
            count: number of frames.
            period: s between frames.
            lean: of the platform against the target; None = flat.
        """

    @abstractmethod
    def _draw(self) -> T:
        """Draw a new contact."""

    @abstractmethod
    def _solve(self, contact: T, pose: Array, force: float, lean: Lean | None) -> Array:
        """Return the forces on the taxels (1, 2, 10, 10) N at a pose (1, 3)."""

    def _end_contact(self) -> None:
        self._contact = self._pressed = None

    def _press(self, pose: Pose | None, force: float, lean: Lean | None) -> Array | None:
        """Return the forces on the taxels (1, 2, 10, 10) N; None without contact."""
        if pose is None:
            self._end_contact()
            return None
        if not force > 0.0:
            return None
        if self._contact is None:
            self._contact = self._draw()
        if self._pressed is None or self._pressed[0] != (pose, force, lean):  # unchanged at rest
            self._pressed = (pose, force, lean), self._solve(self._contact, np.array([pose]), force, lean)
        return self._pressed[1]
