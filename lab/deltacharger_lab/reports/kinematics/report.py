# SPDX-License-Identifier: Apache-2.0
"""Error and run time of the library's inverse and forward kinematics: figures as JSON, and a page with tables.

Closed forms, general solvers, extreme inputs and robots, and maps of the workspace were measured once, with version
1.0.0: docs/reports/kinematics.md keeps them.
"""

import dataclasses
import functools
import math
import statistics
import time
import timeit
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_lab.reports.kinematics import reference, sets
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most

ARRAY, SCALAR = "Delta, array", "ScalarDelta"
BATCH = 10_000
_SINGLES = 200  # points in one timing of single calls
_MERGED = 1e-13  # rad; closer knees count as one


@dataclass(frozen=True)
class Stopwatch:
    """Process time of calls, independent of other work.

    Attributes:
        repeats: number of timings of which the median counts.
        least: s, shortest timing; faster calls are repeated within one.
    """

    repeats: int = 7
    least: float = 0.02

    def time(self, call: Callable[[], object]) -> float:
        """Return the seconds of a call, after a first one that does not count."""
        call()
        count = math.ceil(self.least / max(_spent(call, 1), 1e-7))
        return statistics.median(_spent(call, count) / count for _ in range(self.repeats))


def _spent(call: Callable[[], object], count: int) -> float:
    return timeit.timeit(call, timer=time.process_time, number=count)


@dataclass(frozen=True)
class KinematicsPlan:
    """Extent of the measurement.

    Attributes:
        points: per set.
        round_trips: points sent through inverse and forward.
        seed: of every set.
        largest: of the arrays timed.
        stopwatch: how calls are timed.
    """

    points: int
    round_trips: int
    seed: int
    largest: int
    stopwatch: Stopwatch

    def generator(self, stream: int) -> np.random.Generator:
        """Return the generator of one set, independent of the others."""
        return np.random.default_rng([self.seed, stream])


def make_plan(seed: int, quick: bool) -> KinematicsPlan:
    """Return what the report measures."""
    if quick:
        return KinematicsPlan(200, 10_000, seed, 10_000, Stopwatch(3, 0.004))
    return KinematicsPlan(5_000, 100_000, seed, 1_000_000, Stopwatch())


@dataclass(frozen=True)
class Solver:
    """One way through the library, from triples (points or angles) to triples.

    Attributes:
        name: in the tables.
        array: (n, 3) to (n, 3) in one call; None = no such call.
        one: three floats of a single triple; None = arrays only.
    """

    name: str
    array: Callable[[Array], Array] | None = None
    one: Callable[..., Any] | None = None

    def each(self, triples: Array) -> Callable[[], list[Any]] | None:
        """Return a call that solves triples (n, 3) one by one; None without `one`."""
        one = self.one
        if one is None:
            return None
        rows = [tuple(row) for row in triples.tolist()]
        return lambda: [one(*each) for each in rows]

    def solve(self, triples: Array) -> Array:
        """Return the answers (n, 3), from the array call if there is one."""
        if self.array is not None:
            return self.array(triples)
        one_by_one = self.each(triples)
        assert one_by_one is not None
        return np.array(one_by_one(), dtype=np.float64).reshape(-1, 3)

    def cost(self, triples: Array, stopwatch: Stopwatch) -> dict[str, float | None]:
        """Return µs per triple in an array of BATCH, and one call at a time; None = no such call."""
        singles, batch = triples[:_SINGLES], _tiled(triples, BATCH)
        whole = None if self.array is None else functools.partial(self.array, batch)
        calls = (("array_us", whole, BATCH), ("one_us", self.each(singles), len(singles)))
        return {key: None if call is None else 1e6 * stopwatch.time(call) / count for key, call, count in calls}


def inverse_solvers(geometry: DeltaGeometry) -> list[Solver]:
    """Return all ways from points to angles."""
    delta, scalar = Delta(geometry), ScalarDelta(geometry)
    return [Solver(ARRAY, lambda points: delta.inverse(points).angles), Solver(SCALAR, None, scalar.inverse)]


