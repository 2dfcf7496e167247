# SPDX-License-Identifier: Apache-2.0
"""What a world asks of whatever moves its arm: the light model, or MuJoCo."""

from __future__ import annotations

from typing import Protocol

from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_sim.parameters import WorldParameters


class Motion(Protocol):
    """State of the arm and one step of it; `Mechanics` tells what each attribute is."""

    position: Vector
    velocity: Vector
    angles: Vector
    rates: Vector
    torques: Vector
    slack: Vector
    tilt: tuple[float, float]
    pad_share: float
    contact_force: float
    magnet_force: float
    imbalance: float
    still: bool

    @property
    def gap(self) -> float:
        """Distance between the touched faces (m)."""

    @property
    def voltage(self) -> float:
        """Of the servos' supply (V)."""

    def step(
        self, dt: float, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector, x: float, y: float
    ) -> None:
        """Advance by `dt` s."""


class MakeMotion(Protocol):
    """Makes the motion of a world."""

    def __call__(self, parameters: WorldParameters, geometry: DeltaGeometry, start: Vector) -> Motion:
        """Return the motion of an arm that stands at `start` (m)."""
