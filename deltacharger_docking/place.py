# SPDX-License-Identifier: Apache-2.0
"""Where the target is along one axis, how far this contact lies off, and whether another one would pay."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

from deltacharger_docking.parameters import DockingParameters

_LEAST = 1e-12  # m²; below it a variance would divide by nothing
_QUANTILES = tuple(NormalDist().inv_cdf((index + 0.5) / 16) for index in range(16))


@dataclass(frozen=True)
class Offset:
    """How far (m) a contact lies off along one axis, normally distributed."""

    mean: float
    stddev: float

    def beyond(self, limit: float) -> float:
        """Return the probability that it lies farther off than `limit` (m), either way."""
        scale = math.sqrt(2.0) * max(self.stddev, math.sqrt(_LEAST))
        return 0.5 * (math.erfc((limit - self.mean) / scale) + math.erfc((limit + self.mean) / scale))


def expected_gain(now: float, foreseen: float, told: float, limit: float) -> float:
    """Return by how much another contact, made at the target, is expected to lower the risk to lie beyond `limit`.

    Its mean will lie around zero, by what is foreseen less what it will tell; where it turns out worse than this one it
    has gained nothing, for it can be made again.

    Args:
        now: risk of this contact.
        foreseen: variance of the other one's offset before it is felt, m².
        told: and after, m².
        limit: m.
    """
    spread, stddev = math.sqrt(max(foreseen - told, 0.0)), math.sqrt(told)
    risks = (Offset(spread * each, stddev).beyond(limit) for each in _QUANTILES)
    return sum(max(now - risk, 0.0) for risk in risks) / len(_QUANTILES)


def contradicts(parameters: DockingParameters, innovations: float, values: int) -> bool:
    """Return whether so many values differ by more than their errors allow: the pads do not feel where the arm went.

    Args:
        parameters: docking's.
        innovations: sum of squares, each over its variance.
        values: how many were felt.
    """
    return innovations > parameters.contradiction_start + parameters.contradiction_each * values


class AxisFilter:
    """Kalman filter of the target's place along one axis, as contacts feel it.

    The axis may be any that stays as it is in charger_base; docking takes the one across the bars.

    A contact lies beside its commanded place by `docking_jitter` (standard deviation, m), which encoders do not see.
    The error of an estimate has two parts: one of this contact alone, and one that grows with the offset by
    `gain_error`, so that a first look from 8 mm away weighs little once the platform stands close.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self._parameters = parameters
        self._information = 0.0  # 1/m²
        self._innovations = 0.0
        self._looks = 0
        self.target = math.nan
        """Where the target is, m; NaN before the first look."""
        self.contact = Offset(math.nan, math.nan)
        """How far this contact lies off."""

    def update(self, platform: float, offset: float, stddev: float) -> None:
        """Take what one contact felt: platform and offset (m), and the standard deviation (m) that it tells."""
        parameters = self._parameters
        own = max(stddev**2, _LEAST) + (parameters.gain_error * offset) ** 2
        variance, place, weight = parameters.docking_jitter**2 + own, platform + offset, 1.0 / own
        mean = offset
        self._looks += 1
        if self._information > 0.0:
            ahead = 1.0 / self._ahead
            mean = (weight * offset + ahead * (self.target - platform)) / (weight + ahead)
            weight += ahead
            self._innovations += (place - self.target) ** 2 / (variance + 1.0 / self._information)
        else:
            self.target = place
        self.contact = Offset(mean, 1.0 / math.sqrt(weight))
        self._information += 1.0 / variance
        self.target += (place - self.target) / (variance * self._information)

    @property
    def _ahead(self) -> float:
        """Variance (m²) with which the filter foresees the offset of a contact."""
        return self._parameters.docking_jitter**2 + 1.0 / self._information + _LEAST

    @property
    def contradicts_itself(self) -> bool:
        """Whether the looks differ by more than their errors allow."""
        return contradicts(self._parameters, self._innovations, self._looks)

    def gain(self, limit: float) -> float:
        """Return by how much another contact is expected to lower the risk to lie beyond `limit` (m)."""
        return expected_gain(self.contact.beyond(limit), self._ahead, self.contact.stddev**2, limit)
