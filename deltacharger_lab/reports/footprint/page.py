# SPDX-License-Identifier: Apache-2.0
"""The page of the footprint's report."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.footprint.process import LIBRARIES
from deltacharger_lab.reports.page_text import prose, table

_COLUMNS = (
    ("processes", "processes", 0),
    ("threads", "threads", 0),
    ("says ready, s", "says_ready_s", 1),
    ("found, s", "ready_s", 1),
    ("PSS, MB", "pss_mb", 0),
    ("RSS, MB", "rss_mb", 0),
    ("CPU at rest, %", "rest_percent", 1),
    ("docking, %", "docking_percent", 1),
    ("docking, s", "docking_s", 1),
)
_RATES = (
    ("tactile_frame at rest, Hz", "rest_tactile_frame_hz", 1),
    ("docking, Hz", "docking_tactile_frame_hz", 1),
    ("servo_state at rest, Hz", "rest_servo_state_hz", 1),
    ("docking, Hz", "docking_servo_state_hz", 1),
)


def write_page(results: dict[str, Any], path: Path) -> None:
    """Write the page."""
    parts = (_head, _targets, _costs, _rates, _libraries, _left_out)
    path.write_text("\n\n".join(block for part in parts for block in part(results)) + "\n", "utf-8")


def _head(results: dict[str, Any]) -> Iterator[str]:
    where = results["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in where["versions"].items())
    yield "# Footprint: what a charger costs a computer"
    yield prose(
        f"Written on {results['date']} by `{results['command']}` in {results['elapsed_s'] / 60.0:.1f} min, on "
        f"{where['processor']} with {where['cores']} cores (load {where['load']:.1f} at the start, niceness "
        f"{where['nice']}), {where['system']}, Python {where['python']}; {versions}. No charger of the paper was at "
        "hand: a scene on hardware runs against emulated servos and an emulated board, with the target of the scene "
        "`simulated`, on pseudo-terminals. They are processes of their own, and nothing of theirs is counted here."
    )


def _targets(results: dict[str, Any]) -> Iterator[str]:
    yield "## Targets"
    rows = []
    for each in results["targets"]:
        verdict = "not measured" if each["met"] is None else "met" if each["met"] else "**NOT MET**"
        measured = "–" if each["met"] is None else f"{each['measured']:.3g}"
        rows.append((each["name"], each["wanted"], measured, each["unit"], verdict))
    yield table(("target", "wanted", "measured", "unit", "verdict"), rows)


def _costs(results: dict[str, Any]) -> Iterator[str]:
    yield "## Costs"
    many = results["repeats"] > 1
    spread = f"the median (lowest–highest) of {results['repeats']} runs" if many else "that of a single run"
    yield prose(
        f"""Each figure is {spread}; scenes and ways take turns. *One process* is `deltacharger up`; *separate
        processes* is one for each node, started at once with the scene's parameters, as launch does (launch itself and
        what it costs are not in it). Simulated hardware belongs to a simulated scene: it runs in the one process, or
        as one of the separate ones, and costs what it costs."""
    )
    yield prose(
        f"""**Says ready**: from the start of the command until `deltacharger up` says so: its actions answer. Of this,
        3.3 s look for a charger that runs already. **Found**: until a client in another process, there before, finds
        both actions and the topics that they need, or of a scene that serves no goal all its nodes; what DDS takes to
        find processes is in it, in steps of half a second. **PSS** counts memory that processes share once, in
        parts, also what the charger shares with the process that measures; **RSS** counts it in each, and of one
        process it is what it takes on a computer of its own. Both are read after the docking. **CPU**: processor time
        of all processes in {results["rest_s"]:g} s at rest and from goal to charging, in % of one core, with a client
        in another process that listens to `tactile_frame` and `servo_state`."""
    )
    head = ("scene", "started as", *(name for name, _, _ in _COLUMNS))
    yield table(head, [_row(row, _COLUMNS) for row in results["rows"]])
    for row in results["rows"]:
        if row["dockings_failed"]:
            failed = f"{row['dockings_failed']} of {row['runs']} dockings"
            yield prose(f"*{row['scene']}, {row['way']}: {failed} failed: {row['docking_problem']}*")


def _rates(results: dict[str, Any]) -> Iterator[str]:
    yield "## Rates meanwhile"
    yield "Messages that reached that client, per second of their own stamps; the driver aims at 120 and 100 Hz."
    head = ("scene", "started as", *(name for name, _, _ in _RATES))
    yield table(head, [_row(row, _RATES) for row in results["rows"]])


def _libraries(results: dict[str, Any]) -> Iterator[str]:
    yield "## Libraries"
    yield prose(
        f"""Looked for: {", ".join(LIBRARIES)}. A library counts as loaded where a process has a file of it in its
        memory (/proc/PID/maps, read after the docking), or had a module of it when it ended (every process tells its
        `sys.modules` then, which also finds those in plain Python)."""
    )
    absent = [name for name in LIBRARIES if name not in results["installed"]]
    if absent:
        yield f"Not installed on this computer: {', '.join(absent)}."
    rows = []
    for row in results["rows"]:
        others = [name for name in results["installed"] if name not in row["libraries"]]
        rows.append((row["scene"], row["way"], ", ".join(row["libraries"]) or "none", ", ".join(others) or "none"))
    yield table(("scene", "started as", "loaded", "not imported"), rows)


def _left_out(results: dict[str, Any]) -> Iterator[str]:
    if results["left_out"]:
        yield "## What was left out"
        yield table(("what", "why"), [(name, _cell(why)) for name, why in results["left_out"].items()])


def _row(row: dict[str, Any], columns: tuple[tuple[str, str, int], ...]) -> tuple[str, ...]:
    return (row["scene"], row["way"], *(_figure(row[key], digits) for _, key, digits in columns))


def _figure(values: list[float], digits: int) -> str:
    middle, low, high = ("–" if math.isnan(value) else f"{value:.{digits}f}" for value in values)
    return middle if low == high else f"{middle} ({low}–{high})"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
