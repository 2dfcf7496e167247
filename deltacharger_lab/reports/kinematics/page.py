# SPDX-License-Identifier: Apache-2.0
"""The page of the kinematics report: tables and sentences made from its figures alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.kinematics import pictures
from deltacharger_lab.reports.kinematics.solvers import POINT, PRECISE, SCALAR
from deltacharger_lab.reports.kinematics.speed import BATCH, NEAR_EDGE
from deltacharger_lab.reports.page_text import prose, table

_CAPTIONS = {
    pictures.ERROR_TIME: "Error of inverse kinematics against run time",
    pictures.EDGE: "Error of inverse kinematics toward the edge of reach",
    pictures.SPEED: "Poses per second by the size of the array",
    pictures.CONDITION: "Condition number in slices through the workspace",
    pictures.FORCE: "Newtons along z per ampere in slices through the workspace",
}


def write_page(results: dict[str, Any], path: Path) -> None:
    """Write the page of `results` to `path`.

    Raises:
        OSError: the file cannot be written.
    """
    parts = (_head, _targets, _inverse, _reach, _forward, _speed, _extremes, _robots, _workspace, _method)
    blocks = [block for part in parts for block in part(results)]
    path.write_text("\n\n".join(blocks) + "\n", encoding="utf-8")


def _head(results: dict[str, Any]) -> list[str]:
    machine = results["machine"]
    used = ", ".join(f"{name} {version}" for name, version in results["versions"].items() if version)
    blocks = [
        "# Kinematics: error against run time",
        prose(
            f"""Written on {results["date"]} by `{results["command"]}` in {results["elapsed_s"]:.0f} s, on
            {machine["processor"]} with {machine["cores"]} cores, {machine["system"]}, Python {machine["python"]};
            {used}. Every figure is from this run. Absolute times differ from machine to machine; errors, counts and
            ratios should not by much."""
        ),
    ]
    missing = [f"- {name}: {reason}" for name, reason in results["absent"].items()]
    missing += [f"- picture {name}: {reason}" for name, reason in results["missing_pictures"].items()]
    if missing:
        return [*blocks, "Absent from this run:", "\n".join(missing)]
    return [*blocks, "Nothing is absent from this run."]


def _targets(results: dict[str, Any]) -> list[str]:
    rows = [
        (each["name"], each["wanted"], _number(each["measured"]), each["unit"], _verdict(each["met"]))
        for each in results["targets"]
    ]
    return ["## Targets", table(("", "wanted", "measured", "unit", "verdict"), rows)]


def _verdict(met: bool | None) -> str:
    return "not measured" if met is None else ("met" if met else "**not met**")


def _inverse(results: dict[str, Any]) -> list[str]:
    names = [each["name"] for each in results["sets"]]
    head = ("", f"µs, array of {BATCH}", "µs, one call", *names)
    return [
        "## Inverse kinematics",
        prose(
            """Median and largest error in rad; in brackets the share of poses without an answer (*none*) and on the
            *wrong* knee, which do not count in the error. The error of a pose is that of its worst angle. The first
            four rows are this library; then closed forms as they are found elsewhere; then general solvers. All sets
            but the first reach behind the motors, where the first two closed forms take the other knee."""
        ),
        table(head, (_solver_row(row, names, "wrong") for row in results["inverse"])),
        _sets(results["sets"], results["seed"]),
        _picture(results, pictures.ERROR_TIME),
        _picture(results, pictures.EDGE),
    ]


def _solver_row(row: dict[str, Any], names: Sequence[str], other: str) -> tuple[str, ...]:
    cells = [_cell(row["sets"][name], other) for name in names]
    return (row["name"], _microseconds(row["array_us"]), _microseconds(row["one_us"]), *cells)


def _cell(entry: dict[str, Any], other: str) -> str:
    text = f"{_error(entry['median'])} / {_error(entry['max'])}"
    notes = [f"{_share(entry[key])} {key}" for key in ("none", other) if entry[key] > 0.0]
    return text + (f" ({', '.join(notes)})" if notes else "")


def _sets(sets: Iterable[dict[str, Any]], seed: int) -> str:
    rows = [(each["name"], each["about"], str(each["count"]), str(each["peer_count"])) for each in sets]
    return table((f"set, seed {seed}", "points", "count", "of these for general solvers"), rows)


def _reach(results: dict[str, Any]) -> list[str]:
    reach = results["reach"]
    names = [each["name"] for each in reach["sets"]]
    rows = [
        (solver, *(f"{counts[name]} of {counts[f'{name} count']}" for name in names))
        for solver, counts in reach["solvers"].items()
    ]
    head = ("", *(f"{name}: called reachable" for name in names[:-1]), f"{names[-1]}: called unreachable")
    return [
        "## Within reach or not",
        prose(
            """How many points get the wrong answer to that question. A general solver says "reachable" where its rods
            close to 1e-12 m."""
        ),
        table(head, rows),
        _sets(reach["sets"], results["seed"]),
    ]


def _forward(results: dict[str, Any]) -> list[str]:
    names = list(results["forward"][0]["sets"])
    trips = [
        (name, str(each["count"]), _error(each["median"]), _error(each["max"]))
        for name, each in results["round_trip"].items()
    ]
    head = ("", f"µs, array of {BATCH}", "µs, one call", *names)
    return [
        "## Forward kinematics",
        prose(
            """Median and largest distance in m from the exact position of the same arm angles, which are those of the
            sets above; *mirrored* is the share of answers on the other side of the elbows. Near type 2 the position
            answers to rounding of the angles, whatever the form."""
        ),
        table(head, (_solver_row(row, names, "mirrored") for row in results["forward"])),
        f"There and back, |FK(IK(p)) − p| in m over the workspace box, seed {results['seed']}:",
        table(("inverse by", "points", "median", "largest"), trips),
    ]


def _speed(results: dict[str, Any]) -> list[str]:
    sizes = list(results["speed"]["Delta.inverse"])
    rows = [
        (name, *(_millions(row[size]) if size in row else "–" for size in sizes))
        for name, row in results["speed"].items()
    ]
    functions = [
        (name, _microseconds(each["scalar_us"]), _microseconds(each["point_us"]), _microseconds(each["array_us"]))
        for name, each in results["functions"].items()
    ]
    ours = {row["name"]: row for row in results["inverse"]}
    blocks = [
        "## Run time",
        prose(
            f"""Process time, medians of repeats in one run. Million poses per second by the number of points in one
            call; `Delta` gives status and margin too, and "{NEAR_EDGE}" takes the boundary set:"""
        ),
        table(("points in one call", *sizes), rows),
        _picture(results, pictures.SPEED),
        prose(
            f"""One point costs {_microseconds(ours[SCALAR]["one_us"])} µs with `ScalarDelta.inverse` (angles only),
            {_microseconds(ours[POINT]["one_us"])} µs with `Delta.inverse` (with status and margin) and
            {_microseconds(ours[PRECISE]["one_us"])} µs with `precise=True`. µs per point of the library's functions:"""
        ),
        table(("", "ScalarDelta", "Delta, one point", f"Delta, array of {BATCH}"), functions),
    ]
    if results["ratios"]:
        head = ("", "one call, against ScalarDelta.inverse", f"array of {BATCH}, against Delta.inverse")
        times = [(name, _ratio(row["one"]), _ratio(row["array"])) for name, row in results["ratios"].items()]
        blocks += ["How many times as long general solvers take, both timed in turns:", table(head, times)]
    return blocks


