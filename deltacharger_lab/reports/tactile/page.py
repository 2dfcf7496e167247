# SPDX-License-Identifier: Apache-2.0
"""The page of the tactile report: tables and sentences made from its figures alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.page_text import prose, table
from deltacharger_lab.reports.tactile import pictures
from deltacharger_lab.reports.tactile.plan import TARGETS, kind, title
from deltacharger_lab.reports.tactile.splits import BY_FRAME, ROWS, SPLITS

_CAPTIONS = {
    pictures.ANGLE: "Accuracy and execution time for the angle, simulated data",
    pictures.POSITION: "Accuracy for vertical and horizontal, simulated data",
    pictures.ERROR_TIME: "Error against prediction time, simulated data",
    pictures.SHIFTS: "Coverage and drift check under shifts, simulated data",
    pictures.RELIABILITY: "Reliability diagrams, simulated data",
    pictures.CONFUSION: "Confusion matrices, simulated data",
}
_FROZEN = "the generator was fitted once so that this figure comes out near the paper's"
_PAPER = (
    ("CNN, angle", "95.46 %", ("accuracy", "cnn", "angle"), _FROZEN),
    ("CNN, vertical", "98.2 %", ("accuracy", "cnn", "vertical"), _FROZEN),
    ("CNN, horizontal", "86.9 %", ("accuracy", "cnn", "horizontal"), _FROZEN),
    ("NN, horizontal", "87.9 %", ("accuracy", "nn", "horizontal"), _FROZEN),
    ("CNN, execution", "38 ms", ("time", "cnn", "angle"), "another computer; ours runs on numpy, one frame pair"),
    ("forest, learning", "0.017 s", ("fit", "forest", "angle"), "the number of trees is not told; ours has 100"),
    ("NN, learning", "6.597 s", ("fit", "nn", "angle"), "another computer and other widths, which are not told"),
)


def write_page(results: dict[str, Any], path: Path) -> None:
    """Write the page of `results` to `path`.

    Raises:
        OSError: the file cannot be written.
    """
    parts = (_head, _targets, _figures, _paper, _models, _splits, _shifts, _reliability, _cost, _ceiling, _method)
    blocks = [block for part in parts for block in part(results)]
    path.write_text("\n\n".join(blocks) + "\n", encoding="utf-8")


def _head(results: dict[str, Any]) -> list[str]:
    machine = results["machine"]
    used = ", ".join(f"{name} {version}" for name, version in machine["versions"].items())
    blocks = [
        "# Tactile perception: the paper's comparison, redone on simulated data",
        prose(
            f"""**Every figure, table and picture on this page is of simulated data**, generator
            parameters `{results["digest"]}`: the paper's data are not public. Written on {results["date"]} by
            `{results["command"]}` in {results["elapsed_s"] / 60.0:.1f} min, on {machine["processor"]} with
            {machine["cores"]} cores (load {machine["load"]:.1f} at the start), {machine["system"]}, Python
            {machine["python"]}; {used}. Rigs {_list(results["rigs"])}, seeds {_list(results["seeds"])}. Nothing was
            tuned on these rigs."""
        ),
    ]
    if results["quick"]:
        blocks.append("This is a quick look: one rig, one seed, few models; no intervals.")
    missing = [f"- {name}: {reason}" for name, reason in results["absent"].items()]
    missing += [f"- picture {name}: {reason}" for name, reason in results["missing_pictures"].items()]
    return [*blocks, *(["Absent from this run:", "\n".join(missing)] if missing else [])]


def _targets(results: dict[str, Any]) -> list[str]:
    rows = [
        (each["name"], each["wanted"], _number(each["measured"]), each["unit"], _verdict(each["met"]))
        for each in results["targets"]
    ]
    return ["## Targets", table(("simulated data", "wanted", "measured", "unit", "verdict"), rows)]


def _verdict(met: bool | None) -> str:
    return "not measured" if met is None else ("met" if met else "**NOT MET**")


def _figures(results: dict[str, Any]) -> list[str]:
    return [
        "## The paper's two figures",
        _picture(results, pictures.ANGLE),
        _picture(results, pictures.POSITION),
    ]


def _paper(results: dict[str, Any]) -> list[str]:
    rows = []
    for name, theirs, where, why in _PAPER:
        rows.append((name, theirs, _ours(results, *where), why))
    shallow = [name for name in results["models"] if kind(name) == "shallow"]
    if shallow:
        best = max(shallow, key=lambda name: results["accuracy"][name]["angle"]["mean"])
        why = "as in the paper" if best == "forest" else "near-equal patterns of one simulated rig suit it"
        rows.append(("best shallow model for the angle", "RF", title(best), why))
    paper = [name for name in results["models"] if kind(name) != "physical"]
    if "cnn" in paper:
        slow = max(paper, key=lambda name: results["times"][name]["angle"]["median_ms"])
        why = "as in the paper" if slow == "cnn" else "on numpy many trees walk slower than few small convolutions"
        rows.append(("slowest to execute", "CNN", title(slow), why))
    return [
        "## Paper and ours",
        table(("", "paper", "ours, simulated data", "why different, or not"), rows),
        "That the networks' accuracies agree is how the generator was fitted, not evidence that it is right.",
    ]


def _ours(results: dict[str, Any], what: str, name: str, target: str) -> str:
    if name not in results["models"]:
        return "not measured"
    entry = results["accuracy"][name][target]
    if what == "accuracy":
        return _percent(entry)
    if what == "fit":
        return f"{entry['fit_s']:.3g} s"
    return f"{results['times'][name][target]['median_ms']:.2g} ms"


def _models(results: dict[str, Any]) -> list[str]:
    rows = []
    for name in results["models"]:
        entry, times = results["accuracy"][name], results["times"][name]["angle"]
        cells = [_percent(entry[target]) for target in TARGETS]
        rows.append((title(name), *cells, f"{entry['angle']['fit_s']:.2g}", _milliseconds(times)))
    head = ("simulated data", *(f"{target}, %" for target in TARGETS), "learning, s", "one prediction, ms")
    return [
        "## All models",
        prose(
            """Accuracy in % on the third of the dockings that learning did not see, each third in turn (600 angle and
            500 position pairs of each rig, 67/33 by docking), mean over rigs and seeds ± half the 95 % interval
            (Student's t over the rigs' means). Learning and prediction for the angle; prediction runs on numpy, one
            frame pair, median and 99th percentile. LDA sees physical features; pose, the default, also the packaged
            model's estimate of the pose, and readings from 0.25 N on instead of 1 N. Learning times are medians while
            two processes work."""
        ),
        table(head, rows),
    ]


def _splits(results: dict[str, Any]) -> list[str]:
    names = list(dict.fromkeys(row["model"] for row in results["splits"]))
    by_split = {(row["model"], row["target"], row["split"]): row["accuracy"] for row in results["splits"]}
    rows = [
        (f"{title(name)}, {target}", *(_share(by_split[name, target, split]) for split in SPLITS))
        for name in names
        for target in TARGETS
    ]
    return [
        "## How data are split",
        prose(
            f"""**The random split flatters**: with {ROWS} rows of each docking it puts rows of one docking on both
            sides, so that a model recognises the docking instead of the pose. The column "{BY_FRAME}" is no measure of
            anything that a charger will meet. Data of several rigs together, accuracy in %; the paper has one row of
            each docking, for which by docking and by frame are the same. The simulated sets are docked in the order of
            their poses, so that a session holds few of them: leaving one out asks for poses of that rig which learning
            hardly saw, and can be harder than leaving out a rig."""
        ),
        table(("simulated data", *SPLITS), rows),
    ]


def _shifts(results: dict[str, Any]) -> list[str]:
    small, large = results["windows"]
    head = (
        *("simulated data", "target", "accuracy", "coverage", "acted on", "frames that drift"),
        *(f"windows of {small}", f"windows of {large}", "verdict"),
    )
    blocks = [
        "## When something changes",
        prose(
            f"""Models learn and are calibrated on a rig as it was; then the same poses are docked anew with one thing
            changed. Coverage: share of frames whose conformal set (nominal 95 %) holds the truth. Acted on: one class
            alone in the set, and no drift. The drift check looks at single frames and at windows of dockings; slow
            changes show in a window alone. Verdict: *coverage holds* within 1.5 points and two standard errors, else
            *drift check fires* on more than half of the frames or of the windows of {large} dockings, else
            **NEITHER**. All in %."""
        ),
        _picture(results, pictures.SHIFTS),
    ]
    for name in results["judged"]:
        rows = [_shift_row(row) for row in results["shifts"] if row["model"] == name]
        blocks += [f"### {title(name)}", table(head, rows)]
    return blocks


def _shift_row(row: dict[str, Any]) -> tuple[str, ...]:
    shares = (row["accuracy"], row["coverage"], row["act_rate"], row["drift_rate"], *row["windows"])
    verdict = f"**{row['verdict']}**" if row["verdict"].isupper() else row["verdict"]
    return (row["shift"], row["target"], *(_share(each) for each in shares), verdict)


def _reliability(results: dict[str, Any]) -> list[str]:
    return [
        "## Reliability and confusion",
        "Of dockings that learning did not see, on the same rigs.",
        _picture(results, pictures.RELIABILITY),
        _picture(results, pictures.CONFUSION),
    ]


def _cost(results: dict[str, Any]) -> list[str]:
    return ["## Error against prediction time", _picture(results, pictures.ERROR_TIME)]


def _ceiling(results: dict[str, Any]) -> list[str]:
    rows = [(row["name"], row["about"], *(_share(row[target]) for target in TARGETS)) for row in results["ceiling"]]
    blocks = [
        "## One docking and several",
        prose(
            """What one docking tells at best is estimated by learning from much data of the same rig. More dockings
            at one commanded pose are fused by multiplying the probabilities of their classes. Accuracy in %, on
            dockings that learning did not see; the hole is the paper's own idea, in the middle of each ridge."""
        ),
        table(("simulated data", "", *TARGETS), rows),
    ]
    top = next((row for row in results["ceiling"] if row["name"].startswith("ceiling")), None)
    if top:
        shares = [
            (title(name), *(_share(results["accuracy"][name][each]["mean"] / top[each]) for each in TARGETS))
            for name in results["models"]
        ]
        blocks += [
            "Share of that ceiling that each model reaches, in % (the ceiling is of fewer rigs; so it may be passed):",
            table(("simulated data", *TARGETS), shares),
        ]
    return blocks


