# SPDX-License-Identifier: Apache-2.0
"""Estimate of the target along one axis, the offset of this contact, and whether another contact is worth making."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

from deltacharger_core.machine import DOCKING_JITTER

# Chosen in earlier campaigns whose seeds were not kept.
_CONTRADICTION_START = 25.0  # squared innovations that contradict the arm's moves
_CONTRADICTION_EACH = 4.0  # more of them per measured number
GAIN_ERROR = 0.15  # error of a misalignment estimate relative to its size; chosen on seeds 5 and 19

_LEAST = 1e-12  # m²; avoids division by zero
_QUANTILES = tuple(NormalDist().inv_cdf((index + 0.5) / 16) for index in range(16))


@dataclass(frozen=True)
class Offset:
    """Offset (m) of a contact along one axis, normally distributed."""

    mean: float
    stddev: float

    def beyond(self, limit: float) -> float:
        """Return the probability that it exceeds `limit` (m), either way."""
        scale = math.sqrt(2.0) * max(self.stddev, math.sqrt(_LEAST))
        return 0.5 * (math.erfc((limit - self.mean) / scale) + math.erfc((limit + self.mean) / scale))


def expected_gain(now: float, foreseen: float, measured: float, limit: float) -> float:
    """Return the expected decrease of the risk of exceeding `limit` by another contact at the target.

    The mean of its offset is distributed around zero, with the variance that the contact will resolve. A contact worse
    than this one gains nothing, since it can be repeated.

    Args:
        now: risk of this contact.
        foreseen: variance of the other one's offset before it is measured, m².
        measured: variance after it is measured, m².
        limit: m.
    """
    spread, stddev = math.sqrt(max(foreseen - measured, 0.0)), math.sqrt(measured)
    risks = (Offset(spread * each, stddev).beyond(limit) for each in _QUANTILES)
    return sum(max(now - risk, 0.0) for risk in risks) / len(_QUANTILES)


def contradicts(innovations: float, values: int) -> bool:
    """Return whether these values differ by more than their errors allow: they do not follow the arm's moves.

    Args:
        innovations: sum of squares, each divided by its variance.
        values: how many were measured.
    """
    return innovations > _CONTRADICTION_START + _CONTRADICTION_EACH * values


class AxisFilter:
    """Kalman filter of the target's place along one axis, as measured by contacts.

    The axis may have any direction that is fixed in charger_base; docking uses the one across the bars.

    A contact differs from its commanded place by DOCKING_JITTER (standard deviation, m), which encoders do not see.
    The error of an estimate has two parts: one of this contact alone, and one that grows with the offset by
    GAIN_ERROR, so that a first contact 8 mm away has little weight once the platform is close.
    """

    def __init__(self) -> None:
        self._information = 0.0  # 1/m²
        self._innovations = 0.0
        self._looks = 0
        self.target = math.nan
        """Estimated place of the target, m; NaN before the first contact."""
        self.contact = Offset(math.nan, math.nan)
        """Offset of this contact."""

    def update(self, platform: float, offset: float, stddev: float) -> None:
        """Add one contact: platform and offset (m), and the offset's reported standard deviation (m)."""
        own = max(stddev**2, _LEAST) + (GAIN_ERROR * offset) ** 2
        variance, place, weight = DOCKING_JITTER**2 + own, platform + offset, 1.0 / own
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
        """Variance (m²) with which the filter predicts the offset of a contact."""
        return DOCKING_JITTER**2 + 1.0 / self._information + _LEAST

    @property
    def contradicts_itself(self) -> bool:
        """Whether the contacts differ by more than their errors allow."""
        return contradicts(self._innovations, self._looks)

    def gain(self, limit: float) -> float:
        """Return the expected decrease of the risk of exceeding `limit` (m) by another contact."""
        return expected_gain(self.contact.beyond(limit), self._ahead, self.contact.stddev**2, limit)
