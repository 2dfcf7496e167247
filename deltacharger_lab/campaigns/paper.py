# SPDX-License-Identifier: Apache-2.0
"""The paper's classes, of the packaged CNN: beside our estimate, or taken as certain in place of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_docking.clearance import FeltPose, MisalignmentClasses
from deltacharger_tactile.classifiers import packaged
from deltacharger_tactile.classifiers.labels import centres

MODEL = "cnn"


class PaperClasses:
    """Tells whole degrees 0–5 and steps of 5 mm, without any doubt."""

    def __init__(self) -> None:
        self._networks = packaged.load(MODEL)

    def classes(self, left: Any, right: Any) -> MisalignmentClasses:
        """Return the centres of the most probable classes of pads (10, 10) N."""
        frames = np.stack((left, right))[None]
        told = {target: float(centres(target)[net.predict(frames)[0]]) for target, net in self._networks.items()}
        return MisalignmentClasses(told["angle"], told["vertical"], told["horizontal"])

    def predict(self, left: Any, right: Any) -> FeltPose:
        """Return the classes' centres as an estimate; pads (10, 10) N that feel less than 1 N have no contact."""
        frame, told = np.stack((left, right)), self.classes(left, right)
        return FeltPose(
            angle=told.angle,
            angle_stddev=0.0,
            vertical=told.vertical,
            vertical_stddev=0.0,
            horizontal=told.horizontal,
            horizontal_stddev=0.0,
            contact=bool(np.nanmax(frame) >= CONTACT_FORCE),
        )
