# SPDX-License-Identifier: Apache-2.0
"""Pull of the magnets by the offset of the target's centre: 60 N at most, half of it at 8 mm."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import MAGNET_FLOOR, MAGNET_WIDTH


class MagnetPull:
    """Pull over offsets along the bars, with its derivatives: F = force · max(floor, 1/(1 + (r/width)²)).

    Args:
        force: in contact without offset, N.
        width: offset that halves it, m.
    """

    def __init__(self, force: float, width: float = MAGNET_WIDTH) -> None:
        self._force, self._width = force, width

    def at(self, x: Array, across: float, angle: float) -> tuple[Array, Array, Array]:
        """Return pull (N), its slope along x (N/m) and by the logarithm of the width (N).

        Args:
            x: of the target's centre in end_effector, m.
            across: its offset across the bars, m.
            angle: of the bars, rad.
        """
        lean = np.tan(angle)
        y = across / np.cos(angle) + x * lean
        square = (x * x + y * y) / self._width**2
        share = 1.0 / (1.0 + square)
        falls = share > MAGNET_FLOOR
        steep = np.where(falls, share * share, 0.0) * (2.0 * self._force)
        pull = self._force * np.maximum(share, MAGNET_FLOOR)
        return pull, -steep * (x + y * lean) / self._width**2, steep * square
