# SPDX-License-Identifier: Apache-2.0
"""How far this arm's platform turns after a leaning target, learnt from one target to the next."""

from __future__ import annotations

import math

from deltacharger_docking.parameters import DockingParameters

_DOUBT = 0.4  # of the share that remains by the parameters: compliance and stiffness differ from robot to robot


class RemainingShare:
    """Share of a yaw that is left in contact, 1/(1 + compliance · stiffness) by the parameters, then as learnt.

    Targets whose yaw was seen teach it: what is left of the yaw is what their contacts felt as a load bias.

    Attributes:
        value: dimensionless.
        stddev: of it.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self.value = 1.0 / (1.0 + parameters.platform_compliance * parameters.pad_yaw_stiffness)
        self.stddev = _DOUBT * self.value

    def learn(self, seen: float, seen_stddev: float, left: float, left_stddev: float) -> None:
        """Take one target: its yaw along the ridges as seen (rad), and what of it was felt to be left (rad)."""
        known = all(map(math.isfinite, (seen, seen_stddev, left, left_stddev)))
        if not known or self.stddev == 0.0 or seen == 0.0:
            return
        # What a wrong yaw and a wrong bias make of the quotient.
        spread = math.hypot(left_stddev, self.value * seen_stddev) / abs(seen)
        weight = self.stddev**2 / (self.stddev**2 + spread**2)
        self.value += weight * (left / seen - self.value)
        self.value = min(max(self.value, 1e-3), 1.0)
        self.stddev *= math.sqrt(1.0 - weight)
