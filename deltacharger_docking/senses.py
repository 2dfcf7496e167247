# SPDX-License-Identifier: Apache-2.0
"""Two senses of one force: the servos' currents, and the pads' sum less the magnets' pull.

Each has errors that stay: friction, torque constant, gains of taxels, magnets. So their difference is learnt, from
contact to contact; what departs from it by more than it usually scatters shows that one of them lies.
"""

from __future__ import annotations

import math

import numpy as np

from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.magnet_pull import MagnetPull
from deltacharger_docking.parameters import DockingParameters

_DIFFERS = 5.0  # N that pads and currents may differ beyond what was learnt and how it scatters
_SIGMAS = 2.0
_CURRENT_ERROR = 5.0  # N, of the force by currents at first: friction under load and the torque constant


class TwoSenses:
    """Compares the force by currents with the pads' at each contact.

    Attributes:
        offset: by which the pads usually read more, N.
        stddev: of it, N.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self._pull, self._repeats = MagnetPull(parameters), parameters.force_repeatability
        relative = parameters.magnet_error, parameters.force_error
        errors = *(each * parameters.magnet_force for each in relative), _CURRENT_ERROR
        self.offset, self.stddev = 0.0, math.hypot(*errors)

    def compare(self, estimate: MisalignmentEstimate, force: float, currents_doubtful: bool) -> str:
        """Add a contact and return what to tell about it; '' if both agree or one is unknown.

        Args:
            estimate: with the pads' forces.
            force: by currents, N.
            currents_doubtful: whether the servos also yield other than their currents explain.
        """
        pads = estimate.left_force + estimate.right_force
        magnets, _, _ = self._pull.at(np.array(estimate.horizontal), estimate.across, estimate.angle)
        pressed = pads - float(magnets)
        apart = pressed - force - self.offset
        scatter = self._repeats * pads
        if not math.isfinite(apart):
            return ""
        if abs(apart) > _DIFFERS + _SIGMAS * math.hypot(self.stddev, scatter):
            liar = "the servos' currents" if currents_doubtful else "the pads, or the magnets,"
            return f"pads say {pressed - self.offset:.0f} N, currents {force:.0f} N: likelier {liar} lie"
        share = self.stddev**2 / (self.stddev**2 + scatter**2)
        self.offset += share * apart
        self.stddev *= math.sqrt(1.0 - share)
        return ""
