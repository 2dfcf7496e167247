# SPDX-License-Identifier: Apache-2.0
"""The paper's classes from the packaged CNN, as an estimate without uncertainty in place of ours."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_tactile.classifiers import packaged
from deltacharger_tactile.classifiers.labels import centres


class PaperClasses:
    """Estimates integer degrees 0–5 and steps of 5 mm, with no uncertainty."""

    def __init__(self) -> None:
        self._networks = packaged.load("cnn")

    def predict(self, left: Any, right: Any) -> MisalignmentEstimate:
        """Return the centres of the most probable classes; pads (10, 10) N below 1 N have no contact."""
        frame = np.stack((left, right))
        found = {target: float(centres(target)[net.predict(frame[None])[0]]) for target, net in self._networks.items()}
        return MisalignmentEstimate(
            angle=found["angle"],
            angle_stddev=0.0,
            vertical=found["vertical"],
            vertical_stddev=0.0,
            horizontal=found["horizontal"],
            horizontal_stddev=0.0,
            contact=bool(np.nanmax(frame) >= CONTACT_FORCE),
        )
