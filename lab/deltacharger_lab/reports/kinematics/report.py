# SPDX-License-Identifier: Apache-2.0
"""Measures the kinematics and writes the report: figures as JSON, a page with tables, pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deltacharger_kinematics import DeltaGeometry
from deltacharger_lab.reports.kinematics import measure, speed
from deltacharger_lab.reports.kinematics.extremes import run_cases
from deltacharger_lab.reports.kinematics.geometries import measure_robots
from deltacharger_lab.reports.kinematics.measure import ErrorSample, KinematicsPlan
from deltacharger_lab.reports.kinematics.peers import load
from deltacharger_lab.reports.kinematics.pictures import PICTURES
from deltacharger_lab.reports.kinematics.reference import DIGITS, ExactDelta
from deltacharger_lab.reports.kinematics.sets import interior
from deltacharger_lab.reports.kinematics.solvers import OURS, PRECISE, SCALAR, Solver, forward_solvers, inverse_solvers
from deltacharger_lab.reports.kinematics.workspace import slice_workspace
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most

_LIBRARIES = ("numpy", "mpmath", "scipy", "casadi", "pin", "matplotlib")
DEFAULT_POINTS, QUICK_POINTS = 5_000, 200
Solvers = tuple[Sequence[Solver], Sequence[Solver]]
"""Of inverse and of forward kinematics."""


def full_plan(points: int, seed: int) -> KinematicsPlan:
    """Return what the report measures by default."""
    sizes = (1, 10, 100, 1_000, 10_000, 100_000, 1_000_000)
    return KinematicsPlan(points, min(points, 1_000), 100_000, seed, sizes, speed.Stopwatch(), 400)


def quick_plan(points: int, seed: int) -> KinematicsPlan:
    """Return what a quick look and the tests measure."""
    return KinematicsPlan(points, min(points, 60), 10_000, seed, (1, 100, 10_000), speed.Stopwatch(3, 0.004), 60)


def build(plan: KinematicsPlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, figures and pictures into `directory` and return the figures.

    Raises:
        ImportError: mpmath is missing.
        OSError: a file cannot be written.
    """
    geometry = DeltaGeometry()
    exact = ExactDelta(geometry)  # first, so that a missing mpmath is reported at once
    peers, absent = load(geometry)
    solvers = inverse_solvers(geometry, peers), forward_solvers(geometry, peers)
    report = Report("kinematics", command, _LIBRARIES)
    results = report.results
    results |= {
        "digits": DIGITS,
        "seed": plan.seed,
        "points": plan.points,
        "peers": {peer.name: peer.setup for peer in peers},
        "absent": absent,
    }
    progress("drawing the sets, solving them to 60 digits")
    samples = measure.inverse_samples(exact, plan)
    results["sets"] = measure.describe([each.points for each in samples], plan)
    results |= _measure_errors(solvers, samples, exact, plan, progress)
    progress("run times")
    _measure_speed(results, solvers, samples, exact, plan)
    progress("extreme inputs and robots")
    results["extremes"], results["robots"] = run_cases(plan), measure_robots(plan)
    progress("pictures")
    results["workspace"], planes = slice_workspace(geometry, plan.grid)
    results["targets"] = targets(results)
    report.draw(PICTURES, directory, planes=planes)
    return report.write(directory, view=speed)


def _measure_errors(
    solvers: Solvers, samples: Sequence[ErrorSample], exact: ExactDelta, plan: KinematicsPlan, progress: Progress
) -> dict[str, Any]:
    inverse, forward = solvers
    by_name = {sample.points.name: sample for sample in samples}
    progress("errors of inverse kinematics")
    found: dict[str, Any] = {"inverse": measure.accuracy(inverse, samples, plan, measure.inverse_errors, "wrong")}
    curves = measure.edge_curve(inverse, by_name["boundary"], plan)
    found["edge"] = {"decades": [10.0**each for each in measure.DECADES], "curves": curves}
    progress("decisions at the edge of reach")
    drawn, decisions = measure.reach_decisions(inverse, exact, by_name["boundary"], plan)
    found["reach"] = {"sets": measure.describe(drawn, plan), "solvers": decisions}
    progress("errors of forward kinematics")
    there = measure.forward_samples(exact, [by_name[name] for name in ("interior", "wide", "near type 2")])
    found["forward"] = measure.accuracy(forward, there, plan, measure.forward_errors, "mirrored")
    return {**found, "round_trip": measure.round_trips(exact.geometry, plan)}


