"""Where the target is, over several dockings: each one scatters, their filtered mean does not."""

from __future__ import annotations

import math

from deltacharger_docking.clearance import Estimate


class AlignmentFilter:
    """Kalman filter of a fixed target position (x, y in charger_base) seen by touch.

    One docking lands beside its commanded place by `jitter`, and an estimate's error grows with its size, so a first
    look from 8 mm away weighs little once the platform stands close.

    Args:
        jitter: standard deviation (m) of one docking.
        gain_error: relative error of an estimate, added in quadrature.
    """

    def __init__(self, jitter: float, gain_error: float) -> None:
        self._jitter = jitter
        self._gain_error = gain_error
        self._mean = [0.0, 0.0]
        self._information = [0.0, 0.0]

    def update(self, platform: tuple[float, float], estimate: Estimate) -> None:
        """Take one estimate made with the platform at (x, y) m of charger_base."""
        readings = (
            (platform[0] + estimate.horizontal, estimate.horizontal, estimate.horizontal_stddev),
            (platform[1] + estimate.vertical, estimate.vertical, estimate.vertical_stddev),
        )
        for axis, (place, offset, stddev) in enumerate(readings):
            variance = self._jitter**2 + stddev**2 + (self._gain_error * offset) ** 2
            weight = 1.0 / max(variance, 1e-12)
            self._information[axis] += weight
            self._mean[axis] += (place - self._mean[axis]) * weight / self._information[axis]

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
