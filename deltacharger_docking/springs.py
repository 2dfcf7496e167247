# SPDX-License-Identifier: Apache-2.0
"""The servos' position loop as docking takes it: a spring as stiff as it was told, until the arm has felt it."""

from __future__ import annotations

import math

from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import Vector

_LEAST_LOAD, _LEAST_YIELD = 0.02, 0.003  # A and rad of all servos, root of the sum of squares: two encoder counts
_REMEMBERED = 1.0  # A² of readings after which older ones fade: about two with the electrodes in their band
_UNEXPLAINED = 0.5  # share of the lags that one compliance of all servos may leave: play, and how encoders round
_SOFTEST, _STIFFEST = 1.5, 60.0  # N·m/rad that are believed: what docking was tried with, 2 to 40, and a margin
_FITS = 1.5  # ratio of told and felt stiffness up to which nobody need be told


class Springs:
    """How far the servos yield under load.

    While its goal stands a servo's torque is k (goal − angle) − d ω = Kt I, whatever friction holds besides. So every
    such reading tells the compliance Kt/k, by least squares through zero over what was read lately; play counts as
    compliance. It is kept from docking to docking: the arm stays the same.

    Attributes:
        compliance: how far a servo yields for each ampere, rad/A.
        is_felt: whether it was felt, or only told.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self._told = parameters.servo_stiffness
        self._constant = parameters.torque_constant
        self._damping = parameters.servo_damping
        self._yields = self._squares = 0.0  # rad·A and A²
        self.compliance = self._constant / self._told
        self.is_felt = False

    @property
    def stiffness(self) -> float:
        """Of a servo, N·m/rad."""
        return self._constant / self.compliance

    @property
    def lag(self) -> float:
        """By how much a servo follows its goal late, s."""
        return self._damping / self.stiffness

    @property
    def settle_time(self) -> float:
        """How long the arm needs in free air to come to rest after a step: four time constants of the servo, s."""
        return max(4.0 * self.lag, 0.1)

    @property
    def contradiction(self) -> str:
        """What to say where the servos yield otherwise than told; '' = they do not, or nothing was felt."""
        ratio = self.stiffness / self._told
        if 1.0 / _FITS <= ratio <= _FITS:
            return ""
        return (
            f"; the servos yield as with {self.stiffness:.1f} N·m/rad where servo_stiffness says {self._told:g}: "
            "measure it with `deltacharger calibrate servos`"
        )

    def feel(self, goals: Vector, angles: Vector, rates: Vector, currents: Vector) -> None:
        """Take a reading under standing goals (rad): arm angles (rad) and rates (rad/s), and currents (A).

        One under a light load tells nothing, nor one that no common spring explains with which docking was tried, as of
        servos that are held. One that contradicts what was felt before counts alone: other gains, or an error then.
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
        self.compliance, self.is_felt = self._yields / self._squares, True
