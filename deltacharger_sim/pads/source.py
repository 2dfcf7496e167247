# SPDX-License-Identifier: Apache-2.0
"""The tactile arrays of a simulated charger: contact and sensor of one rig, sampled by a world."""

from __future__ import annotations

import functools

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import FRAME_RATE
from deltacharger_sim.pads.pad_source import Lean, PadSource, Pose, approach
from deltacharger_sim.pads.sensor import Dockings, Rig, Sensor
from deltacharger_tactile.contact import ContactModel
from deltacharger_tactile.parameters import PadContactParameters, TactileParameters


@functools.lru_cache(maxsize=8)
def _model(parameters: PadContactParameters) -> ContactModel:
    """Return the model of these dimensions, shared because its matrices cost more than a docking."""
    return ContactModel(parameters)


class ContactSource(PadSource[Dockings]):
    """Both pads of one rig in the first contact physics.

    A frame's noise correlates with the last one by the time between them, so unneeded frames may be skipped.

    Args:
        parameters: family of rigs; None = the defaults.
        rig_seed: of the device (gains, offsets, dead taxels, ridges).
        seed: of the run (jitter, tilt, hysteresis, offsets, noise).
    """

    def __init__(self, parameters: TactileParameters | None = None, rig_seed: int = 0, seed: int = 0) -> None:
        super().__init__(np.random.default_rng([0x50C, rig_seed, seed]))
        self.parameters = parameters or TactileParameters()
        self.rig = Rig.draw(self.parameters, rig_seed)
        self._sensor = Sensor(self.parameters.sensor, self.rig, self._random)
        self._model = _model(self.parameters.contact)  # now, as emulators must answer in time at the first touch
        self._began: float | None = None  # s, time of the first frame of this contact

    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, lean: Lean | None = None
    ) -> Array:
        """Return frames (count, 2, 10, 10) N raw; arguments as in `PadSource.frames`."""
        pressed = self._press(pose, force, lean)
        times = time - period * np.arange(count - 1, -1, -1)
        if pressed is not None and self._began is None:
            self._began = float(times[0])
        first = 1.0 / FRAME_RATE if self._last is None else float(times[0]) - self._last
        self._last = time
        in_contact = times - (times[0] if self._began is None else self._began)
        return self._sensor.course(pressed, self._contact, in_contact, (first, *[period] * (count - 1)))

    def _draw(self) -> Dockings:
        return Dockings.draw(self.parameters, self._random)

    def _end_contact(self) -> None:
        super()._end_contact()
        self._began = None

    def _solve(self, contact: Dockings, pose: Array, force: float, lean: Lean | None) -> Array:
        tilt = contact.tilts(self.parameters, self.rig, pose)
        if lean is not None:
            tilt = tilt + approach(lean.residual)
        return self._model.solve(pose, force, tilt, self.rig.waviness).taxels
