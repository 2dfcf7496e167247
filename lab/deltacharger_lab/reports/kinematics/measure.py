# SPDX-License-Identifier: Apache-2.0
"""Errors and decisions of every solver on every set, as plain dicts for JSON and tables."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_lab.reports.kinematics import sets
from deltacharger_lab.reports.kinematics.reference import Exact, ExactDelta
from deltacharger_lab.reports.kinematics.sets import PointSet
from deltacharger_lab.reports.kinematics.solvers import Solver, calls_reachable
from deltacharger_lab.reports.kinematics.speed import Stopwatch

_MERGED = 1e-13  # rad; closer knees count as one
DECADES = range(-17, -3)


@dataclass(frozen=True)
class KinematicsPlan:
    """Extent of the measurement.

    Attributes:
        points: per set.
        peer_points: per set, of the slow general solvers.
        round_trips: points sent through inverse and forward.
        seed: of every set.
        sizes: of the arrays timed.
        stopwatch: how calls are timed.
        grid: pixels along x of the workspace pictures.
    """

    points: int
    peer_points: int
    round_trips: int
    seed: int
    sizes: tuple[int, ...]
    stopwatch: Stopwatch
    grid: int

    def generator(self, stream: int) -> np.random.Generator:
        """Return the generator of one set, independent of the others."""
        return np.random.default_rng([self.seed, stream])


@dataclass(frozen=True)
class ErrorSample:
    """Points, or arm angles, with the exact answer to each and the answer of the other knees or the mirror image."""

    points: PointSet
    right: Exact
    other: Exact

    def of(self, solver: Solver, plan: KinematicsPlan) -> ErrorSample:
        """Return the sample for a solver: the first few for slow general ones."""
        if solver.family != "peer":
            return self
        count = plan.peer_points
        return ErrorSample(self.points.first(count), self.right.first(count), self.other.first(count))


Verdict = tuple[Array, Mask, Mask]
"""Per answer (n,): its error, NaN for no answer; whether it is missing; whether it is the other one."""


def inverse_samples(exact: ExactDelta, plan: KinematicsPlan) -> list[ErrorSample]:
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


def describe(samples: Sequence[PointSet], plan: KinematicsPlan) -> list[dict[str, Any]]:
    """Return name, origin, counts and seed of sets."""
    return [
        {
            "name": each.name,
            "about": each.about,
            "count": len(each.points),
            "peer_count": min(len(each.points), plan.peer_points),
            "seed": plan.seed,
        }
        for each in samples
    ]


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
    plan: KinematicsPlan,
    judge: Callable[[ErrorSample, Array], Verdict],
    other: str,
) -> list[dict[str, Any]]:
    """Return for each solver and set: median and maximum error, shares without an answer and with the other one.

    Args:
        solvers: to measure.
        samples: sets with exact answers.
        plan: extent of the measurement.
        judge: returns the errors of answers.
        other: name for answers that are the other one.
    """
    found = []
    for solver in solvers:
        row = {}
        for sample in samples:
            used = sample.of(solver, plan)
            error, missing, mistaken = judge(used, solver.solve(used.points.points))
            shares = {"none": float(missing.mean()), other: float(mistaken.mean())}
            row[sample.points.name] = {"count": len(error), **_median_and_max(error), **shares}
        found.append({"name": solver.name, "family": solver.family, "sets": row})
    return found


def edge_curve(solvers: Sequence[Solver], sample: ErrorSample, plan: KinematicsPlan) -> dict[str, list[float | None]]:
    """Return the largest error per decade of distance to the edge of reach, from 1e-17 m up; None = no answer."""
    curves: dict[str, list[float | None]] = {}
    for solver in solvers:
        used = sample.of(solver, plan)
        assert used.points.edge is not None
        worst, _, _ = inverse_errors(used, solver.solve(used.points.points))
        decade = np.floor(np.log10(used.points.edge)).astype(int)
        curves[solver.name] = [_largest(worst[decade == each]) for each in DECADES]
    return curves


def reach_decisions(
    solvers: Sequence[Solver], exact: ExactDelta, inside: ErrorSample, plan: KinematicsPlan
) -> tuple[list[PointSet], dict[str, dict[str, int]]]:
    """Return the sets, outside and inside reach, and each solver's number of points on the wrong side."""
    drawn = [
        sets.outside(exact, plan.generator(6), plan.points, -15.0, -3.0),
        sets.outside(exact, plan.generator(7), plan.points, -17.0, -15.0),
        inside.points,
    ]
    found: dict[str, dict[str, int]] = {}
    for solver in solvers:
        row = found[solver.name] = {}
        for each in drawn:
            points = each.points[: plan.peer_points if solver.family == "peer" else None]
            reachable = calls_reachable(solver, points)
            mistaken = ~reachable if each is inside.points else reachable
            row[each.name] = int(mistaken.sum())
            row[f"{each.name} count"] = len(points)
    return drawn, found


def forward_samples(exact: ExactDelta, samples: Sequence[ErrorSample]) -> list[ErrorSample]:
    """Return the sets of arm angles for forward kinematics."""
    mirror = ExactDelta(exact.geometry, exact.working_mode, -exact.assembly)
    drawn = [dataclasses.replace(each.points, points=each.right.high, edge=None) for each in samples]
    return [ErrorSample(each, exact.forward(each.points), mirror.forward(each.points)) for each in drawn]


def round_trips(geometry: DeltaGeometry, plan: KinematicsPlan) -> dict[str, dict[str, float]]:
    """Return |FK(IK(p)) − p| in m over the workspace box, plain and precise."""
    delta = Delta(geometry)
    points = sets.interior(geometry, plan.generator(8), plan.round_trips).points
    found = {}
    for name, precise in (("Delta.inverse", False), ("Delta.inverse, precise", True)):
        back = delta.forward(delta.inverse(points, precise=precise).angles).position
        found[name] = {"count": len(points), **_median_and_max(np.linalg.norm(back - points, axis=-1))}
    return found


def _median_and_max(values: Array) -> dict[str, float]:
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return {"median": float("nan"), "max": float("nan")}
    return {"median": float(np.median(known)), "max": float(known.max())}


def _largest(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None
