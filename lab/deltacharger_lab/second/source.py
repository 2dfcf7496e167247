# SPDX-License-Identifier: Apache-2.0
"""The tactile arrays of a simulated charger in the second contact physics, sampled by a world."""

from __future__ import annotations

import functools

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_lab.second.device import Device, Touches
from deltacharger_lab.second.equilibrium import Equilibrium
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_lab.second.sheet import SheetSensor
from deltacharger_sim.pads.pad_source import Lean, PadSource, Pose, approach


@functools.lru_cache(maxsize=4)
def _model(parameters: SecondParameters) -> Equilibrium:
    """Return the model of these parameters, shared by dockings."""
    return Equilibrium(parameters)


class SecondSource(PadSource[Touches]):
    """Both pads of one rig in the second contact physics.

    Unneeded frames may be skipped, with limits. Between two frames the pads carry the force of the later one, and none
    before the first frame of a contact. After an unread change of force, creep therefore starts at the earlier frame.
    A force that rises and falls between two frames leaves no hysteresis. No time passes if `time` does not increase.

    Args:
        parameters: family of rigs; None = the defaults.
        rig_seed: of the device (gains, offsets, dead taxels, ridges, line of action, leans).
        seed: of the run (jitter, leans, repeatability, noise).
    """

    def __init__(self, parameters: SecondParameters | None = None, rig_seed: int = 0, seed: int = 0) -> None:
        super().__init__(np.random.default_rng([0x2E0, rig_seed, seed]))
        self.parameters = parameters or SecondParameters()
        self.rig = Device.draw(self.parameters, rig_seed)
        self._sensor = SheetSensor(self.parameters.sheet, self.rig.sheets, self._random)
        self._model = _model(self.parameters)  # now, as emulators must answer in time at the first touch
        self._fresh = True  # no frame of this contact has been read

    def begin_docking(self) -> Pose:
        """Unload the sheets and start a new contact as in `PadSource.begin_docking`."""
        self._sensor.pass_time(0.0)
        self._fresh = True
        return super().begin_docking()

    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, lean: Lean | None = None
    ) -> Array:
        """Return frames (count, 2, 10, 10) N raw; arguments as in `PadSource.frames`."""
        pressed = self._press(pose, force, lean)
        repeat = 1.0 if self._contact is None else self._contact.repeat
        first = time - (count - 1) * period
        passed = 0.0 if self._last is None else first - self._last
        self._last = time if self._last is None else max(time, self._last)
        if pressed is None or self._fresh:
            self._sensor.pass_time(passed)
        else:
            self._sensor.pass_time(passed, pressed, repeat)
        self._fresh = pressed is None
        return np.asarray(self._sensor.read(pressed, repeat, count, period)[:, 0])

    def _draw(self) -> Touches:
        return Touches.draw(self.parameters, self._random)

    def _solve(self, contact: Touches, pose: Array, force: float, lean: Lean | None) -> Array:
        free = 0.0 if lean is None else approach(lean.free)
        return contact.press(self._model, self.rig, pose, force, free)
