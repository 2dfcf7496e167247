# SPDX-License-Identifier: Apache-2.0
"""The tactile arrays of a simulated charger: contact and sensor of one rig, sampled by a world."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import FRAME_RATE
from deltacharger_tactile.contact import ContactModel
from deltacharger_tactile.parameters import TactileParameters
from deltacharger_tactile.sensor import Dockings, Rig, Sensor


class ContactSource:
    """Both pads of one rig, as a world that knows pose and force sees them.

    One docking is one contact: `begin_docking` at its first touch, then `sample` with the relative pose (to which
    the world has added the returned jitter) until `sample` is called with None. Not safe for threads: the world's
    lock guards it.

    Args:
        parameters: family of rigs; None = defaults.
        rig_seed: which device (gains, offsets, dead taxels, ridges).
        seed: course of the run (jitter, tilt, noise).
    """

    def __init__(self, parameters: TactileParameters | None = None, rig_seed: int = 0, seed: int = 0) -> None:
        self.parameters = parameters or TactileParameters()
        self.rig = Rig.draw(self.parameters, rig_seed)
        self._random = np.random.default_rng([0x50C, rig_seed, seed])
        self._model = ContactModel(self.parameters.contact)
        self._sensor = Sensor(self.parameters.sensor, self.rig, self._random)
        self._docking: Dockings | None = None
        self._began: float | None = None
        self._last: float | None = None

    def begin_docking(self) -> tuple[float, float, float]:
        """Start a new contact: draw its jitter, tilt, hysteresis and offsets.

        Returns:
            Displacement (x m, y m, angle rad) to add to the relative pose until contact ends.
        """
        self._docking = Dockings.draw(self.parameters, self._random)
        self._began = None
        x, y, angle = self._docking.jitter[0]
        return float(x), float(y), float(angle)

    def sample(self, time: float, pose: tuple[float, float, float] | None, force: float) -> tuple[Array, Array]:
        """Read both pads.

        Args:
            time: s, rising.
            pose: (x m, y m, angle rad) of the target in end_effector, jitter included; None = no contact.
            force: total contact force, N.

        Returns:
            left, right: (10, 10) N raw (before tare; NaN = dead); row 0 at +y, column 0 at +x.
        """
        step = 1.0 / FRAME_RATE if self._last is None else time - self._last
        self._last = time
        if pose is None or not force > 0.0:
            if pose is None:
                self._docking, self._began = None, None
            raw = self._sensor.read(None, self._docking, 0.0, step)
            return raw[0, 0], raw[0, 1]
        if self._docking is None:
            self._docking = Dockings.draw(self.parameters, self._random)
        if self._began is None:
            self._began = time
        poses = np.array([pose])
        tilt = self._docking.tilts(self.parameters, self.rig, poses)
        contact = self._model.solve(poses, force, tilt, self.rig.waviness)
        raw = self._sensor.read(contact.taxels, self._docking, time - self._began, step)
        return raw[0, 0], raw[0, 1]
