# SPDX-License-Identifier: Apache-2.0
"""The page of the simulation's report."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.page_text import prose, table
from deltacharger_lab.reports.simulation import summary as simulation_summary
from deltacharger_lab.reports.simulation.energy import PARTS
from deltacharger_lab.reports.simulation.map import DIVERGED, FORCE_OFF, MODULE, PATH_OFF, PROVEN
from deltacharger_lab.reports.simulation.pictures import NAMES
from deltacharger_lab.reports.simulation.scenes import LIGHT

_ALT = {
    NAMES[0]: "Path and force error against processor time of every model and step",
    NAMES[1]: "Path error over contact stiffness and step, with what diverged",
    NAMES[2]: "Energy over time, and what took it away",
    NAMES[3]: "One docking by every model: z and contact force over time",
}


def write_page(results: dict[str, Any], path: Path) -> None:
    """Write the page; the pictures lie beside it."""
    parts = (_head, _targets, _errors, _dockings, _map, _extremes, _energy, _order, _parts)
    path.write_text("\n\n".join(block for part in parts for block in part(results)) + "\n", "utf-8")


def _picture(results: dict[str, Any], name: str) -> str:
    if name in results["pictures"]:
        return f"![{_ALT[name]}]({name})"
    return f"*No picture {name}: {results['missing_pictures'][name]}.*"


def _head(results: dict[str, Any]) -> Iterator[str]:
    where = results["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in where["versions"].items())
    yield "# The simulated charger: error against run time, stability, energy"
    yield prose(
        f"Written on {results['date']} by `{results['command']}` in {results['elapsed_s'] / 60.0:.1f} min, on "
        f"{where['processor']} with {where['cores']} cores (load {where['load']:.1f} at the start), {where['system']}, "
        f"Python {where['python']}; {versions}. Nothing here has been checked against a real charger: models are "
        "compared with each other and with laws."
    )
    for name, reason in results["absent"].items():
        yield f"**{name} is absent**: {reason}."


def _targets(results: dict[str, Any]) -> Iterator[str]:
    yield "## Targets"
    yield table(
        ("target", "wanted", "measured", "unit", "verdict"),
        [
            (each["name"], each["wanted"], f"{each['measured']:.3g}", each["unit"], "met" if each["met"] else "NOT MET")
            for each in results["targets"]
        ],
    )


def _errors(results: dict[str, Any]) -> Iterator[str]:
    yield "## Error against run time"
    apart = results["references_apart_mm"]
    about = "" if apart is None else f" The two models' own tiny-step paths are {1000.0 * apart:.1f} µm rms apart."
    known = LIGHT if apart is None else results["models"][1]
    yield prose(
        f"""A docking of 1.2 s (approach, snap, push; commands every 0.1 s) on 1e5 N/m, with friction and weight.
        Path: rms distance every 10 ms (or every step) from that of {known} in steps of
        {1000.0 * results["reference_step"]:g} ms.{about} Settled force: without friction and weight, against a
        bisection of springs and magnets that has no integrator in it. Contact current: the same, against the
        reference. × real time: processor time of one core, the fastest of some runs, in motion and with a second of
        rest after it; the light model computes nothing at rest. MuJoCo's times contain the loop in Python that
        applies the magnets."""
    )
    times = {(row["model"], row["step"]): row for row in results["times"]}
    rows = []
    for row in results["errors"]:
        speed = times[row["model"], row["step"]]
        good = math.isfinite(row["rms_mm"]) and row["speed"] < 1e-3
        figures = (
            [f"{row['rms_mm']:.3g}", f"{row['force_percent']:+.2g}", f"{1000.0 * row['current_error']:+.2g}"]
            if good
            else ["diverged or restless", "", ""]
        )
        rows.append(
            (row["model"], f"{1000.0 * row['step']:g}", *figures, f"{speed['moving']:.0f}", f"{speed['all']:.0f}")
        )
    head = ("model", "step, ms", "path, mm rms", "force, %", "current, mA", "× real time, moving", "with rest")
    yield table(head, rows)
    yield _picture(results, NAMES[0])
    yield _picture(results, NAMES[3])
    low, high = _band(results)
    yield prose(
        f"""With friction the settled force is not one number: the gears hide up to 4.7 N, and where in that band a
        run ends depends on how it shakes on the way. Over all models that came to rest, at steps up to 10 ms, it
        ended between {low:.2f} and {high:.2f} N. That is what friction is, and no error of a step."""
    )


def _band(results: dict[str, Any]) -> tuple[float, float]:
    good = [row for row in results["errors"] if row["speed"] < 1e-3 and row["step"] <= 0.01]
    forces = [row["force_rubbing"] for row in good if row["force_rubbing"] > 0.0]
    return min(forces), max(forces)


def _dockings(results: dict[str, Any]) -> Iterator[str]:
    yield "### Whole dockings"
    yield prose(
        """The real state machine docks in virtual time, with pads, estimates and circuit, on targets that are offset
        and turned; the third of four is turned by 11° and must be refused. MuJoCo takes steps of 1 ms within
        those of the world. Codes in their order; seconds, contact current and misalignment at rest are means over those
        that charged; they scatter because pads and currents are noisy."""
    )
    yield table(
        ("model", "step, ms", "codes", "time, s", "current, A", "rest, mm", "energised shorts"),
        [
            (str(each["of"][0]), f"{1000.0 * each['of'][1]:g}", *_ends(each["runs"]))
            for each in simulation_summary.outcomes(results["dockings"], "model")
        ],
    )


def _ends(runs: list[dict[str, Any]]) -> tuple[str, str, str, str, str]:
    codes = ", ".join("charged" if run["code"] == "NONE" else run["code"] for run in runs)
    mean = simulation_summary.mean
    shorts = sum(run.get("shorts", 0) for run in runs)
    figures = (_number(mean(runs, "elapsed"), 1), _number(mean(runs, "current"), 3), _number(mean(runs, "rest_mm"), 2))
    return codes, *figures, str(shorts)


def _number(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def _map(results: dict[str, Any]) -> Iterator[str]:
    yield "## Stability map"
    yield prose(
        f"""Each point docks without friction and weight, which has one right force, and is then treated roughly with
        both: full speed against the target, sideways, limp, torn off. `{PROVEN}`: everything stayed finite and came
        to rest, the force within 0.5 %, the path within 0.3 mm rms of that of the finest step. `{PATH_OFF}`: the path
        is further off; `{FORCE_OFF}`: the force is; `{DIVERGED}`: diverged, or never came to rest. The package keeps
        the light model's map ({MODULE}) and warns where a world lies outside of what is proven."""
    )
    for name in results["models"]:
        points = [point for point in results["map"] if point["model"] == name]
        steps = sorted({point["step"] for point in points})
        cells = {(point["servo"], point["contact"], point["step"]): point["cell"] for point in points}
        rows = [
            (f"{servo:g}", f"{contact:.0e}".replace("e+0", "e"), *(cells[servo, contact, step] for step in steps))
            for servo, contact in sorted({key[:2] for key in cells})
        ]
        yield f"### {name}"
        lost = sum(point["cell"] == DIVERGED for point in points)
        worst = max((point["imbalance"] for point in points), default=0.0)
        left = f" No step left more than {worst:.0e} N unbalanced." if name == LIGHT else ""
        yield f"{lost} of {len(points)} points diverged.{left}"
        yield table(("servo, N·m/rad", "contact, N/m", *(f"{1000.0 * step:g} ms" for step in steps)), rows)
    yield _picture(results, NAMES[1])


