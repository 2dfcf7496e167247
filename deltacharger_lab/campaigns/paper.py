# SPDX-License-Identifier: Apache-2.0
"""The paper's classes from the packaged CNN: with our estimate, or in its place, as an estimate without uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_docking.clearance import MisalignmentClasses, MisalignmentEstimate
from deltacharger_tactile.classifiers import packaged
from deltacharger_tactile.classifiers.labels import centres

MODEL = "cnn"


class PaperClasses:
    """Estimates integer degrees 0–5 and steps of 5 mm, with no uncertainty."""

    def __init__(self) -> None:
        self._networks = packaged.load(MODEL)

    def classes(self, left: Any, right: Any) -> MisalignmentClasses:
        """Return the centres of the most probable classes of pads (10, 10) N."""
        frames = np.stack((left, right))[None]
        found = {target: float(centres(target)[net.predict(frames)[0]]) for target, net in self._networks.items()}
        return MisalignmentClasses(found["angle"], found["vertical"], found["horizontal"])

    def predict(self, left: Any, right: Any) -> MisalignmentEstimate:
        """Return the classes' centres as an estimate; pads (10, 10) N below 1 N have no contact."""
        frame, found = np.stack((left, right)), self.classes(left, right)
        return MisalignmentEstimate(
            angle=found.angle,
            angle_stddev=0.0,
            vertical=found.vertical,
            vertical_stddev=0.0,
            horizontal=found.horizontal,
            horizontal_stddev=0.0,
            contact=bool(np.nanmax(frame) >= CONTACT_FORCE),
        )
