# SPDX-License-Identifier: Apache-2.0
"""Time until a servo's winding reaches its limit: an I²t model with cooling, in addition to its temperature.

The heat h (A²s) above rest follows dh/dt = i² − h/τ; its limit is H. Two constants rest on three statements:
- Several amperes overheat the servo in minutes: at 3 A the limit must be reached in 60–180 s; 120 s is assumed.
- The real charger held 0.5 A for four hours: at 0.5 A the limit must never be reached, so τ · 0.5² < H.
- About 0.8 A can be held for about 40 min.

With τ = 4000 s, H = 3² · τ · (1 − e^(−120/τ)) = 1064 A²s. Then √(H/τ) = 0.516 A is allowed for ever, just above what
was demonstrated; 0.8 A lasts 36 min. Change this calibration only after measurements of a real winding.
"""

from __future__ import annotations

import math

TIME_CONSTANT = 4000.0
"""τ, s."""
HEAT_LIMIT = 9.0 * TIME_CONSTANT * -math.expm1(-120.0 / TIME_CONSTANT)
"""H, A²s: the heat after 120 s at 3 A."""
REST_TEMPERATURE = 25.0  # °C, where the heat is 0
LIMIT_TEMPERATURE = 80.0  # °C, the servo's own temperature limit, where the heat is assumed to be H


def reserve(heat: float, current: float) -> float:
    """Return the time for which `current` may flow until the limit, s; 0 at the limit, inf if never reached.

    h(t) = i²τ + (h − i²τ) e^(−t/τ) = H, solved for t. An unknown current or heat (NaN) gives NaN.

    Args:
        heat: present heat above rest, A²s.
        current: present current, A, of either sign.
    """
    if math.isnan(heat) or math.isnan(current):
        return math.nan
    if heat >= HEAT_LIMIT:
        return 0.0
    final = current * current * TIME_CONSTANT
    if final <= HEAT_LIMIT:
        return math.inf
    return TIME_CONSTANT * math.log((final - heat) / (final - HEAT_LIMIT))


class ThermalModel:
    """The heat of one servo.

    An unknown current counts as the last known one, so that missing data never cool the model.

    Args:
        smoothing: time constant of the current in `reserve`, s; 0 = none. The heat uses the unsmoothed current.
    """

    def __init__(self, smoothing: float = 0.5) -> None:
        self.heat = 0.0
        self._smoothing = smoothing
        self._square = math.nan
        self._mean_square = math.nan

    def start_at(self, temperature: float) -> None:
        """Set the heat from the servo's temperature, °C, so that a restart does not lose it."""
        if math.isnan(temperature):
            return
        share = (temperature - REST_TEMPERATURE) / (LIMIT_TEMPERATURE - REST_TEMPERATURE)
        self.heat = min(max(share, 0.0), 1.0) * HEAT_LIMIT

    def update(self, current: float, elapsed: float) -> None:
        """Apply `current` (A, NaN = unknown) for `elapsed` s.

        Exact for a current that is constant over the step.
        """
        if not math.isnan(current):
            self._square = current * current
        if math.isnan(self._square):
            return
        final = self._square * TIME_CONSTANT
        self.heat = final + (self.heat - final) * math.exp(-elapsed / TIME_CONSTANT)
        if math.isnan(self._mean_square) or self._smoothing <= 0.0:
            self._mean_square = self._square
        else:
            self._mean_square += (self._square - self._mean_square) * -math.expm1(-elapsed / self._smoothing)

    def reserve(self) -> float:
        """Return the time for which the present current may flow until the limit, s; inf if never reached.

        NaN before the first current is known.
        """
        return reserve(self.heat, math.sqrt(self._mean_square))
