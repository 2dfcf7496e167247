# SPDX-License-Identifier: Apache-2.0
"""The emulated board's tactile arrays: sampling, the tare, dead taxels."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt

from deltacharger_core.machine import COLUMNS, CONTACT_FORCE, ROWS
from deltacharger_driver.board.protocol import AckError

TARE_SAMPLES = 8
TARE_PERIOD = 0.004  # s between the samples of a tare: 28 ms in all

Forces = npt.NDArray[np.float64]


class PadPlant(Protocol):
    """The physics behind the arrays, on its own clock."""

    def read_taxels(self) -> tuple[npt.NDArray[np.floating], npt.NDArray[np.floating]]:
        """Return left and right, (10, 10) N each, raw: offset and noise included, before the tare; NaN = dead."""


class EmulatedPads:
    """Both arrays on the board's side.

    Attributes:
        tared: whether a tare is subtracted.

    Args:
        plant: the physics.
    """

    def __init__(self, plant: PadPlant) -> None:
        self._plant = plant
        self._dead = np.zeros((2, ROWS, COLUMNS), bool)
        self.reset()

    def reset(self) -> None:
        """Boot: discard the tare."""
        self.tared = False
        self._baseline: Forces = np.full((2, ROWS, COLUMNS), np.nan)  # N; NaN = unknown
        self._tare_sum: Forces = np.zeros((2, ROWS, COLUMNS))
        self._tare_live = np.zeros((2, ROWS, COLUMNS), int)  # samples in the sum
        self._tare_count = 0
        self.tare_due = math.inf

    def set_dead(self, pad: int, row: int, column: int, dead: bool = True) -> None:
        """Make a taxel dead or live: pad 0 is left, 1 right."""
        self._dead[pad, row, column] = dead

    def sample(self) -> Forces:
        """Return (2, 10, 10) N: left and right after the tare, at least 0; NaN = dead, or not in the tare."""
        raw = self._read()
        return np.maximum(raw - self._baseline if self.tared else raw, 0.0)

    def start_tare(self, now: float) -> AckError:
        """Start a tare; DONE means that `poll_tare` will return the result."""
        if self.tare_due < math.inf or self._loaded(self._read()):
            return AckError.NOT_NOW
        self._tare_sum[:] = 0.0
        self._tare_live[:] = 0
        self._tare_count = 0
        self.tare_due = now
        return AckError.DONE

    def poll_tare(self, now: float) -> AckError | None:
        """Take due samples; return the result of the tare, None while it runs."""
        while now >= self.tare_due:
            raw = self._read()
            if self._loaded(raw):
                self.tare_due = math.inf
                return AckError.NOT_NOW
            self._tare_sum += np.nan_to_num(raw)
            self._tare_live += ~np.isnan(raw)
            self._tare_count += 1
            if self._tare_count == TARE_SAMPLES:
                with np.errstate(invalid="ignore"):
                    self._baseline = self._tare_sum / self._tare_live  # 0 / 0 is NaN: dead in every sample
                self.tared = True
                self.tare_due = math.inf
                return AckError.DONE
            self.tare_due += TARE_PERIOD
        return None

    def _read(self) -> Forces:
        raw: Forces = np.array(self._plant.read_taxels(), float)
        raw[self._dead] = np.nan
        return raw

    def _loaded(self, raw: Forces) -> bool:
        """Return whether any live taxel carries a load after the present tare.

        Without a tare, the resting value of a taxel may come near 1 N. The median of its pad then replaces the
        baseline, because contact covers only a quarter of a pad.
        """
        baseline = np.where(np.isnan(self._baseline), _medians(raw), self._baseline)
        return bool((raw - baseline >= CONTACT_FORCE).any())  # NaN compares false


def _medians(raw: Forces) -> Forces:
    """Return the median of each pad's live taxels (2, 1, 1) N; 0 for a pad without any."""
    return np.array([_median(np.sort(pad[~np.isnan(pad)])) for pad in raw]).reshape(2, 1, 1)


def _median(ordered: Forces) -> float:
    """Return the median; numpy's own imports numpy.ma first, which stalls an emulator by 0.1 s on a busy computer."""
    count = len(ordered)
    return 0.5 * float(ordered[(count - 1) // 2] + ordered[count // 2]) if count else 0.0