def _extremes(results: dict[str, Any]) -> list[str]:
    rows = []
    for each in results["extremes"]:
        margin = "" if each["status"] == "" or each["unit"] == "m" else _number(each["margin"])
        error = f"{_error(each['error'])} {each['unit']}" if _known(each["error"]) else ""
        trip = _error(each["round_trip"]) if _known(each["round_trip"]) else ""
        verdict = "as wanted" if each["ok"] else f"**{each['remark']}**"
        rows.append((each["name"], each["answer"], each["status"], margin, error, trip, verdict))
    return [
        "## Extreme inputs",
        prose(
            """Each input goes through the single call and through an array; both must agree in status and numbers, and
            numpy must not warn. The round trip is the exact forward kinematics of the angles that came back."""
        ),
        table(("input", "answer", "status", "margin", "error", "round trip, m", "verdict"), rows),
    ]


def _robots(results: dict[str, Any]) -> list[str]:
    rows = []
    for each in results["robots"]:
        errors = (_error(each[key]) for key in ("array", "point", "precise"))
        trip = f"{_error(each['round_trip_median'])} / {_error(each['round_trip_max'])}"
        counts = (str(each["count"]), str(each["edge_count"]))
        rows.append((each["name"], *counts, *errors, str(each["wrong_decisions"]), trip, str(each["round_trips"])))
    head = (
        *("robot", "points", "at the edge", "array, rad", "one point, rad", "precise, rad"),
        *("wrong on reach", "round trip", "of points"),
    )
    return [
        "## Extreme robots",
        prose(
            f"""Largest error of inverse kinematics, on points that random arm angles lead to and on points exactly
            known to lie just inside or outside the edge of reach (1e-17 to 1e-3 m for the default robot, in proportion
            for others); *wrong on reach* counts answers and margins that take one side for the other. Round trip:
            median and largest |FK(IK(p)) − p| as a share of arm + rod, over the points of the first kind that belong to
            the robot's own assembly; it grows near type 2. Unless named, lengths are the default ones. Seed
            {results["seed"]}."""
        ),
        table(head, rows),
    ]


