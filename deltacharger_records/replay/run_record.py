# SPDX-License-Identifier: Apache-2.0
"""Data of one docking: the recorder fills them, the picture shows them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_ros.outcomes import Outcome

_CAPACITY = 24_000  # samples of a series; then every second one is dropped


class Series:
    """Samples over time, bounded in number: when full, every second one is dropped and the sampling rate halves.

    Args:
        columns: names of the values of one sample.
    """

    def __init__(self, *columns: str) -> None:
        self.columns = columns
        self._rows: list[tuple[float, ...]] = []
        self._stride = 1
        self._offered = 0

    def add(self, time: float, *values: float) -> None:
        """Take one sample at `time` (s); `values` in the order of the columns, NaN = not measured."""
        self._offered += 1
        if self._offered % self._stride:
            return
        self._rows.append((time, *values))
        if len(self._rows) >= _CAPACITY:
            del self._rows[::2]
            self._stride *= 2

    def last(self, column: str) -> float:
        """Return the newest value of a column; NaN if empty."""
        return self._rows[-1][1 + self.columns.index(column)] if self._rows else float("nan")

    def shift(self, seconds: float) -> None:
        """Shift time 0 later by `seconds`."""
        self._rows = [(time - seconds, *values) for time, *values in self._rows]

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """Return `time` and every column as arrays (n,)."""
        rows = list(self._rows)
        table = np.array(rows, dtype=np.float64).reshape(len(rows), 1 + len(self.columns))
        return {name: table[:, index] for index, name in enumerate(("time", *self.columns))}


@dataclass
class Touch:
    """One measurement by touch that docking used: the target's pose in end_effector (m, rad) at `time` (s).

    Attributes:
        across: offset across the target's bars, m; NaN = not recorded.
        across_stddev: m.
        sure: whether the estimate was sure and in range.
        frames: forces of the pads, (left, right), each (rows, columns) N; None = not recorded.
        contact: number of its contact, from 1; 0 = unknown.
        verdict: on clearance, as text; '' = not judged.
        clearance: m, of the estimate itself; NaN = unknown.
    """

    time: float
    horizontal: float
    vertical: float
    angle: float
    horizontal_stddev: float
    vertical_stddev: float
    angle_stddev: float
    sure: bool
    contact: int = 0
    frames: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    verdict: str = ""
    clearance: float = float("nan")
    across: float = float("nan")
    across_stddev: float = float("nan")

    @property
    def estimate(self) -> MisalignmentEstimate:
        """The pose as docking judges it: by `across`, or by the pose alone if that was not recorded."""
        return MisalignmentEstimate(
            self.angle,
            self.angle_stddev,
            self.vertical,
            self.vertical_stddev,
            self.horizontal,
            self.horizontal_stddev,
            across=self.across,
            across_stddev=self.across_stddev,
        )


@dataclass(frozen=True)
class Decided:
    """One decision of docking: time (s), phase, kind, text and numbers (SI, by name)."""

    time: float
    phase: str
    kind: str
    text: str
    values: dict[str, float]


@dataclass
class Run:
    """One docking; times are s, from a zero that its maker chooses.

    Attributes:
        motion: measured z (m), contact force along z on the target (N), and that force as contact current (A).
        contact: contact current (A) as the charger reports it, without free-motion friction.
        misalignment: continuous estimates: horizontal, vertical (m), angle (rad).
        decided: the estimates that the charger used, same columns.
        power: charge current (A) and whether the contactor is closed (0 or 1).
        phases: (time, name) at each change.
        touches: the measurements that docking used.
        decisions: what docking decided.
        frames: the last tactile frames in contact, (left, right), each (rows, columns) N; None = none.
        seen: the detector's last image, annotated, (H, W, 3) uint8 RGB; None = none was used.
        limits: offsets along and across the bars (m) within which docking must rest; None = unknown.
        outcome: of the goal; None = not yet.
        notes: for the picture's title, e.g. the scene's name.
    """

    motion: Series = field(default_factory=lambda: Series("z", "force", "current"))
    contact: Series = field(default_factory=lambda: Series("current"))
    misalignment: Series = field(default_factory=lambda: Series("horizontal", "vertical", "angle"))
    decided: Series = field(default_factory=lambda: Series("horizontal", "vertical", "angle"))
    power: Series = field(default_factory=lambda: Series("current", "closed"))
    phases: list[tuple[float, str]] = field(default_factory=list)
    touches: list[Touch] = field(default_factory=list)
    decisions: list[Decided] = field(default_factory=list)
    frames: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    seen: NDArray[np.uint8] | None = None
    limits: tuple[float, float] | None = None
    outcome: Outcome | None = None
    notes: dict[str, Any] = field(default_factory=dict)

    def shift(self, seconds: float) -> None:
        """Shift time 0 later by `seconds`."""
        for series in (self.motion, self.contact, self.misalignment, self.decided, self.power):
            series.shift(seconds)
        self.phases = [(time - seconds, phase) for time, phase in self.phases]
        self.touches = [replace(touch, time=touch.time - seconds) for touch in self.touches]
        self.decisions = [replace(each, time=each.time - seconds) for each in self.decisions]
