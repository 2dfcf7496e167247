# SPDX-License-Identifier: Apache-2.0
"""The pads of one docking in a campaign: frames are made when somebody asks for them, several at once at one pose."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.machine import FRAME_RATE
from deltacharger_tactile.contact import ContactModel
from deltacharger_tactile.parameters import PadContactParameters, TactileParameters
from deltacharger_tactile.sensor import Dockings, Rig, Sensor

Array = NDArray[np.float64]
Pose = tuple[float, float, float]


@functools.lru_cache(maxsize=8)
def _model(parameters: PadContactParameters) -> ContactModel:
    """Return the model of these dimensions; its matrices cost more than a docking, so that dockings share them."""
    return ContactModel(parameters)


class Pads:
    """What `deltacharger_tactile.source.ContactSource` is, with the same draws, and `frames` besides.

    The noise of a frame remembers the last one by the time between them, so frames that nobody reads may be left out.

    Args:
        parameters: family of rigs.
        rig_seed: which device.
        seed: course of the run (jitter, tilt, noise).
    """

    def __init__(self, parameters: TactileParameters, rig_seed: int, seed: int) -> None:
        self._parameters = parameters
        self._rig = Rig.draw(parameters, rig_seed)
        self._random = np.random.default_rng([0x50C, rig_seed, seed])
        self._sensor = Sensor(parameters.sensor, self._rig, self._random)
        self._docking: Dockings | None = None
        self._began: float | None = None
        self._last: float | None = None

    def begin_docking(self) -> Pose:
        """Draw a new contact and return the displacement (m, m, rad) that lasts until it ends."""
        self._docking = Dockings.draw(self._parameters, self._random)
        self._began = None
        x, y, angle = self._docking.jitter[0]
        return float(x), float(y), float(angle)

    def sample(self, time: float, pose: Pose | None, force: float) -> tuple[Array, Array]:
        """Return one frame, left and right (10, 10) N raw, at `time` (s) for pose (m, m, rad) and force (N)."""
        frame = self.frames(time, pose, force, 1, 0.0)[0]
        return frame[0], frame[1]

    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, share: float = 0.5
    ) -> Array:
        """Return `count` frames (count, 2, 10, 10) N raw that end at `time`, a `period` (s) apart, all at one pose.

        Args:
            time: of the last frame, s, rising.
            pose: (x m, y m, angle rad) of the target in end_effector, jitter included; None = no contact.
            force: total contact force, N.
            count: frames.
            period: between them, s.
            share: of the force that the left pad carries.
        """
        pressed = self._press(pose, force, share)
        first = time - (count - 1) * period
        if pressed is not None and self._began is None:
            self._began = first
        result = []
        for index in range(count):
            now = first + index * period
            step = 1.0 / FRAME_RATE if self._last is None else now - self._last
            self._last = now
            felt = 0.0 if pressed is None or self._began is None else now - self._began
            result.append(self._sensor.read(pressed, self._docking, felt, step)[0])
        return np.stack(result)

    def _press(self, pose: Pose | None, force: float, share: float) -> Array | None:
        """Return the forces on the taxels (1, 2, 10, 10) N; None where nothing touches."""
        if pose is None:
            self._docking, self._began = None, None
            return None
        if not force > 0.0:
            return None
        if self._docking is None:
            self._docking = Dockings.draw(self._parameters, self._random)
        poses = np.array([pose])
        tilt = self._docking.tilts(self._parameters, self._rig, poses)
        model, waviness = _model(self._parameters.contact), self._rig.waviness
        if share == 0.5:
            return model.solve(poses, force, tilt, waviness).taxels
        left, right = (model.solve(poses, 2.0 * each * force, tilt, waviness).taxels for each in (share, 1.0 - share))
        return np.stack((left[:, 0], right[:, 1]), axis=1)
