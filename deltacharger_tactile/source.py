# SPDX-License-Identifier: Apache-2.0
"""The tactile arrays of a simulated charger: contact and sensor of one rig, sampled by a world."""

from __future__ import annotations

import functools

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import FRAME_RATE, PADS
from deltacharger_tactile.contact import ContactModel
from deltacharger_tactile.parameters import PadContactParameters, TactileParameters
from deltacharger_tactile.sensor import Dockings, Rig, Sensor

Pose = tuple[float, float, float]


@functools.lru_cache(maxsize=8)
def _model(parameters: PadContactParameters) -> ContactModel:
    """Return the model of these dimensions; its matrices cost more than a docking, so that dockings share them."""
    return ContactModel(parameters)


class ContactSource:
    """Both pads of one rig, as a world that knows pose and force sees them.

    One docking is one contact: `begin_docking` at its first touch, then `sample` with the relative pose (to which
    the world has added the returned jitter) until `sample` is called with None. Not safe for threads: the world's
    lock guards it. The noise of a frame remembers the last one by the time between them, so that frames which nobody
    reads may be left out.

    Args:
        parameters: family of rigs; None = defaults.
        rig_seed: which device (gains, offsets, dead taxels, ridges).
        seed: course of the run (jitter, tilt, noise).
    """

    def __init__(self, parameters: TactileParameters | None = None, rig_seed: int = 0, seed: int = 0) -> None:
        self.parameters = parameters or TactileParameters()
        self.rig = Rig.draw(self.parameters, rig_seed)
        self._random = np.random.default_rng([0x50C, rig_seed, seed])
        self._sensor = Sensor(self.parameters.sensor, self.rig, self._random)
        self._docking: Dockings | None = None
        self._began: float | None = None
        self._last: float | None = None
        self._pressed: tuple[tuple[Pose, float, float], Array] | None = None  # by what, and what the taxels bear

    def begin_docking(self) -> Pose:
        """Start a new contact: draw its jitter, tilt, hysteresis and offsets.

        Returns:
            Displacement (x m, y m, angle rad) to add to the relative pose until contact ends.
        """
        self._docking = Dockings.draw(self.parameters, self._random)
        self._began = self._pressed = None
        x, y, angle = self._docking.jitter[0]
        return float(x), float(y), float(angle)

    def sample(self, time: float, pose: Pose | None, force: float, share: float = 0.5) -> tuple[Array, Array]:
        """Read both pads once.

        Args:
            time: s, rising.
            pose: (x m, y m, angle rad) of the target in end_effector, jitter included; None = no contact.
            force: total contact force, N.
            share: of the force that the left pad carries.

        Returns:
            left, right: (10, 10) N raw (before tare; NaN = dead); row 0 at +y, column 0 at +x.
        """
        left, right = self.frames(time, pose, force, 1, 0.0, share)[0]
        return left, right

    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, share: float = 0.5
    ) -> Array:
        """Return `count` frames (count, 2, 10, 10) N raw that end at `time`, a `period` (s) apart, all at one pose.

        Args:
            time: of the last frame, s, rising.
            pose: as of `sample`.
            force: total contact force, N.
            count: frames.
            period: between them, s.
            share: of the force that the left pad carries.
        """
        pressed = self._press(pose, force, share)
        times = time - period * np.arange(count - 1, -1, -1)
        if pressed is not None and self._began is None:
            self._began = float(times[0])
        first = 1.0 / FRAME_RATE if self._last is None else float(times[0]) - self._last
        self._last = time
        felt = times - (times[0] if self._began is None else self._began)
        return self._sensor.course(pressed, self._docking, felt, (first, *[period] * (count - 1)))

    def _press(self, pose: Pose | None, force: float, share: float) -> Array | None:
        """Return the forces on the taxels (1, 2, 10, 10) N; None where nothing touches."""
        if pose is None:
            self._docking = self._began = self._pressed = None
            return None
        if not force > 0.0:
            return None
        if self._docking is None:
            self._docking = Dockings.draw(self.parameters, self._random)
        if self._pressed is None or self._pressed[0] != (pose, force, share):  # at rest all frames have one
            self._pressed = (pose, force, share), self._solve(pose, force, share)
        return self._pressed[1]

    def _solve(self, pose: Pose, force: float, share: float) -> Array:
        assert self._docking is not None
        poses = np.array([pose])
        tilt = self._docking.tilts(self.parameters, self.rig, poses)
        model, waviness = _model(self.parameters.contact), self.rig.waviness
        if share == 0.5:
            return model.solve(poses, force, tilt, waviness).taxels
        forces = np.array([2.0 * share * force, 2.0 * (1.0 - share) * force])
        left, right = model.solve(np.repeat(poses, PADS, axis=0), forces, tilt, waviness).taxels
        return np.stack((left[0], right[1]))[None]
