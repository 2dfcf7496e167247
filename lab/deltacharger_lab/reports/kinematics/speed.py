# SPDX-License-Identifier: Apache-2.0
"""Process time of solvers, independent of other work: single calls, arrays, by the array's size."""

from __future__ import annotations

import functools
import statistics
import time
import timeit
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_lab.reports.kinematics.forms import INVERSE_FORMS, inverse_array
from deltacharger_lab.reports.kinematics.solvers import ARRAY, SCALAR, Solver

Call = Callable[[], object]
BATCH = 10_000
_SINGLES = 200  # points in one timing of single calls
_SLOW_LIMIT = 100_000  # larger arrays are timed only for cheap calls
NEAR_EDGE = "Delta.inverse, all points near the edge"
_LARGEST_COUNT = 1 << 20  # repeated calls in one timing


@dataclass(frozen=True)
class Cost:
    """Seconds per call over repeats.

    Attributes:
        median: of the repeats; shown in the tables.
        best: the least disturbed repeat.
    """

    median: float
    best: float


@dataclass(frozen=True)
class Stopwatch:
    """Durations and repeats of timings.

    Attributes:
        repeats: number of timings of which median and best are kept.
        least: s, shortest timing; faster calls are repeated within one.
    """

    repeats: int = 7
    least: float = 0.02

    def time(self, call: Callable[[], object]) -> Cost:
        """Return the cost of `call` after a first call that does not count."""
        call()
        count = 1
        while count < _LARGEST_COUNT:
            spent = _spent(call, count)
            if spent >= self.least:
                break
            count = max(2 * count, min(_LARGEST_COUNT, int(1.2 * count * self.least / max(spent, 1e-7))))
        each = [_spent(call, count) / count for _ in range(self.repeats)]
        return Cost(statistics.median(each), min(each))

    def ratio(self, slow: Callable[[], object], quick: Callable[[], object]) -> float:
        """Return the run time of `slow` relative to `quick`: the median over turns of the two."""
        counts = []
        for call in (slow, quick):
            cost = Stopwatch(1, self.least).time(call)
            counts.append(max(1, round(self.least / max(cost.best, 1e-7))))
        quotients = []
        for _ in range(2 * self.repeats):
            first, second = (_spent(call, count) / count for call, count in zip((slow, quick), counts, strict=True))
            quotients.append(first / max(second, 1e-12))
        return statistics.median(quotients)


def _spent(call: Callable[[], object], count: int) -> float:
    return timeit.timeit(call, timer=time.process_time, number=count)


def solver_costs(solvers: Sequence[Solver], triples: Array, stopwatch: Stopwatch) -> dict[str, dict[str, float | None]]:
    """Return µs per triple for each solver: in an array of BATCH, and one call at a time; None = no such call."""
    batch = _tiled(triples, BATCH)
    found: dict[str, dict[str, float | None]] = {}
    for solver in solvers:
        singles = triples[: _SINGLES if solver.family != "peer" else _SINGLES // 4]
        row = found[solver.name] = {}
        calls = (("array", _whole(solver, batch), BATCH), ("one", solver.each(singles), len(singles)))
        for kind, call, count in calls:
            cost = None if call is None else stopwatch.time(call)
            row[f"{kind}_us"] = None if cost is None else 1e6 * cost.median / count
            row[f"{kind}_best_us"] = None if cost is None else 1e6 * cost.best / count
    return found


def ratios(solvers: Sequence[Solver], triples: Array, stopwatch: Stopwatch) -> dict[str, dict[str, float | None]]:
    """Return each peer's run time relative to ours, in single calls and in arrays; None = no such call.

    Both are timed in turns, so that variations of the machine's speed affect both equally.
    """
    by_name = {solver.name: solver for solver in solvers}
    batch, singles = _tiled(triples, BATCH), triples[: _SINGLES // 4]
    ours = by_name[SCALAR].each(singles), _whole(by_name[ARRAY], batch)

    def ratio(slow: Call | None, quick: Call | None) -> float | None:
        return stopwatch.ratio(slow, quick) if slow and quick else None

    return {
        solver.name: {"one": ratio(solver.each(singles), ours[0]), "array": ratio(_whole(solver, batch), ours[1])}
        for solver in solvers
        if solver.family == "peer"
    }


def throughput(
    geometry: DeltaGeometry, interior: Array, near_edge: Array, stopwatch: Stopwatch, sizes: Sequence[int]
) -> dict[str, dict[str, float]]:
    """Return poses per second by the size of the array, for the full solve with status and margin and for parts."""
    delta, plain = Delta(geometry), INVERSE_FORMS["single atan2"]
    calls: dict[str, tuple[Callable[[Array], object], Array, int]] = {
        "Delta.inverse": (delta.inverse, interior, max(sizes)),
        "Delta.inverse, precise": (lambda p: delta.inverse(p, precise=True), interior, _SLOW_LIMIT),
        NEAR_EDGE: (delta.inverse, near_edge, _SLOW_LIMIT),
        "single atan2 in numpy, angles only": (lambda p: inverse_array(plain, geometry, p), interior, max(sizes)),
        "Delta.forward": (delta.forward, delta.inverse(interior).angles, _SLOW_LIMIT),
        "Delta.jacobian": (delta.jacobian, interior, _SLOW_LIMIT),
    }
    found: dict[str, dict[str, float]] = {}
    for name, (call, points, largest) in calls.items():
        row = found[name] = {}
        for size in sizes:
            if size <= largest:
                batch = _tiled(points, size)
                row[str(size)] = size / stopwatch.time(functools.partial(call, batch)).median
    return found


def function_costs(geometry: DeltaGeometry, interior: Array, stopwatch: Stopwatch) -> dict[str, dict[str, float]]:
    """Return µs per point of the library's functions: plain floats, Delta with one point, Delta with an array."""
    delta, scalar = Delta(geometry), ScalarDelta(geometry)
    batch = _tiled(interior, BATCH)
    angles = delta.inverse(batch).angles
    x, y, z = point = tuple(interior[0].tolist())
    arms = tuple(angles[0].tolist())
    push = (1.0, 2.0, 20.0)
    cases: dict[str, tuple[Call, Call, Call]] = {
        "inverse": (lambda: scalar.inverse(*point), lambda: delta.inverse(point), lambda: delta.inverse(batch)),
        "forward": (lambda: scalar.forward(*arms), lambda: delta.forward(arms), lambda: delta.forward(angles)),
        "jacobian": (lambda: scalar.jacobian(*point), lambda: delta.jacobian(point), lambda: delta.jacobian(batch)),
        "torque": (
            lambda: scalar.torque(x, y, z, push),
            lambda: delta.torque(point, push),
            lambda: delta.torque(batch, push),
        ),
    }
    return {
        name: {
            "scalar_us": 1e6 * stopwatch.time(plain).median,
            "point_us": 1e6 * stopwatch.time(one).median,
            "array_us": 1e6 * stopwatch.time(array).median / BATCH,
        }
        for name, (plain, one, array) in cases.items()
    }


def _tiled(points: Array, size: int) -> Array:
    """Return `size` points, contiguous, repeating the given ones if they are fewer."""
    return np.ascontiguousarray(np.resize(points, (size, 3)))


def _whole(solver: Solver, batch: Array) -> Call | None:
    return None if solver.array is None else functools.partial(solver.array, batch)