def _extremes(results: dict[str, Any]) -> Iterator[str]:
    yield "## Extreme scenes"
    rows: dict[str, dict[str, Any]] = {}
    for row in results["extremes"]:
        entry = rows.setdefault(row["scene"], {"law": row["law"], "light": [], "other": "not measured", "about": ""})
        if row["model"] == LIGHT:
            entry["light"].append(f"{1000.0 * row['step']:g} {'kept' if row['ok'] else 'BROKEN'}")
            entry["about"] = row["about"] if row["step"] == 0.01 else entry["about"]
        else:
            entry["other"] = f"{'kept' if row['ok'] else 'BROKEN'}: {row['about']}"
    yield table(
        ("scene", "law", "light model, by step in ms", "light model at 10 ms", "MuJoCo at 1 ms"),
        [(name, row["law"], ", ".join(row["light"]), row["about"], row["other"]) for name, row in rows.items()],
    )


def _energy(results: dict[str, Any]) -> Iterator[str]:
    yield "## Energy"
    yield prose(
        """Nobody drives these chargers; their energy can only fall. Gain is the largest rise above the lowest value
        so far, in % of what there was to lose. The step itself takes away what backward Euler damps: it grows with
        the step, and a contact, which has no damper of its own, loses its bounce by it."""
    )
    yield table(
        ("scene", "step, ms", "to lose, mJ", "gain, %", *PARTS),
        [
            (
                row["scene"],
                f"{1000.0 * row['step']:g}",
                f"{1000.0 * row['released']:.3g}",
                f"{100.0 * row['gain'] / row['released']:.2g}",
                *(f"{100.0 * row['lost'][part] / sum(row['lost'].values()):.0f} %" for part in PARTS),
            )
            for row in results["energy"]
        ],
    )
    yield _picture(results, NAMES[2])


def _order(results: dict[str, Any]) -> Iterator[str]:
    yield "## Order of convergence"
    found = results["convergence"]
    steps = next(iter(found.values()))["steps"]
    yield prose(
        "Path error of the light model in mm rms against a tenth of the first step, and the slope of its logarithm; "
        "backward Euler has order 1. A snap and a contact, whose instants fall between steps, cost a little of it."
    )
    yield table(
        ("scene", *(f"{1000.0 * step:g} ms" for step in steps), "order"),
        [(name, *(f"{size:.3g}" for size in row["rms_mm"]), f"{row['order']:.2f}") for name, row in found.items()],
    )


def _parts(results: dict[str, Any]) -> Iterator[str]:
    yield "## What a scene leaves out"
    yield prose(
        """The same dockings with and without each part, steps of 10 ms. µs: one step of the world while it moves into
        contact, slides and comes to rest, the fastest of some runs in turn; where electrodes slide, the overlap of the
        bars is judged anew in every step, which is most of what sliding costs. kB: what a world holds. A part that is
        off is not computed: the first row is a world that knows none of the optional ones."""
    )
    ends = {each["of"]: each["runs"] for each in simulation_summary.outcomes(results["parts"], "part")}
    rows = []
    usual = results["costs"][0]["step_us"]
    for cost in results["costs"]:
        runs = ends.get(cost["part"])
        figures = (
            _ends(runs)[:4] if runs else ("not tried: dockings need the pads, or this is a first look", "", "", "")
        )
        shares = f"{cost['step_us']:.1f}", f"{cost['step_us'] / usual:.2f}", f"{cost['memory_kb']:.1f}"
        rows.append((cost["part"], *shares, *figures))
    yield table(("part", "µs", "× as delivered", "kB", "codes", "time, s", "current, A", "rest, mm"), rows)
    if results["imports"]:
        yield table(
            ("a fresh process imports", "s", "MB resident"),
            [(row["what"], f"{row['seconds']:.2f}", f"{row['memory_mb']:.0f}") for row in results["imports"]],
        )
