# SPDX-License-Identifier: Apache-2.0
"""A competitor of the light model: its own implicit step, extrapolated from one step and two halves to second order.

Local extrapolation of backward Euler, 2 y(h/2) − y(h), has order 2 and damps infinitely stiff parts (Hairer and
Wanner, Solving Ordinary Differential Equations II, IV.9). It costs three steps and a linearisation. Forces are from
the second half.
"""

from __future__ import annotations

import copy

from deltacharger_kinematics.geometry import Vector
from deltacharger_sim.mechanics import Mechanics


class ExtrapolatedMechanics(Mechanics):
    """The light model in extrapolated steps."""

    def step(
        self, dt: float, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector, x: float, y: float
    ) -> None:
        """Advance by `dt` s; arguments as in `Motion.step`."""
        whole = copy.copy(self)
        whole.__class__ = Mechanics  # type: ignore[assignment]  # its halves are plain steps
        whole._impact = copy.copy(self._impact)
        whole.step(dt, enabled, reference, limit, x, y)
        peak = 0.0
        for _ in range(2):
            super().step(0.5 * dt, enabled, reference, limit, x, y)
            peak = max(peak, self.peak_force)
        self.peak_force = peak
        if self.still:
            return
        place = _beyond(self.position, whole.position)
        here = self._linkage.linearise(*place)
        if here is not None:
            self.position, self.velocity = place, _beyond(self.velocity, whole.velocity)
            self.angles, self._rows, self._turns = here
            vx, vy, vz = self.velocity
            spin = [gx * vx + gy * vy + gz * vz for gx, gy, gz in self._rows]
            self._spin = self.rates = (spin[0], spin[1], spin[2])


def _beyond(fine: Vector, whole: Vector) -> Vector:
    return 2.0 * fine[0] - whole[0], 2.0 * fine[1] - whole[1], 2.0 * fine[2] - whole[2]
