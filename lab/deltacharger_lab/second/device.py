# SPDX-License-Identifier: Apache-2.0
"""One device with its target, the random values of its contacts, and the path from contact to taxel forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import PADS
from deltacharger_lab.second.equilibrium import Equilibrium
from deltacharger_lab.second.foundation import Ridges
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_lab.second.sheet import Sheets


@dataclass(frozen=True)
class Device:
    """Constant properties.

    Attributes:
        sheets: the sensors.
        ridges: of the target.
        line: share of the offset at which the force acts.
        lean: (2,) rad of the platform against the target without moment, about x and about y.
        magnets: relative strength of the magnets.
    """

    sheets: Sheets
    ridges: Ridges
    line: float
    lean: Array
    magnets: float

    @staticmethod
    def draw(parameters: SecondParameters, seed: int) -> Device:
        """Draw a device; the same seed gives the same device."""
        random = np.random.default_rng([0x2ED, seed])
        platform = parameters.platform
        return Device(
            sheets=Sheets.draw(parameters.sheet, random),
            ridges=Ridges.draw(parameters.foundation, random),
            line=max(platform.line_share + platform.line_spread * float(random.standard_normal()), 0.0),
            lean=platform.lean_bias * random.standard_normal(2),
            magnets=float(np.clip(1.0 + parameters.docking.magnet_spread * random.standard_normal(), 0.5, 1.5)),
        )


@dataclass(frozen=True)
class Touches:
    """Random values of N contacts.

    Attributes:
        jitter: (N, 3) displacement of the relative pose (x, y, angle), m and rad.
        lean: (N, 2) rad, added to the device's.
        repeat: (N, 2) gain of each pad.
    """

    jitter: Array
    lean: Array
    repeat: Array

    @staticmethod
    def draw(parameters: SecondParameters, random: np.random.Generator, count: int = 1) -> Touches:
        """Draw `count` contacts."""
        landing = parameters.docking
        spread = np.array([landing.position_jitter, landing.position_jitter, landing.angle_jitter])
        return Touches(
            jitter=spread * random.standard_normal((count, 3)),
            lean=parameters.platform.lean_spread * random.standard_normal((count, 2)),
            repeat=np.clip(1.0 + parameters.sheet.repeatability * random.standard_normal((count, PADS)), 0.5, 1.5),
        )

    def press(
        self, model: Equilibrium, device: Device, pose: Array, force: Array | float, lean: Array | float = 0.0
    ) -> Array:
        """Return the forces on the taxels (N, 2, 10, 10) N at poses (N, 3) in contact.

        `lean` (2,) rad about x and y is the lean of the world's platform before any moment acts. It has the signs of
        the device's own lean and is added to it; the balance of this model finds the lean under load.
        """
        lean = device.lean + self.lean + lean
        return model.solve(pose, force, device.line * pose[:, :2], lean, device.ridges).taxels
