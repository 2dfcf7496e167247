# SPDX-License-Identifier: Apache-2.0
"""Docking's model of the servos' position loop: a spring of the configured stiffness until it is estimated."""

from __future__ import annotations

import math

from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import Vector

_LEAST_LOAD, _LEAST_YIELD = 0.02, 0.003  # A and rad of all servos, root of the sum of squares: two encoder counts
_REMEMBERED = 1.0  # A² of readings after which older ones fade: about two readings in the band
_UNEXPLAINED = 0.5  # share of the lags that one compliance of all servos may leave: play and encoder resolution
_SOFTEST, _STIFFEST = 1.5, 60.0  # N·m/rad that are accepted: the tested range, 2 to 40, and a margin
_FITS = 1.5  # ratio of configured and estimated stiffness that is not reported


class Springs:
    """Yield of the servos under load.

    While its goal is fixed a servo's torque is k (goal − angle) − d ω = Kt I, independent of friction. So each such
    reading gives the compliance Kt/k, by least squares through zero over recent readings. Play counts as compliance.
    The estimate is kept between dockings, since the arm is the same.

    Attributes:
        compliance: yield of a servo per ampere, rad/A.
        is_estimated: whether it was estimated, not only configured.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self._configured = parameters.servo_stiffness
        self._constant = parameters.torque_constant
        self._damping = parameters.servo_damping
        self._yields = self._squares = 0.0  # rad·A and A²
        self.compliance = self._constant / self._configured
        self.is_estimated = False

    @property
    def stiffness(self) -> float:
        """Of a servo, N·m/rad."""
        return self._constant / self.compliance

    @property
    def lag(self) -> float:
        """Delay with which a servo follows its goal, s."""
        return self._damping / self.stiffness

    @property
    def settle_time(self) -> float:
        """Time for the arm in free air to come to rest after a step: four time constants of the servo, s."""
        return max(4.0 * self.lag, 0.1)

    @property
    def contradiction(self) -> str:
        """Warning if estimated and configured stiffness differ; '' = they agree, or there is no estimate."""
        ratio = self.stiffness / self._configured
        if 1.0 / _FITS <= ratio <= _FITS:
            return ""
        return (
            f"; the servos yield as with {self.stiffness:.1f} N·m/rad, but servo_stiffness is {self._configured:g}: "
            "measure it with `deltacharger calibrate servos`"
        )

    def add_reading(self, goals: Vector, angles: Vector, rates: Vector, currents: Vector) -> None:
        """Use a reading with fixed goals (rad): arm angles (rad) and rates (rad/s), and currents (A).

        Readings under a light load are ignored, and so are those that no common spring in the tested range explains,
        such as those of blocked servos. A reading that contradicts earlier ones replaces them: gains changed, or the
        earlier were wrong.
        """
        lags = tuple(goal - angle for goal, angle in zip(goals, angles, strict=True))
        braked = self._damping / self._constant
        loads = tuple(current + braked * rate for current, rate in zip(currents, rates, strict=True))
        size, squares = math.hypot(*lags), sum(load * load for load in loads)
        if not (squares >= _LEAST_LOAD * _LEAST_LOAD and size >= _LEAST_YIELD):
            return
        yields = sum(lag * load for lag, load in zip(lags, loads, strict=True))
        here = yields / squares
        left = math.hypot(*(lag - here * load for lag, load in zip(lags, loads, strict=True)))
        if not (_SOFTEST * here <= self._constant <= _STIFFEST * here and left <= _UNEXPLAINED * size):
            return
        if not self.compliance / _FITS <= here <= self.compliance * _FITS:
            self._yields = self._squares = 0.0
        share = min(_REMEMBERED / squares, 1.0)
        kept = min((_REMEMBERED - share * squares) / self._squares, 1.0) if self._squares else 0.0
        self._yields = kept * self._yields + share * yields
        self._squares = kept * self._squares + share * squares
        self.compliance, self.is_estimated = self._yields / self._squares, True