def forward_solvers(geometry: DeltaGeometry) -> list[Solver]:
    """Return all ways from angles to points."""
    delta, scalar = Delta(geometry), ScalarDelta(geometry)
    return [Solver(ARRAY, lambda angles: delta.forward(angles).position), Solver(SCALAR, None, scalar.forward)]


@dataclass(frozen=True)
class ErrorSample:
    """Points, or arm angles, with the exact answer to each and the answer of the other knees or the mirror image."""

    points: sets.PointSet
    right: reference.Exact
    other: reference.Exact


Verdict = tuple[Array, Mask, Mask]
"""Per answer (n,): its error, NaN for no answer; whether it is missing; whether it is the other one."""


def inverse_samples(exact: reference.ExactDelta, plan: KinematicsPlan) -> list[ErrorSample]:
    """Return the sets on which inverse kinematics is measured."""
    geometry = exact.geometry
    drawn = [
        sets.interior(geometry, plan.generator(1), plan.points),
        sets.boundary(exact, plan.generator(2), plan.points),
        sets.fold(exact, plan.generator(3), plan.points),
        sets.near_type_2(geometry, plan.generator(4), plan.points),
        sets.wide(geometry, plan.generator(5), plan.points),
    ]
    return [ErrorSample(each, *exact.inverse(each.points)) for each in drawn]


def forward_samples(exact: reference.ExactDelta, samples: Sequence[ErrorSample]) -> list[ErrorSample]:
    """Return the sets of arm angles for forward kinematics."""
    mirror = reference.ExactDelta(exact.geometry, ahead=False)
    drawn = [dataclasses.replace(each.points, points=each.right.high, edge=None) for each in samples]
    return [ErrorSample(each, exact.forward(each.points), mirror.forward(each.points)) for each in drawn]


def describe(samples: Sequence[sets.PointSet]) -> list[dict[str, Any]]:
    """Return name, origin and counts of sets."""
    return [{"name": each.name, "about": each.about, "count": len(each.points)} for each in samples]


def inverse_errors(sample: ErrorSample, angles: Array) -> Verdict:
    """Judge arm angles (n, 3): the error of a pose is that of its worst angle, rad."""
    error, to_other = sample.right.angle_error(angles), sample.other.angle_error(angles)
    apart = sample.right.angle_error(sample.other.high)
    missing = ~np.isfinite(angles).all(-1)
    wrong = ~missing & ((to_other < 0.1 * error) & (apart > _MERGED)).any(-1)
    return np.where(missing | wrong, np.nan, error.max(-1)), np.asarray(missing), np.asarray(wrong)


def forward_errors(sample: ErrorSample, positions: Array) -> Verdict:
    """Judge positions (n, 3), m."""
    error = sample.right.distance(positions)
    # Angles rounded to doubles may have no position at all; then no answer is right.
    missing = ~np.isfinite(positions).all(-1) & np.isfinite(sample.right.high).all(-1)
    mirrored = ~missing & (sample.other.distance(positions) < 0.1 * error)
    return np.where(missing | mirrored, np.nan, error), np.asarray(missing), np.asarray(mirrored)


def accuracy(
    solvers: Sequence[Solver],
    samples: Sequence[ErrorSample],
    judge: Callable[[ErrorSample, Array], Verdict],
    timed: Array,
    stopwatch: Stopwatch,
) -> list[dict[str, Any]]:
    """Return for each way its times and, for each set, median and maximum error and shares of none and other answers.

    Args:
        solvers: to measure.
        samples: sets with exact answers.
        judge: returns the errors of answers.
        timed: triples (n, 3) on which run times are measured.
        stopwatch: how.
    """
    found = []
    for solver in solvers:
        row = {}
        for sample in samples:
            error, missing, mistaken = judge(sample, solver.solve(sample.points.points))
            shares = {"none": float(missing.mean()), "wrong": float(mistaken.mean())}
            row[sample.points.name] = {"count": len(error), **_median_and_max(error), **shares}
        found.append({"name": solver.name, "sets": row, **solver.cost(timed, stopwatch)})
    return found


