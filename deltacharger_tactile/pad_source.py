# SPDX-License-Identifier: Apache-2.0
"""What the tactile arrays of a simulated charger are to a world, whichever contact physics presses them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from deltacharger_core.arrays import Array

Pose = tuple[float, float, float]
Turn = tuple[float, float]  # rad about x and about y


class Lean(NamedTuple):
    """How a platform leans against its target: right-handed turns about x and y of end_effector, platform less target.

    Attributes:
        residual: rad, with all moments in balance: what presses on the taxels.
        free: rad, the same without any moment.
    """

    residual: Turn = (0.0, 0.0)
    free: Turn = (0.0, 0.0)


def approach(turn: Turn) -> Array:
    """Return a turn of a lean as contact models have it (2,), rad: about x brings +y closer, about y brings +x closer.

    A right-handed turn about y takes +x away.
    """
    about_x, about_y = turn
    return np.array([about_x, -about_y])


class DrawnContact(Protocol):
    """What is drawn anew for each contact."""

    @property
    def jitter(self) -> Array:
        """(N, 3) displacement of the relative pose (x, y, angle), m and rad."""


T = TypeVar("T", bound=DrawnContact)


class PadSource(ABC, Generic[T]):
    """Both pads of one rig, as a world that knows pose and force sees them.

    One docking is one contact: `begin_docking` at its first touch, then `sample` with the relative pose (to which
    the world has added the returned jitter) until `sample` is called with None. Not safe for threads: the world's
    lock guards it.

    Args:
        random: course of the run.
    """

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random
        self._contact: T | None = None
        self._last: float | None = None  # s, time of the last frame
        self._pressed: tuple[tuple[Pose, float, Lean | None], Array] | None = None  # by what, and what the taxels bear

    def begin_docking(self) -> Pose:
        """Start a new contact and draw what differs from one to the next.

        Returns:
            Displacement (x m, y m, angle rad) to add to the relative pose until contact ends.
        """
        self._end_contact()
        self._contact = self._draw()
        x, y, angle = self._contact.jitter[0]
        return float(x), float(y), float(angle)

    def sample(self, time: float, pose: Pose | None, force: float, lean: Lean | None = None) -> tuple[Array, Array]:
        """Read both pads once; arguments as those of `frames`.

        Returns:
            left, right: (10, 10) N raw (before tare; NaN = dead); row 0 at +y, column 0 at +x.
        """
        left, right = self.frames(time, pose, force, 1, 0.0, lean)[0]
        return left, right

    @abstractmethod
    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, lean: Lean | None = None
    ) -> Array:
        """Return `count` frames (count, 2, 10, 10) N raw that end at `time`, a `period` (s) apart, all at one pose.

        Args:
            time: of the last frame, s, rising.
            pose: (x m, y m, angle rad) of the target in end_effector, jitter included; None = no contact.
            force: total contact force, N; where the physics has electrode bars, they bear a part of it.
            count: frames.
            period: between them, s.
            lean: of the platform against the target; None = they lie flat.
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
        """Return the forces on the taxels (1, 2, 10, 10) N; None where nothing touches."""
        if pose is None:
            self._end_contact()
            return None
        if not force > 0.0:
            return None
        if self._contact is None:
            self._contact = self._draw()
        if self._pressed is None or self._pressed[0] != (pose, force, lean):  # at rest all frames have one
            self._pressed = (pose, force, lean), self._solve(self._contact, np.array([pose]), force, lean)
        return self._pressed[1]
