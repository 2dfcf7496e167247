# SPDX-License-Identifier: Apache-2.0
"""Dimensions of the three limbs as columns (3, 1), broadcast against rows (n,) of points."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry


class LimbArrays:
    """Columns of one geometry; names as in `deltacharger_kinematics.delta` (m, rad).

    Attributes:
        knee: −1 (knee out) or +1 per limb, σ of the formulas.
    """

    def __init__(self, geometry: DeltaGeometry, working_mode: tuple[int, int, int]) -> None:
        self.limbs = tuple(geometry.limb(index) for index in range(LIMB_COUNT))

        def column(name: str) -> Array:
            return np.array([[getattr(limb, name)] for limb in self.limbs])

        self.cosine, self.sine = column("cosine"), column("sine")
        self.difference, self.tangential = column("difference"), column("tangential_offset")
        self.motor_height, self.height_offset = column("motor_height"), column("height_offset")
        self.arm, self.rod = column("arm"), column("rod")
        self.angle_offset = column("angle_offset")
        self.knee = np.array([[float(side)] for side in working_mode])

    def elbows(self, cosine: Array, sine: Array) -> tuple[Array, Array, Array]:
        """Return x, y, z (3, n) of the elbows in delta_motor, minus the platform radius.

        Args:
            cosine: cosine of the true arm angles (3, n).
            sine: sine of the true arm angles (3, n).
        """
        radius = self.difference + self.arm * cosine
        x = radius * self.cosine - self.tangential * self.sine
        y = radius * self.sine + self.tangential * self.cosine
        return x, y, self.arm * sine + self.height_offset
