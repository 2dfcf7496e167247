# SPDX-License-Identifier: Apache-2.0
"""What each electrode of the charger bears."""

from __future__ import annotations

from typing import NamedTuple


class Bars(NamedTuple):
    """What each of both electrodes bears.

    Attributes:
        upper: normal force on the one at +y, N.
        lower: the same of the one at −y.
        upper_pressed: share of its overlap's length that presses, 0 to 1.
        lower_pressed: the same of the one at −y.
    """

    upper: float
    lower: float
    upper_pressed: float = 1.0
    lower_pressed: float = 1.0

    @staticmethod
    def flat(force: float) -> Bars:
        """Return what they bear of `force` (N) where nothing leans."""
        return Bars(0.5 * force, 0.5 * force)
