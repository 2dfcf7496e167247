# SPDX-License-Identifier: Apache-2.0
"""The paper's estimate in place of ours: the classes of the packaged CNN, taken as certain."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_docking.clearance import FeltPose
from deltacharger_tactile.classifiers import packaged
from deltacharger_tactile.classifiers.labels import centres

MODEL = "cnn"


class PaperClasses:
    """Tells whole degrees 0–5 and steps of 5 mm, without any doubt."""

    def __init__(self) -> None:
        self._networks = packaged.load(MODEL)

    def predict(self, left: Any, right: Any) -> FeltPose:
        """Return the classes' centres as an estimate; pads (10, 10) N that feel less than 1 N have no contact."""
        frame = np.stack((left, right))
        told = {target: float(centres(target)[net.predict(frame[None])[0]]) for target, net in self._networks.items()}
        return FeltPose(
            angle=told["angle"],
            angle_stddev=0.0,
            vertical=told["vertical"],
            vertical_stddev=0.0,
            horizontal=told["horizontal"],
            horizontal_stddev=0.0,
            contact=bool(np.nanmax(frame) >= CONTACT_FORCE),
        )
