# SPDX-License-Identifier: Apache-2.0
"""One device with its target, the random values of its contacts, and the path from contact to taxel forces.

**The sheets**, from forces on taxels to the board's readings, with memory. Order: bend of the characteristic,
neighbours, matrix, edge, gains (of the taxel, of the pad in this contact and by warming up), hysteresis, creep, noise
of the signal, dead band; then the zero (offset, warming up, residual creep), noise of the converter, clip,
quantisation, dead taxels.

- Hysteresis: three play operators and a straight branch (Prandtl and Ishlinskii). A loop closes when its force
  returns; unloading reads more than loading.
- Creep: one Kelvin–Voigt element per decade from 0.1 s to 1000 s, exact for any step under constant force. Part of the
  creep shifts the zero until it recovers; a tare includes this shift in its baseline.
- Drift: (1 − e^(−t/τ)) from the first reading on; a tare removes the zero's drift so far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltacharger_core import arrays, machine
from deltacharger_lab.second.equilibrium import Equilibrium, Ridges
from deltacharger_lab.second.parameters import SecondParameters, SheetParameters
from deltacharger_tactile.parameters import SHAPE

_PLAY = np.array([0.25, 0.75, 1.5])  # N, half widths of the play operators
_DECADES = np.array([0.1, 1.0, 10.0, 100.0, 1000.0])  # s, time constants of creep


@dataclass(frozen=True)
class Sheets:
    """Constant properties of both sheets of one rig.

    Attributes:
        gain: (2, 10, 10) of each taxel, including the loss at the edge.
        bend: (2, 1, 1) of each pad's characteristic.
        hysteresis: (2, 1, 1) weight of each play operator.
        creep: (2, 1, 1) per decade.
        band: (2, 10, 10) N, dead band.
        offset: (2, 10, 10) N.
        gain_drift: (2, 1, 1) of a pad when warm.
        offset_drift: (2, 10, 10) N when warm.
        dead: (2, 10, 10) taxels that read NaN.
    """

    gain: arrays.Array
    bend: arrays.Array
    hysteresis: arrays.Array
    creep: arrays.Array
    band: arrays.Array
    offset: arrays.Array
    gain_drift: arrays.Array
    offset_drift: arrays.Array
    dead: arrays.Mask

    @staticmethod
    def draw(parameters: SheetParameters, random: np.random.Generator) -> Sheets:
        """Draw the sheets of one rig."""
        p = parameters
        rim = np.ones((machine.ROWS, machine.COLUMNS), dtype=bool)
        rim[1:-1, 1:-1] = False
        dead = np.zeros(machine.PADS * machine.ROWS * machine.COLUMNS, dtype=bool)
        dead[random.permutation(dead.size)[: p.dead_taxels]] = True
        usual = 0.5 * p.hysteresis * p.full_scale / _PLAY.sum()
        unlike = np.maximum(1.0 + p.sheet_spread * random.standard_normal((2, machine.PADS, 1, 1)), 0.0)
        return Sheets(
            gain=np.clip(1.0 + p.gain_spread * random.standard_normal(SHAPE), 0.3, 2.0) * (1.0 - p.edge_loss * rim),
            bend=p.linearity * random.standard_normal((machine.PADS, 1, 1)),
            hysteresis=np.minimum(usual * unlike[0], 0.3),
            creep=p.creep * unlike[1],
            band=p.dead_band + p.dead_band_spread * np.clip(random.standard_normal(SHAPE), -2.0, 2.0),
            offset=p.fixed_offset * np.clip(random.standard_normal(SHAPE), -3.0, 3.0),
            gain_drift=p.gain_drift * random.standard_normal((machine.PADS, 1, 1)),
            offset_drift=p.offset_drift * random.standard_normal(SHAPE),
            dead=dead.reshape(SHAPE),
        )


class SheetSensor:
    """The sheets of one rig in N independent histories; memory use does not depend on their length.

    Args:
        parameters: of the family.
        sheets: of the rig.
        random: noise.
        count: N.
    """

    def __init__(
        self, parameters: SheetParameters, sheets: Sheets, random: np.random.Generator, count: int = 1
    ) -> None:
        self._parameters, self._sheets, self._random = parameters, sheets, random
        self._play = np.zeros((len(_PLAY), count, *SHAPE))
        self._crept = np.zeros((len(_DECADES), count, *SHAPE))
        self._age = np.zeros((count, 1, 1, 1))
        self._top = parameters.full_scale + parameters.pedestal
        self._quantum = self._top / (2**parameters.bits - 1)

    def pass_time(
        self, step: arrays.Array | float, force: arrays.Array | None = None, repeat: arrays.Array | float = 1.0
    ) -> None:
        """Let time pass under a constant force.

        Args:
            step: s, (N,) or one for all; no time passes if it is not positive.
            force: (N, 2, 10, 10) N on the taxels; None = no contact.
            repeat: (N, 2) gain of each pad in this contact.
        """
        passed = np.maximum(np.asarray(step, dtype=float), 0.0).reshape(-1, 1, 1, 1)
        signal = self._load(force, repeat)
        self._age += passed
        for crept, time in zip(self._crept, _DECADES, strict=True):
            kept = np.exp(-passed / time)
            crept *= kept
            if signal is not None:
                crept += (1.0 - kept) * self._sheets.creep * signal

    def read(
        self, force: arrays.Array | None, repeat: arrays.Array | float = 1.0, count: int = 1, period: float = 0.0
    ) -> arrays.Array:
        """Read both pads `count` times under one force: now, then every `period` (s).

        Drift is constant, taken at the first reading.

        Args:
            force: as in `pass_time`.
            repeat: (N, 2), as in `pass_time`.
            count: number of readings.
            period: s between them.

        Returns:
            (count, N, 2, 10, 10) N raw: with pedestal; NaN where dead.
        """
        driven, p, sheets = self._load(force, repeat), self._parameters, self._sheets
        first = 0.0 if driven is None else sheets.creep * driven
        kept = np.exp(-period * np.arange(count)[:, None] / _DECADES)
        crept = np.tensordot(kept, self._crept - first, axes=1) + len(_DECADES) * first
        reading = p.pedestal + sheets.offset + sheets.offset_drift * self._warm() + p.residual * crept
        if driven is not None:
            played = driven + sheets.hysteresis * (self._play.sum(axis=0) - len(_PLAY) * driven)
            signal = played + (1.0 - p.residual) * crept
            signal *= 1.0 + p.noise_gain * self._random.standard_normal(signal.shape)
            reading += np.where(signal >= sheets.band, signal, 0.0)
        reading += p.noise * self._random.standard_normal(reading.shape)
        self.pass_time((count - 1) * period, force, repeat)
        codes = np.rint(np.clip(reading, 0.0, self._top) / self._quantum)
        return np.where(sheets.dead, np.nan, codes * self._quantum)

    def _warm(self) -> arrays.Array:
        return np.asarray(-np.expm1(-self._age / self._parameters.drift_time))

    def _load(self, force: arrays.Array | None, repeat: arrays.Array | float) -> arrays.Array | None:
        """Return the signal of each taxel (N, 2, 10, 10) N before hysteresis, and move the play operators to it."""
        if force is None:
            self._move(np.zeros(()))
            return None
        p, sheets = self._parameters, self._sheets
        bent = force * (1.0 + 4.0 * sheets.bend * (1.0 - np.minimum(force / p.full_scale, 1.0)))
        around = np.zeros(bent.shape)
        around[..., 1:, :] += bent[..., :-1, :]
        around[..., :-1, :] += bent[..., 1:, :]
        around[..., 1:] += bent[..., :-1]
        around[..., :-1] += bent[..., 1:]
        signal = (1.0 - 4.0 * p.neighbour) * bent + p.neighbour * around
        signal += p.matrix * (signal.mean(axis=-1, keepdims=True) + signal.mean(axis=-2, keepdims=True))
        by_pad = np.asarray(repeat, dtype=float)
        by_pad = by_pad[..., None, None] if by_pad.ndim else by_pad
        signal *= sheets.gain * by_pad * (1.0 + sheets.gain_drift * self._warm())
        self._move(signal)
        return np.asarray(signal)

    def _move(self, signal: arrays.Array) -> None:
        half = _PLAY.reshape(-1, 1, 1, 1, 1)
        np.clip(self._play, signal - half, signal + half, out=self._play)


@dataclass(frozen=True)
class Device:
    """Constant properties.

    Attributes:
        sheets: the sensors.
        ridges: of the target.
        line: share of the offset at which the force acts.
        lean: (2,) rad of the platform against the target without moment, about x and about y.
        magnets: relative strength of the magnets.
    """

    sheets: Sheets
    ridges: Ridges
    line: float
    lean: arrays.Array
    magnets: float

    @staticmethod
    def draw(parameters: SecondParameters, seed: int) -> Device:
        """Draw a device; the same seed gives the same device."""
        random = np.random.default_rng([0x2ED, seed])
        platform = parameters.platform
        return Device(
            sheets=Sheets.draw(parameters.sheet, random),
            ridges=Ridges.draw(parameters.foundation, random),
            line=max(platform.line_share + platform.line_spread * float(random.standard_normal()), 0.0),
            lean=platform.lean_bias * random.standard_normal(2),
            magnets=float(np.clip(1.0 + parameters.docking.magnet_spread * random.standard_normal(), 0.5, 1.5)),
        )


@dataclass(frozen=True)
class Touches:
    """Random values of N contacts.

    Attributes:
        jitter: (N, 3) displacement of the relative pose (x, y, angle), m and rad.
        lean: (N, 2) rad, added to the device's.
        repeat: (N, 2) gain of each pad.
    """

    jitter: arrays.Array
    lean: arrays.Array
    repeat: arrays.Array

    @staticmethod
    def draw(parameters: SecondParameters, random: np.random.Generator, count: int = 1) -> Touches:
        """Draw `count` contacts."""
        landing = parameters.docking
        spread = np.array([landing.position_jitter, landing.position_jitter, landing.angle_jitter])
        return Touches(
            jitter=spread * random.standard_normal((count, 3)),
            lean=parameters.platform.lean_spread * random.standard_normal((count, 2)),
            repeat=np.clip(
                1.0 + parameters.sheet.repeatability * random.standard_normal((count, machine.PADS)), 0.5, 1.5
            ),
        )

    def press(
        self,
        model: Equilibrium,
        device: Device,
        pose: arrays.Array,
        force: arrays.Array | float,
        lean: arrays.Array | float = 0.0,
    ) -> arrays.Array:
        """Return the forces on the taxels (N, 2, 10, 10) N at poses (N, 3) in contact.

        `lean` (2,) rad about x and y is the lean of the world's platform before any moment acts. It has the signs of
        the device's own lean and is added to it; the balance of this model finds the lean under load.
        """
        lean = device.lean + self.lean + lean
        return model.solve(pose, force, device.line * pose[:, :2], lean, device.ridges).taxels