def _workspace(results: dict[str, Any]) -> list[str]:
    box = results["workspace"]
    return [
        "## Workspace",
        prose(
            f"""On a grid of {box["count"]} points of the workspace box {_share(box["reachable"])} are reachable. The
            condition number of the Jacobian is {box["condition_median"]:.2f} in the median and
            {box["condition_max"]:.2f} at most. One ampere of the most loaded servo presses along z with
            {box["force_min"]:.1f} to {box["force_max"]:.1f} N, {box["force_median"]:.1f} N in the median, friction and
            weight aside."""
        ),
        _picture(results, pictures.CONDITION),
        _picture(results, pictures.FORCE),
    ]


def _method(results: dict[str, Any]) -> list[str]:
    peers = "\n".join(f"- {name}: {setup}." for name, setup in results["peers"].items())
    return [
        "## How it was measured",
        prose(
            f"""Reference: the same equations in {results["digits"]} digits (mpmath); the doubles of points, angles and
            lengths count as exact, cos and sin of 120° as −1/2 and ±√3/2. The distance to the edge of reach is exact:
            rod minus the distance to the nearest point of the elbow's circle, or the distance to its farthest point
            minus rod; points are moved by units in the last place until theirs is the one wanted. Closed forms run in
            numpy for arrays and in plain floats for single calls, with errors from the arrays. Every general solver
            starts each pose from level arms; its answer counts where the rods close to 1e-9 m."""
        ),
        peers or "No general solver was present.",
    ]


def _picture(results: dict[str, Any], name: str) -> str:
    if name in results["pictures"]:
        return f"![{_CAPTIONS[name]}]({name})"
    return f"(No picture {name}: {results['missing_pictures'][name]})"


def _known(value: float | None) -> bool:
    return value is not None and not math.isnan(value)


def _error(value: float | None) -> str:
    return "–" if value is None or math.isnan(value) else f"{value:.1e}"


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "NaN" if math.isnan(value) else f"{value:g}".replace("-", "−")
    return f"{value:.0f}" if value == round(value) and abs(value) < 1e6 else f"{value:.3g}"


def _share(value: float) -> str:
    percent = 100.0 * value
    return f"{percent:.0f} %" if percent >= 10.0 or percent == 0.0 else f"{percent:.2g} %"


def _ratio(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def _microseconds(value: float | None) -> str:
    return "–" if value is None else (f"{value:.0f}" if value >= 100.0 else f"{value:.3g}")


def _millions(value: float) -> str:
    return f"{value / 1e6:.3g}"
