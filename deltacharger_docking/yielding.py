# SPDX-License-Identifier: Apache-2.0
"""Share of a target's lean that the platform does not follow, learnt from target to target."""

from __future__ import annotations

import math

from deltacharger_core.machine import PAD_YAW_STIFFNESS
from deltacharger_docking.parameters import DockingParameters

_DOUBT = 0.4  # relative error of the share by the parameters: compliance and stiffness differ between robots


class RemainingShare:
    """Share of a yaw that remains in contact: 1/(1 + compliance · stiffness) by the parameters, then as learnt.

    It learns from targets with a detected yaw: their contacts measure the remaining yaw as a load bias.

    Attributes:
        value: dimensionless.
        stddev: of it.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self.value = 1.0 / (1.0 + parameters.platform_compliance * PAD_YAW_STIFFNESS)
        self.stddev = _DOUBT * self.value

    def learn(self, seen: float, seen_stddev: float, left: float, left_stddev: float) -> None:
        """Add one target: its yaw along the ridges as detected (rad), and the measured rest of it (rad)."""
        known = all(map(math.isfinite, (seen, seen_stddev, left, left_stddev)))
        if not known or self.stddev == 0.0 or seen == 0.0:
            return
        # Error of the quotient by errors of yaw and bias.
        spread = math.hypot(left_stddev, self.value * seen_stddev) / abs(seen)
        weight = self.stddev**2 / (self.stddev**2 + spread**2)
        self.value += weight * (left / seen - self.value)
        self.value = min(max(self.value, 1e-3), 1.0)
        self.stddev *= math.sqrt(1.0 - weight)
