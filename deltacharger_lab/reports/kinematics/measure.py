# SPDX-License-Identifier: Apache-2.0
"""Errors and decisions of every solver on every set, as plain dicts that become JSON and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_lab.reports.kinematics import sets
from deltacharger_lab.reports.kinematics.reference import Exact, ExactDelta, ExactInverse
from deltacharger_lab.reports.kinematics.sets import PointSet
from deltacharger_lab.reports.kinematics.solvers import Solver, answers, calls_reachable
from deltacharger_lab.reports.kinematics.timing import Stopwatch

Array = NDArray[np.float64]
_MERGED = 1e-13  # rad; knees closer than this are one
DECADES = range(-17, -3)


@dataclass(frozen=True)
class KinematicsPlan:
    """How much is measured.

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
        """Return the generator of one set, independent of what else is drawn."""
        return np.random.default_rng([self.seed, stream])


@dataclass(frozen=True)
class ErrorSample:
    """A set with its exact angles."""

    points: PointSet
    exact: ExactInverse

    def first(self, count: int) -> ErrorSample:
        """Return the first `count` points with their angles."""
        inverse = self.exact
        cut = [Exact(each.high[:count], each.low[:count]) for each in (inverse.angles, inverse.other)]
        edge = None if self.points.edge is None else self.points.edge[:count]
        chosen = PointSet(self.points.name, self.points.about, self.points.points[:count], edge)
        return ErrorSample(chosen, ExactInverse(*cut))


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
    return [ErrorSample(each, exact.inverse(each.points)) for each in drawn]


def describe(samples: Sequence[PointSet], plan: KinematicsPlan, peer_points: int) -> list[dict[str, Any]]:
    """Return name, origin, counts and seed of sets."""
    return [
        {
            "name": each.name,
            "about": each.about,
            "count": len(each.points),
            "peer_count": min(len(each.points), peer_points),
            "seed": plan.seed,
        }
        for each in samples
    ]


def pose_errors(sample: ErrorSample, angles: Array) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return per pose: error (n,) rad of its worst angle, no answer (n,), wrong knee (n,)."""
    error, to_other = sample.exact.angles.angle_error(angles), sample.exact.other.angle_error(angles)
    apart = sample.exact.angles.angle_error(sample.exact.other.high)
    missing = ~np.isfinite(angles).all(-1)
    wrong = ~missing & ((to_other < 0.1 * error) & (apart > _MERGED)).any(-1)
    worst = np.where(missing | wrong, np.nan, error.max(-1))
    return np.asarray(worst), np.asarray(missing), np.asarray(wrong)


def inverse_accuracy(
    solvers: Sequence[Solver], samples: Sequence[ErrorSample], geometry: DeltaGeometry, plan: KinematicsPlan
) -> dict[str, dict[str, dict[str, float]]]:
    """Return for each solver and set: median and maximum error, shares without an answer and on the wrong knee."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for solver in solvers:
        row = found[solver.name] = {}
        for sample in samples:
            used = sample.first(plan.peer_points) if solver.family == "peer" else sample
            angles = answers(solver, geometry, used.points.points)
            worst, missing, wrong = pose_errors(used, angles)
            row[sample.points.name] = {
                "count": len(worst),
                **_median_and_max(worst),
                "none": float(missing.mean()),
                "wrong": float(wrong.mean()),
            }
    return found


def edge_curve(
    solvers: Sequence[Solver], sample: ErrorSample, geometry: DeltaGeometry, plan: KinematicsPlan
) -> dict[str, list[float | None]]:
    """Return the largest error per decade of distance to the edge of reach, from 1e-17 m up; None = no answer there."""
    curves: dict[str, list[float | None]] = {}
    for solver in solvers:
        used = sample.first(plan.peer_points) if solver.family == "peer" else sample
        assert used.points.edge is not None
        worst, _, _ = pose_errors(used, answers(solver, geometry, used.points.points))
        decade = np.floor(np.log10(used.points.edge)).astype(int)
        curves[solver.name] = [_largest(worst[decade == each]) for each in DECADES]
    return curves


def reach_decisions(
    solvers: Sequence[Solver], exact: ExactDelta, inside: ErrorSample, plan: KinematicsPlan
) -> tuple[list[PointSet], dict[str, dict[str, int]]]:
    """Return the sets, outside and inside reach, and for each solver how many points it puts on the other side."""
    geometry = exact.geometry
    drawn = [
        sets.outside(exact, plan.generator(6), plan.points, -15.0, -3.0),
        sets.outside(exact, plan.generator(7), plan.points, -17.0, -15.0),
        inside.points,
    ]
    found: dict[str, dict[str, int]] = {}
    for solver in solvers:
        row = found[solver.name] = {}
        for each in drawn:
            points = each.points[: plan.peer_points] if solver.family == "peer" else each.points
            reachable = calls_reachable(solver, geometry, points)
            mistaken = ~reachable if each is inside.points else reachable
            row[each.name] = int(mistaken.sum())
            row[f"{each.name} count"] = len(points)
    return drawn, found


def forward_accuracy(
    solvers: Sequence[Solver], exact: ExactDelta, samples: Sequence[ErrorSample], plan: KinematicsPlan
) -> dict[str, dict[str, dict[str, float]]]:
    """Return for each solver and set: median and maximum error in m, shares without an answer and mirrored."""
    mirror = ExactDelta(exact.geometry, exact.working_mode, -exact.assembly)
    truths = []
    for sample in samples:
        angles = sample.exact.angles.high
        truths.append((sample.points.name, angles, exact.forward(angles), mirror.forward(angles)))
    found: dict[str, dict[str, dict[str, float]]] = {}
    for solver in solvers:
        row = found[solver.name] = {}
        count = plan.peer_points if solver.family == "peer" else None
        for name, angles, right, other in truths:
            positions = solver.solve(angles[:count])
            error = Exact(right.high[:count], right.low[:count]).distance(positions)
            to_other = Exact(other.high[:count], other.low[:count]).distance(positions)
            # Angles rounded to doubles may have no position at all; nobody can miss that one.
            missing = ~np.isfinite(positions).all(-1) & np.isfinite(right.high[:count]).all(-1)
            mirrored = ~missing & (to_other < 0.1 * error)
            worst = np.where(missing | mirrored, np.nan, error)
            row[name] = {
                "count": len(worst),
                **_median_and_max(worst),
                "none": float(missing.mean()),
                "mirrored": float(mirrored.mean()),
            }
    return found


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