def _measure_speed(
    results: dict[str, Any], solvers: Solvers, samples: Sequence[ErrorSample], exact: ExactDelta, plan: KinematicsPlan
) -> None:
    inverse, forward = solvers
    box, edge, fold = samples[:3]
    triples = interior(exact.geometry, plan.generator(10), speed.BATCH).points
    timed = {box.points.name: triples}
    timed |= {each.points.name: each.points.points for each in (edge, fold)}  # other paths of the solve, or more steps
    costs = {name: speed.solver_costs(inverse, points, plan.stopwatch) for name, points in timed.items()}
    for row in results["inverse"]:
        row["times"] = {name: each[row["name"]] for name, each in costs.items()}
        row |= row["times"][box.points.name]
    times = speed.solver_costs(forward, box.right.high, plan.stopwatch)
    for row in results["forward"]:
        row |= times[row["name"]]
    results["ratios"] = speed.ratios(inverse, triples, plan.stopwatch)
    results["speed"] = speed.throughput(exact.geometry, triples, edge.points.points, plan.stopwatch, plan.sizes)
    results["functions"] = speed.function_costs(exact.geometry, triples, plan.stopwatch)


def targets(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Return each target with what was measured and whether it is met."""
    rows = {row["name"]: row for row in results["inverse"]}
    sets = [each["name"] for each in results["sets"]]
    plain = [rows[name]["sets"] for name in OURS if name != PRECISE]
    outside = [each["name"] for each in results["reach"]["sets"][:-1]]
    inside = results["reach"]["sets"][-1]["name"]
    decisions = [results["reach"]["solvers"][name] for name in OURS]
    largest_size = max(results["speed"]["Delta.inverse"], key=int)
    peer, ratio = fastest_peer(results, "one")
    array_peer, array_ratio = fastest_peer(results, "array")
    precise = max(rows[PRECISE]["sets"][name]["max"] for name in sets)
    beyond, within = sum(row[name] for row in decisions for name in outside), sum(row[inside] for row in decisions)
    return [
        at_most("interior, largest error", max(row["interior"]["max"] for row in plain), 8e-16, "rad"),
        at_most("boundary, largest error", max(row["boundary"]["max"] for row in plain), 4e-16, "rad"),
        at_most("every set, largest error with precise=True", precise, 4e-16, "rad"),
        at_most("points outside called reachable", beyond, 0.0, ""),
        at_most("points inside called unreachable", within, 0.0, ""),
        at_most("FK of IK, largest distance", results["round_trip"]["Delta.inverse"]["max"], 5e-16, "m"),
        at_most("one point, ScalarDelta.inverse", rows[SCALAR]["one_us"], 5.0, "µs"),
        at_least(f"one point, {peer} against ScalarDelta", ratio, 25.0, "times"),
        at_least(f"array, {array_peer} against Delta.inverse", array_ratio, 25.0, "times"),
        at_least("array, full solve", results["speed"]["Delta.inverse"][largest_size], 3e6, "poses/s"),
    ]


def fastest_peer(results: dict[str, Any], kind: str) -> tuple[str, float]:
    """Return the general solver nearest to ours, for single calls ("one") or arrays, and its ratio; NaN if none."""
    ratios = {name: row[kind] for name, row in results["ratios"].items() if row[kind] is not None}
    name = min(ratios, key=lambda each: ratios[each], default="")
    return (name, ratios[name]) if name else ("a general solver", math.nan)
