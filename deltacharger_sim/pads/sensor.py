# SPDX-License-Identifier: Apache-2.0
"""From force on a taxel to the board's reading: one rig's sensor, stateful for the world, batched for data sets.

Order: hysteresis, creep, gain spread, cross-talk, offsets, noise, clip, quantisation, dead taxels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_core.machine import COLUMNS, PADS, ROWS
from deltacharger_tactile.contact import Waviness
from deltacharger_tactile.parameters import SHAPE, SensorParameters, TactileParameters


@dataclass(frozen=True)
class Rig:
    """Constant properties of one device and its target.

    Attributes:
        gain: (2, 10, 10) relative gain of each taxel.
        offset: (2, 10, 10) N, removed by a tare.
        dead: (2, 10, 10) taxels that read NaN.
        tilt: (2,) rad, constant tilt (about x, about y).
        magnets: relative strength of the magnets.
        waviness: the target's ridges.
    """

    gain: Array
    offset: Array
    dead: Mask
    tilt: Array
    magnets: float
    waviness: Waviness

    @staticmethod
    def draw(parameters: TactileParameters, seed: int) -> Rig:
        """Draw a device; the same seed gives the same device."""
        random = np.random.default_rng([0x7A9, seed])
        sensor, docking = parameters.sensor, parameters.docking
        dead = np.zeros(PADS * ROWS * COLUMNS, dtype=bool)
        dead[random.permutation(dead.size)[: sensor.dead_taxels]] = True
        return Rig(
            gain=np.clip(1.0 + sensor.gain_spread * random.standard_normal(SHAPE), 0.3, 2.0),
            offset=sensor.fixed_offset * np.clip(random.standard_normal(SHAPE), -3.0, 3.0),
            dead=dead.reshape(SHAPE),
            tilt=docking.tilt_bias * random.standard_normal(2),
            magnets=float(np.clip(1.0 + docking.magnet_spread * random.standard_normal(), 0.5, 1.5)),
            waviness=Waviness.draw(parameters.contact, random),
        )


@dataclass(frozen=True)
class Dockings:
    """Random values of N dockings.

    Attributes:
        jitter: (N, 3) displacement of the relative pose (x, y, angle), m and rad.
        tilt: (N, 2) rad, added to the rig's and to what the offset causes.
        tilt: (N, 2) rad, added to the tilts by the rig and by the offset.
        offset: (N, 2, 10, 10) N.
    """

    jitter: Array
    tilt: Array
    hysteresis: Array
    offset: Array

    @staticmethod
    def draw(parameters: TactileParameters, random: np.random.Generator, count: int = 1) -> Dockings:
        """Draw `count` dockings."""
        docking, sensor = parameters.docking, parameters.sensor
        spread = np.array([docking.position_jitter, docking.position_jitter, docking.angle_jitter])
        return Dockings(
            jitter=spread * random.standard_normal((count, 3)),
            tilt=docking.tilt_spread * random.standard_normal((count, 2)),
            hysteresis=np.clip(sensor.hysteresis * random.standard_normal((count, PADS)), -0.5, 0.5),
            offset=sensor.docking_offset * random.standard_normal((count, *SHAPE)),
        )

    def tilts(self, parameters: TactileParameters, rig: Rig, pose: Array) -> Array:
        """Tilt (N, 2) of each docking at its pose (N, 3): off-centre contact tilts the end effector."""
        per = np.array([parameters.docking.tilt_per_y, parameters.docking.tilt_per_x])
        return np.asarray(rig.tilt + per * pose[:, 1::-1] + self.tilt)


class Sensor:
    """The electronics of one rig for N dockings at once: a deterministic part and noise with memory."""

    def __init__(self, parameters: SensorParameters, rig: Rig, random: np.random.Generator, count: int = 1) -> None:
        self._parameters = parameters
        self._rig = rig
        self._random = random
        self._slow = random.standard_normal((count, *SHAPE))
        self._levels = 2**parameters.bits - 1
        self._top = parameters.full_scale + parameters.pedestal
        self._share = (math.sqrt(1.0 - parameters.noise_memory), math.sqrt(parameters.noise_memory))

    def read(self, force: Array | None, docking: Dockings | None, contact_time: Array | float, step: float) -> Array:
        """Read both pads once.

        Args:
            force: (N, 2, 10, 10) N on the taxels; None = no contact.
            docking: hysteresis and offsets of this contact; None = no contact.
            contact_time: s since contact began, (N,) or scalar.
            step: s since the last reading.

        Returns:
            (N, 2, 10, 10) N raw: with pedestal, offsets and noise; NaN where dead.
        """
        signal = self._respond(force, docking, contact_time)
        return self._digitise(signal + self._noise(force, (step,))[0])

    def course(self, force: Array | None, docking: Dockings | None, times: Array, steps: Sequence[float]) -> Array:
        """Read both pads of one docking T times, like T calls of `read` but much faster.

        Args:
            force: (1, 2, 10, 10) N on the taxels, constant; None = no contact.
            docking: as in `read`.
            times: (T,) s since contact began.
            steps: (T,) s since the previous reading.

        Returns:
            (T, 2, 10, 10) N raw.
        """
        signal = self._respond(force, docking, times)
        return self._digitise(signal + self._noise(force, steps)[:, 0])

    def _respond(self, force: Array | None, docking: Dockings | None, contact_time: Array | float) -> Array:
        p = self._parameters
        base = self._rig.offset + p.pedestal
        if docking is not None:
            base = base + docking.offset
        if force is None:
            return base
        creep = 1.0 + p.creep * np.log10(1.0 + np.maximum(contact_time, 0.0) / p.creep_time)
        factor = np.asarray(creep).reshape(-1, 1)
        if docking is not None:
            factor = factor * (1.0 + docking.hysteresis)
        signal = force * factor[:, :, None, None] * self._rig.gain
        # Sums are faster: means of so few numbers take half as long again.
        rows = np.add.reduce(signal, axis=-1, keepdims=True) / COLUMNS
        columns = np.add.reduce(signal, axis=-2, keepdims=True) / ROWS
        return np.asarray(signal + p.cross_talk * (rows + columns) + base)

    def _noise(self, force: Array | None, steps: Sequence[float]) -> Array:
        """Return the noise (T, N, 2, 10, 10) N of T readings."""
        p = self._parameters
        normal = self._random.standard_normal((len(steps), 2, *self._slow.shape))
        unit = self._share[0] * normal[:, 1]
        for step, fresh, now in zip(steps, normal[:, 0], unit, strict=True):
            keep = math.exp(-max(step, 0.0) / p.noise_time)
            self._slow *= keep
            self._slow += math.sqrt(1.0 - keep * keep) * fresh
            now += self._share[1] * self._slow
        return np.asarray(unit * (p.noise if force is None else p.noise + p.noise_gain * np.abs(force)))

    def _digitise(self, signal: Array) -> Array:
        """Quantise a signal (N) in place; NaN where a taxel is dead."""
        quantum = self._top / self._levels
        signal.clip(0.0, self._top, out=signal)
        signal /= quantum
        np.rint(signal, out=signal)
        signal *= quantum
        np.copyto(signal, np.nan, where=self._rig.dead)
        return signal
