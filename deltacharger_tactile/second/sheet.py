# SPDX-License-Identifier: Apache-2.0
"""From what taxels bear to what the board reads: both sensor sheets of one rig, with their memory.

In this order: bend of the characteristic, neighbours, matrix, edge, gains (of the taxel, of the pad in this contact and
by warming up), hysteresis, creep, noise of the signal, dead band; then the zero (offset, warming up, what creep left),
noise of the converter, clip, quantisation, dead taxels.

- Hysteresis: three play operators beside a straight branch (Prandtl and Ishlinskii). A loop closes where its force
  returns, and reading against force runs counter-clockwise: unloading reads more than loading.
- Creep: one Kelvin–Voigt element for each decade from 0.1 s to 1000 s, exact for any step under a force that is held.
  Part of what has crept shifts the zero until it has recovered; a tare takes that for its baseline.
- Drift: (1 − e^(−t/τ)) from the first reading on; a tare takes away what the zero had drifted until then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_core.machine import COLUMNS, PADS, ROWS
from deltacharger_tactile.parameters import SHAPE
from deltacharger_tactile.second.parameters import SheetParameters

_PLAY = np.array([0.25, 0.75, 1.5])  # N, half widths of the play operators
_DECADES = np.array([0.1, 1.0, 10.0, 100.0, 1000.0])  # s, time constants of creep


@dataclass(frozen=True)
class Sheets:
    """What stays the same on both sheets of one rig.

    Attributes:
        gain: (2, 10, 10) of each taxel, loss at the edge included.
        bend: (2, 1, 1) of each pad's characteristic.
        hysteresis: (2, 1, 1) weight of each play operator.
        creep: (2, 1, 1) per decade.
        band: (2, 10, 10) N below which a taxel tells nothing.
        offset: (2, 10, 10) N.
        gain_drift: (2, 1, 1) of a pad when warm.
        offset_drift: (2, 10, 10) N when warm.
        dead: (2, 10, 10) taxels that read NaN.
    """

    gain: Array
    bend: Array
    hysteresis: Array
    creep: Array
    band: Array
    offset: Array
    gain_drift: Array
    offset_drift: Array
    dead: Mask

    @staticmethod
    def draw(parameters: SheetParameters, random: np.random.Generator) -> Sheets:
        """Draw the sheets of one rig."""
        p = parameters
        rim = np.ones((ROWS, COLUMNS), dtype=bool)
        rim[1:-1, 1:-1] = False
        dead = np.zeros(PADS * ROWS * COLUMNS, dtype=bool)
        dead[random.permutation(dead.size)[: p.dead_taxels]] = True
        usual = 0.5 * p.hysteresis * p.full_scale / _PLAY.sum()
        unlike = np.maximum(1.0 + p.sheet_spread * random.standard_normal((2, PADS, 1, 1)), 0.0)
        return Sheets(
            gain=np.clip(1.0 + p.gain_spread * random.standard_normal(SHAPE), 0.3, 2.0) * (1.0 - p.edge_loss * rim),
            bend=p.linearity * random.standard_normal((PADS, 1, 1)),
            hysteresis=np.minimum(usual * unlike[0], 0.3),
            creep=p.creep * unlike[1],
            band=p.dead_band + p.dead_band_spread * np.clip(random.standard_normal(SHAPE), -2.0, 2.0),
            offset=p.fixed_offset * np.clip(random.standard_normal(SHAPE), -3.0, 3.0),
            gain_drift=p.gain_drift * random.standard_normal((PADS, 1, 1)),
            offset_drift=p.offset_drift * random.standard_normal(SHAPE),
            dead=dead.reshape(SHAPE),
        )


class SheetSensor:
    """The sheets of one rig in N courses of events at once; its memory does not grow with their length.

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

    def pass_time(self, step: Array | float, force: Array | None = None, repeat: Array | float = 1.0) -> None:
        """Let time pass under a constant force.

        Args:
            step: s, (N,) or one for all; no time passes where it is not positive.
            force: (N, 2, 10, 10) N that the taxels bear; None = nothing touches.
            repeat: (N, 2) gain of each pad in this contact.
        """
        passed = np.maximum(np.asarray(step, dtype=float), 0.0).reshape(-1, 1, 1, 1)
        felt = self._load(force, repeat)
        self._age += passed
        for crept, time in zip(self._crept, _DECADES, strict=True):
            kept = np.exp(-passed / time)
            crept *= kept
            if felt is not None:
                crept += (1.0 - kept) * self._sheets.creep * felt

    def read(self, force: Array | None, repeat: Array | float = 1.0, count: int = 1, period: float = 0.0) -> Array:
        """Read both pads `count` times, the first time now, a `period` (s) apart under one force.

        Drift is that at the first of them.

        Args:
            force: as of `pass_time`, like `repeat`.
            repeat: (N, 2).
            count: readings.
            period: s between them.

        Returns:
            (count, N, 2, 10, 10) N raw: pedestal included; NaN where dead.
        """
        felt, p, sheets = self._load(force, repeat), self._parameters, self._sheets
        first = 0.0 if felt is None else sheets.creep * felt
        kept = np.exp(-period * np.arange(count)[:, None] / _DECADES)
        crept = np.tensordot(kept, self._crept - first, axes=1) + len(_DECADES) * first
        told = p.pedestal + sheets.offset + sheets.offset_drift * self._warm() + p.residual * crept
        if felt is not None:
            played = felt + sheets.hysteresis * (self._play.sum(axis=0) - len(_PLAY) * felt)
            signal = played + (1.0 - p.residual) * crept
            signal *= 1.0 + p.noise_gain * self._random.standard_normal(signal.shape)
            told += np.where(signal >= sheets.band, signal, 0.0)
        told += p.noise * self._random.standard_normal(told.shape)
        self.pass_time((count - 1) * period, force, repeat)
        codes = np.rint(np.clip(told, 0.0, self._top) / self._quantum)
        return np.where(sheets.dead, np.nan, codes * self._quantum)

    def _warm(self) -> Array:
        return np.asarray(-np.expm1(-self._age / self._parameters.drift_time))

    def _load(self, force: Array | None, repeat: Array | float) -> Array | None:
        """Return what drives each taxel (N, 2, 10, 10) N, and move the play operators there."""
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
        felt = (1.0 - 4.0 * p.neighbour) * bent + p.neighbour * around
        felt += p.matrix * (felt.mean(axis=-1, keepdims=True) + felt.mean(axis=-2, keepdims=True))
        by_pad = np.asarray(repeat, dtype=float)
        by_pad = by_pad[..., None, None] if by_pad.ndim else by_pad
        felt *= sheets.gain * by_pad * (1.0 + sheets.gain_drift * self._warm())
        self._move(felt)
        return np.asarray(felt)

    def _move(self, felt: Array) -> None:
        half = _PLAY.reshape(-1, 1, 1, 1, 1)
        np.clip(self._play, felt - half, felt + half, out=self._play)
