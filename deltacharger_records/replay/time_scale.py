# SPDX-License-Identifier: Apache-2.0
"""A time axis that compresses hours of charging to the width of a docking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from deltacharger_records.replay.record import Replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SPARE = 0.3  # s of margin around the record
_SHARE = 0.35  # width of a long stretch of charging, as a share of the rest
_LEAST = 8.0  # s, smallest width of a compressed stretch
_EDGE = 3.0  # s at both ends of a long stretch that are not compressed


@dataclass(frozen=True)
class TimeScale:
    """Piecewise linear map from time (s) to the axis.

    Attributes:
        times: knots, increasing.
        places: of the knots on the axis, increasing.
        squeezed: compressed stretches.
    """

    times: tuple[float, ...]
    places: tuple[float, ...]
    squeezed: tuple[tuple[float, float], ...] = ()

    @property
    def span(self) -> tuple[float, float]:
        """First and last time shown."""
        return self.times[0], self.times[-1]

    @property
    def width(self) -> float:
        """Width of the axis."""
        return self.places[-1] - self.places[0]

    def forward(self, time: Any) -> Any:
        """Return the places of one or many times."""
        return np.interp(time, self.times, self.places)

    def inverse(self, place: Any) -> Any:
        """Return the times of one or many places."""
        return np.interp(place, self.places, self.times)

    def beside(self, time: float, share: float) -> float:
        """Return the time drawn at a distance from `time`, given as a share of the axis."""
        return float(self.inverse(self.forward(time) + share * self.width))

    def apply(self, rows: Sequence[Axes]) -> None:
        """Use the scale on panels that share their time axis."""
        from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator

        if self.squeezed:
            for axes in rows:
                axes.set_xscale("function", functions=(self.forward, self.inverse))
            whole = MaxNLocator(6).tick_values(self.times[0], self.squeezed[0][0])
            ticks = [time for time in whole if self.times[0] <= time <= self.squeezed[0][0]]
            ticks += [round(stretch[1]) for stretch in self.squeezed]
            rows[-1].xaxis.set_major_locator(FixedLocator(ticks))
            rows[-1].xaxis.set_minor_locator(NullLocator())
            rows[-1].xaxis.set_major_formatter(lambda time, _: f"{time:g}")
            for begin, end in self.squeezed:
                rows[-1].annotate(
                    f"⟵ {_length(end - begin)} ⟶", (float(self.inverse(np.mean(self.forward((begin, end))))), 0.05),
                    xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=7.5, color="#51606e",
                )  # fmt: skip
        rows[0].set_xlim(self.span)


def scale_for(replay: Replay) -> TimeScale:
    """Return the scale for a recorded docking."""
    begin, end = -_SPARE, replay.end + _SPARE
    stretches = [
        (phase.start + _EDGE, phase.end - _EDGE) for phase in replay.phases if _is_long(phase.start, phase.end)
    ]
    rest = end - begin - sum(stop - start for start, stop in stretches)
    room = max(_SHARE * rest, _LEAST)
    times, places, squeezed = [begin], [0.0], []
    for start, stop in stretches:
        if stop - start <= room:
            continue
        places += [places[-1] + start - times[-1], places[-1] + start - times[-1] + room]
        times += [start, stop]
        squeezed.append((start, stop))
    places.append(places[-1] + end - times[-1])
    times.append(end)
    return TimeScale(tuple(times), tuple(places), tuple(squeezed))


def _is_long(start: float, end: float) -> bool:
    return end - start > 2.0 * _EDGE + _LEAST


def _length(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"
