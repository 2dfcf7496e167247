# SPDX-License-Identifier: Apache-2.0
"""Where the target is, over several dockings: each one scatters, their filtered mean does not."""

from __future__ import annotations

import math

from deltacharger_docking.clearance import FeltPose
from deltacharger_docking.parameters import DockingParameters


class AlignmentFilter:
    """Kalman filter of a fixed target position (x, y in charger_base) seen by touch.

    One docking lands beside its commanded place by `docking_jitter` (a standard deviation, m), and an estimate's error
    grows with its size by `gain_error`, added in quadrature, so a first look from 8 mm away weighs little once the
    platform stands close.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self._parameters = parameters
        self._mean = [0.0, 0.0]
        self._information = [0.0, 0.0]
        self._innovations = [0.0, 0.0]
        self._looks = 0
        self.landing = math.inf
        """How far (m) the last contact may lie off on its worse axis: |mean| + landing_sigmas σ, at least
        landing_felt_sigmas σ felt: a landing far out is rare, and rarer where the pads see well."""

    def update(self, platform: tuple[float, float], estimate: FeltPose) -> None:
        """Take one estimate made with the platform at (x, y) m of charger_base."""
        readings = (
            (platform[0] + estimate.horizontal, estimate.horizontal, estimate.horizontal_stddev),
            (platform[1] + estimate.vertical, estimate.vertical, estimate.vertical_stddev),
        )
        parameters = self._parameters
        self.landing = 0.0
        self._looks += 1
        for axis, (place, offset, stddev) in enumerate(readings):
            felt = stddev**2 + (parameters.gain_error * offset) ** 2
            variance = parameters.docking_jitter**2 + felt
            land = self._land(axis, place - offset, offset, max(felt, 1e-12))
            self.landing = max(self.landing, land, parameters.landing_felt_sigmas * stddev)
            weight = 1.0 / max(variance, 1e-12)
            if self._information[axis] > 0.0:
                expected = variance + 1.0 / self._information[axis]
                self._innovations[axis] += (place - self._mean[axis]) ** 2 / max(expected, 1e-12)
            self._information[axis] += weight
            self._mean[axis] += (place - self._mean[axis]) * weight / self._information[axis]

    @property
    def contradicts_itself(self) -> bool:
        """Whether the looks differ by more than their errors allow: the pads do not feel where the arm has gone."""
        start, each = self._parameters.contradiction_start, self._parameters.contradiction_each
        return max(self._innovations) > start + each * self._looks

    def _land(self, axis: int, platform: float, offset: float, variance: float) -> float:
        """Return |mean| + landing_sigmas σ (m) of this contact, from what is felt and where earlier ones saw it."""
        information = self._information[axis]
        mean, weight = offset, 1.0 / variance
        if information > 0.0:
            known = 1.0 / (self._parameters.docking_jitter**2 + 1.0 / information + 1e-12)
            mean = (weight * offset + known * (self._mean[axis] - platform)) / (weight + known)
            weight += known
        return abs(mean) + self._parameters.landing_sigmas / math.sqrt(weight)

    @property
    def target(self) -> tuple[float, float]:
        """Filtered (x, y) m of the target in charger_base; NaN before the first estimate."""
        if self._information[0] == 0.0:
            return math.nan, math.nan
        return self._mean[0], self._mean[1]

    def misalignment(self, platform: tuple[float, float]) -> tuple[float, float]:
        """Return the filtered (horizontal, vertical) m for the platform at (x, y) m."""
        x, y = self.target
        return x - platform[0], y - platform[1]
