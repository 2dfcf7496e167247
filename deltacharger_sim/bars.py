# SPDX-License-Identifier: Apache-2.0
"""Forces on the charger's two electrodes."""

from __future__ import annotations

from typing import NamedTuple


class Bars(NamedTuple):
    """Forces on both electrodes.

    Attributes:
        upper: normal force on the electrode at +y, N.
        lower: on the electrode at −y, N.
        upper_pressed: share of the upper overlap's length that presses, 0 to 1.
        lower_pressed: of the lower overlap's length.
    """

    upper: float
    lower: float
    upper_pressed: float = 1.0
    lower_pressed: float = 1.0

    @staticmethod
    def flat(force: float) -> Bars:
        """Return the bars' shares of `force` (N) if nothing leans."""
        return Bars(0.5 * force, 0.5 * force)