def _method(results: dict[str, Any]) -> list[str]:
    return [
        "## How it was measured",
        prose(
            """Each rig is drawn anew by the contact generator (gains, offsets, a dead taxel, tilt, magnets, ridge) and
            docked by the paper's protocol. Models learn from 67 % of the dockings; conformal sets are calibrated on
            the other 33 % and judged on fresh dockings of the same rig. What looks familiar is learnt from all of
            them. Run times are taken last, with no other work of this report. `tactile.json` holds every single
            measurement under `raw`."""
        ),
    ]


def _picture(results: dict[str, Any], name: str) -> str:
    if name in results["pictures"]:
        return f"![{_CAPTIONS[name]}]({name})"
    return f"(No picture {name}: {results['missing_pictures'][name]})"


def _percent(entry: dict[str, Any]) -> str:
    text = f"{100.0 * entry['mean']:.1f}"
    return text if math.isnan(entry["half"]) else f"{text} ± {100.0 * entry['half']:.1f}"


def _milliseconds(times: dict[str, Any]) -> str:
    return f"{times['median_ms']:.2g}; {times['p99_ms']:.2g}"


def _share(value: float) -> str:
    return f"{100.0 * value:.1f}"


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    return f"{value:.0f}" if value == round(value) and abs(value) < 1e6 else f"{value:.3g}"


def _list(values: Sequence[Any]) -> str:
    return ", ".join(str(each) for each in values)