def reach_decisions(
    solvers: Sequence[Solver], exact: reference.ExactDelta, inside: sets.PointSet, plan: KinematicsPlan
) -> tuple[list[sets.PointSet], dict[str, dict[str, int]]]:
    """Return the sets, outside and inside reach, and each way's number of points on the wrong side."""
    drawn = [
        sets.outside(exact, plan.generator(6), plan.points, -15.0, -3.0),
        sets.outside(exact, plan.generator(7), plan.points, -17.0, -15.0),
        inside,
    ]
    found: dict[str, dict[str, int]] = {}
    for solver in solvers:
        row = found[solver.name] = {}
        for each in drawn:
            reachable = np.isfinite(solver.solve(each.points)).all(-1)
            row[each.name] = int((~reachable if each is inside else reachable).sum())
    return drawn, found


def round_trips(geometry: DeltaGeometry, plan: KinematicsPlan) -> dict[str, float]:
    """Return |FK(IK(p)) − p| in m over the workspace box."""
    delta = Delta(geometry)
    points = sets.interior(geometry, plan.generator(8), plan.round_trips).points
    back = delta.forward(delta.inverse(points).angles).position
    return {"count": len(points), **_median_and_max(np.linalg.norm(back - points, axis=-1))}


def build(plan: KinematicsPlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page and figures into `directory` and return the figures.

    Raises:
        ImportError: mpmath is missing.
        OSError: a file cannot be written.
    """
    geometry = DeltaGeometry()
    exact = reference.ExactDelta(geometry)  # first, so that a missing mpmath is reported at once
    report = Report("kinematics", command, ("numpy", "mpmath"))
    results, watch = report.results, plan.stopwatch
    results |= {"digits": reference.DIGITS, "seed": plan.seed, "points": plan.points}
    progress("drawing the sets, solving them to 60 digits")
    samples = inverse_samples(exact, plan)
    by_name = {sample.points.name: sample for sample in samples}
    results["sets"] = describe([each.points for each in samples])
    progress("inverse kinematics")
    triples = sets.interior(geometry, plan.generator(10), BATCH).points
    solvers = inverse_solvers(geometry)
    results["inverse"] = accuracy(solvers, samples, inverse_errors, triples, watch)
    drawn, decisions = reach_decisions(solvers, exact, by_name["boundary"].points, plan)
    results["reach"] = {"sets": describe(drawn), "solvers": decisions}
    progress("forward kinematics")
    there = forward_samples(exact, [by_name[name] for name in ("interior", "wide", "near type 2")])
    results["forward"] = accuracy(
        forward_solvers(geometry), there, forward_errors, by_name["interior"].right.high, watch
    )
    results["round_trip"] = round_trips(geometry, plan)
    batch = _tiled(triples, plan.largest)
    results["poses_per_s"] = plan.largest / watch.time(functools.partial(Delta(geometry).inverse, batch))
    results["targets"] = targets(results)
    report.draw({}, directory)
    return report.write(directory, batch=BATCH)


def targets(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Return each target with what was measured and whether it is met."""
    rows = {row["name"]: row for row in results["inverse"]}
    plain = [row["sets"] for row in rows.values()]
    *outside, inside = (each["name"] for each in results["reach"]["sets"])
    decisions = results["reach"]["solvers"].values()
    beyond, within = sum(row[name] for row in decisions for name in outside), sum(row[inside] for row in decisions)
    return [
        at_most("interior, largest error", max(row["interior"]["max"] for row in plain), 8e-16, "rad"),
        at_most("boundary, largest error", max(row["boundary"]["max"] for row in plain), 4e-16, "rad"),
        at_most("points outside called reachable", beyond, 0.0, ""),
        at_most("points inside called unreachable", within, 0.0, ""),
        at_most("FK of IK, largest distance", results["round_trip"]["max"], 5e-16, "m"),
        at_most("one point, ScalarDelta.inverse", rows[SCALAR]["one_us"], 5.0, "µs"),
        at_least("array, full solve", results["poses_per_s"], 3e6, "poses/s"),
    ]


def _tiled(points: Array, size: int) -> Array:
    """Return `size` points, contiguous, repeating the given ones if they are fewer."""
    return np.ascontiguousarray(np.resize(points, (size, 3)))


def _median_and_max(values: Array) -> dict[str, float]:
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return {"median": float("nan"), "max": float("nan")}
    return {"median": float(np.median(known)), "max": float(known.max())}
