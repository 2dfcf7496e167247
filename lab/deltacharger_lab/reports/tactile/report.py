# SPDX-License-Identifier: Apache-2.0
"""Measures the classifiers of misalignment and writes the report: figures as JSON, a page, pictures."""

import math
import tempfile
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_bringup.records.replay.picture import BLUE, FAINT, GREEN, INK, ORANGE
from deltacharger_lab.plotting import Axes, note, picture, plain_ticks, top_legend
from deltacharger_lab.reports import formats, pool
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most, none
from deltacharger_lab.reports.tactile import second
from deltacharger_lab.reports.tactile.measure import BINS, NONE, WINDOWS, judge_rig, timing
from deltacharger_lab.reports.tactile.plan import KINDS, SETS, TARGETS, TactilePlan, absent, default, kind, title
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_lab.training.reliability import NOMINAL
from deltacharger_tactile.parameters import TactileParameters

COLOURS = {"shallow": ORANGE, "deep": BLUE, "physical": GREEN}
_PAPER = {"angle": ("cnn", 95.46), "vertical": ("cnn", 98.2), "horizontal": ("nn", 87.9)}
_ABOUT = "simulated data; "


def _angle(results: dict[str, Any], path: Path) -> None:
    about = (
        _ABOUT + "above: mean and 95 % interval over rigs; below: one prediction on numpy, median and 99th percentile"
    )
    with picture(path, 9.0, 6.4, "Angle: accuracy and execution time", about) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        _bars(above, results, "angle")
        times = [results["times"][name]["angle"] for name in results["models"]]
        median, slow = (np.array([each[key] for each in times]) for key in ("median_ms", "p99_ms"))
        _labelled_bars(below, results, median, 0.0 * median, slow - median, "%.2f")
        below.axhline(38.0, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
        note(below, "paper's CNN, 38 ms", (-0.3, 38.0), (0, 3), ha="left", color=FAINT)
        below.set(yscale="log", ylim=(0.005, 150.0), ylabel="ms, log scale")
        _legend(figure)


def _position(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "mean and 95 % interval over rigs"
    with picture(path, 9.0, 6.4, "Vertical and horizontal: accuracy", about) as figure:
        panels = figure.subplots(2, 1, sharex=True)
        for axes, target in zip(panels, TARGETS[1:], strict=True):
            _bars(axes, results, target)
            axes.set_title(target)
        _legend(figure)


def _bars(axes: Axes, results: dict[str, Any], target: str) -> None:
    found = [results["accuracy"][name][target] for name in results["models"]]
    mean, half = (100.0 * np.array([each[key] for each in found]) for key in ("mean", "half"))
    half = np.nan_to_num(half)  # of a single rig
    _labelled_bars(axes, results, mean, half, np.minimum(half, 100.0 - mean), "%.1f")
    bottom = max(0.0, 10.0 * np.floor(((mean - half).min() - 4.0) / 10.0))
    owner, value = _PAPER[target]
    axes.axhline(value, color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)), zorder=0.8)
    text = f"paper's {title(owner)}, {value:g} %"
    note(axes, text, (1.0, 1.0), (0, 3), xycoords="axes fraction", ha="right", color=FAINT)
    axes.set(ylim=(bottom, 100.0 + 0.08 * (100.0 - bottom)), ylabel="accuracy, %")


def _labelled_bars(axes: Axes, results: dict[str, Any], height: Any, below: Any, above: Any, form: str) -> None:
    """Draw a bar of each model with its height written above, and its interval."""
    names = results["models"]
    colours = [COLOURS[kind(name)] for name in names]
    bars = axes.bar(range(len(names)), height, 0.66, color=colours, yerr=(below, above), ecolor=INK, capsize=3.0)
    axes.bar_label(bars, fmt=form, padding=2.0, fontsize=8.5)
    axes.set_xticks(range(len(names)), [title(name) for name in names])


def _legend(figure: Any) -> None:
    from matplotlib.patches import Patch

    top_legend(figure, [Patch(color=COLOURS[name], label=text) for name, text in KINDS.items()])


def _error_time(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "mean error rate over rigs against the median time of one prediction on numpy"
    with picture(path, 11.0, 4.8, "Error against prediction time", about) as figure:
        panels = figure.subplots(1, 3)
        for axes, target in zip(panels, TARGETS, strict=True):
            points = []
            for name in results["models"]:
                time = results["times"][name][target]["median_ms"]
                error = max(100.0 * (1.0 - results["accuracy"][name][target]["mean"]), 0.05)
                axes.plot(time, error, marker="o", markersize=7, color=COLOURS[kind(name)], linestyle="none")
                points.append((time, error, title(name)))
            axes.set(xscale="log", yscale="log", ylim=_reach([error for _, error, _ in points]))
            axes.margins(x=0.22)
            axes.set(title=target, xlabel="ms, log scale")
            plain_ticks(axes)
            axes.xaxis.set_minor_formatter("")  # labels between the decades of a short axis would overlap
            _label_points(figure, axes, points)
        panels[0].set_ylabel("wrong class, %, log scale")
        _legend(figure)


def _reach(values: list[float]) -> tuple[float, float]:
    """Return limits of a logarithmic axis with room around values; zero is drawn as a small value."""
    least = min((value for value in values if value > 0.0), default=0.1)
    return 0.6 * least, 1.7 * max(*values, least)


def _label_points(figure: Any, axes: Axes, points: list[tuple[float, float, str]]) -> None:
    """Name points beside them, each where the fewest labels and points are."""
    from matplotlib.transforms import Bbox

    figure.draw_without_rendering()  # settles the scales
    taken = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in axes.transData.transform([each[:2] for each in points])]
    directions = ((1, 0), (0, 1), (0, -1), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1))
    for time, error, text in points:
        label = axes.annotate(text, (time, error), (0, 0), textcoords="offset points", ha="center", va="center")
        label.set_in_layout(False)
        half = 0.5 * label.get_window_extent().width * 72.0 / figure.dpi

        def cost(place: tuple[float, float], label: Any = label) -> float:
            label.set_position(place)
            box = label.get_window_extent()
            inside = axes.bbox.contains(*box.min) and axes.bbox.contains(*box.max)
            return float(box.count_overlaps(taken) + 2.0 * (not inside) + 1e-3 * np.hypot(*place))

        places = [(dx * (far + half), dy * far) for far in (8.0, 16.0, 26.0) for dx, dy in directions]
        label.set_position(min(places, key=cost))
        taken.append(label.get_window_extent())


def _shifts(results: dict[str, Any], path: Path) -> None:
    names = results["judged"]
    shifts = list(dict.fromkeys(row["shift"] for row in results["shifts"]))
    table = {(row["model"], row["target"], row["shift"]): row for row in results["shifts"]}
    about = _ABOUT + "coverage in % (nominal 95); grey: holds, blue: drift check fires, orange: NEITHER"
    colours = {"coverage holds": "#eceff2", "drift check fires": "#a9c9f8", "NEITHER": "#f0b45c"}
    width = max(9.0, 2.6 + 0.72 * 3 * len(names))
    with picture(path, width, 6.2, "Coverage and drift check under changes", about) as figure:
        figure.set_layout_engine("none")  # positions are fixed
        axes = figure.add_axes((2.35 / width, 0.03, 1.0 - 2.5 / width, 0.76))
        for column, (target, name) in enumerate((target, name) for target in TARGETS for name in names):
            for line, shift in enumerate(shifts):
                row = table[name, target, shift]
                colour = colours[row["verdict"]]
                axes.fill(
                    [column, column + 0.96, column + 0.96, column], [line, line, line + 0.94, line + 0.94], colour
                )
                axes.text(column + 0.48, line + 0.47, f"{100 * row['coverage']:.0f}", ha="center", va="center")
            axes.text(column + 0.48, -0.3, title(name), ha="center", fontsize=8.5)
        for index, target in enumerate(TARGETS):
            axes.text((index + 0.5) * len(names), -0.95, target, ha="center", fontweight="bold")
        axes.set_yticks([line + 0.47 for line in range(len(shifts))], shifts)
        axes.set(xticks=[], ylim=(len(shifts), -0.1), xlim=(0, 3 * len(names)), facecolor="white")
        axes.tick_params(length=0)
        for side in axes.spines.values():
            side.set_visible(False)


def _reliability(results: dict[str, Any], path: Path) -> None:
    names = results["judged"]
    about = _ABOUT + "unseen dockings of the same rigs; how often the winning class is right, by its probability"
    with picture(path, 10.0, 6.2, "Reliability", about) as figure:
        panels = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False, height_ratios=(3, 1))
        for column, name in enumerate(names):
            above, below = panels[:, column]
            above.plot([0, 1], [0, 1], color=FAINT, linewidth=1.0, linestyle=(0, (4, 3)))
            for number, (target, colour) in enumerate(zip(TARGETS, (BLUE, ORANGE, GREEN), strict=True)):
                found = results["diagrams"][name][target]
                count, sure, right = (np.array(found[key], dtype=float) for key in ("count", "sure", "right"))
                used = count >= 10  # fewer are not significant
                above.plot(sure[used] / count[used], right[used] / count[used], "o-", color=colour, markersize=5,
                           linewidth=1.3, label=target)  # fmt: skip
                places = (np.arange(BINS) + 0.25 * (number + 0.5) + 0.125) / BINS
                below.bar(places, np.maximum(count, 0.0), width=0.25 / BINS, color=colour)
            below.set(yscale="log", ylim=(1, None), xlabel="probability of the winner")
            above.set(title=title(name), xlim=(0.15, 1.02), ylim=(0.0, 1.03))
        panels[0, 0].set_ylabel("share that is right")
        panels[1, 0].set_ylabel("frames")
        top_legend(figure, panels[0, 0].get_legend_handles_labels()[0])


def _confusion(results: dict[str, Any], path: Path) -> None:
    names = results["judged"]
    about = _ABOUT + "rows: true class, columns: predicted class, % of the row; unseen dockings of the same rigs"
    ticks = {"angle": [str(each) for each in range(6)]}
    with picture(path, 9.5, 1.2 + 2.55 * len(names), "Confusion", about) as figure:
        panels = figure.subplots(len(names), 3, squeeze=False)
        for line, name in enumerate(names):
            for column, target in enumerate(TARGETS):
                axes = panels[line, column]
                matrix = np.array(results["diagrams"][name][target]["matrix"], dtype=float)
                shares = 100.0 * matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1.0)
                axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
                for (row, predicted), value in np.ndenumerate(shares):
                    if value >= 0.05:
                        text = f"{value:.0f}" if value >= 9.95 else f"{value:.1f}"
                        axes.text(predicted, row, text, ha="center", va="center", fontsize=8,
                                  color="white" if value > 55 else INK)  # fmt: skip
                words = ticks.get(target, ["−10", "−5", "0", "5", "10"])
                axes.set_xticks(range(len(words)), words)
                axes.set_yticks(range(len(words)), words)
                axes.set_title(f"{title(name)}, {target}, {'°' if target == 'angle' else 'mm'}", fontsize=9.5)
                axes.tick_params(length=0)
                axes.grid(visible=False)


PICTURES = {
    "tactile-angle.png": _angle,
    "tactile-position.png": _position,
    "tactile-error-time.png": _error_time,
    "tactile-shifts.png": _shifts,
    "tactile-reliability.png": _reliability,
    "tactile-confusion.png": _confusion,
}


HOLDS, FIRES, NEITHER = "coverage holds", "drift check fires", "NEITHER"
POINTS = 0.015
"""Allowed error of coverage."""
FALSE_ALARMS = 0.01
PAPER_FIGURES = (
    ("cnn", "angle", 95.46),
    ("cnn", "vertical", 98.2),
    ("cnn", "horizontal", 86.9),
    ("nn", "horizontal", 87.9),
)
"""The paper's accuracies of its networks, %."""
_OFTEN = 0.5  # share of frames or windows from which the drift check counts as firing

Row = dict[str, Any]
_LIBRARIES = ("numpy", "scikit-learn", "xgboost", "xgboost-cpu", "torch", "matplotlib")


def build(plan: TactilePlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, figures and pictures into `directory` and return the figures.

    Raises:
        ModuleNotFoundError: no training library is installed.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    if not plan.names:
        raise ModuleNotFoundError("no training library is installed", name="sklearn")
    report = Report("tactile", command, _LIBRARIES)
    results = report.results
    results |= {
        "simulated": True,
        "digest": TactileParameters().digest(),
        "rigs": list(plan.rigs),
        "seeds": list(plan.seeds),
        "quick": plan.quick,
        "windows": list(WINDOWS),
        "models": list(plan.names),
        "judged": list(plan.judged),
        "default": default(plan),
        "absent": absent(),
    }
    _measure(results, plan, progress)
    progress("pictures")
    report.draw(PICTURES, directory)
    results["targets"] = targets(results, plan)
    return report.write(
        directory,
        TARGETS=TARGETS,
        PAPER_FIGURES=PAPER_FIGURES,
        title=title,
        best=best,
        slowest=slowest,
        AXES=second.AXES,
        PHYSICS=(second.FIRST, second.SECOND),
    )


def _measure(results: dict[str, Any], plan: TactilePlan, progress: Progress) -> None:
    with tempfile.TemporaryDirectory() as kept:
        found = pool.work(tasks(plan, kept), progress)
        progress("run times, alone")
        times = pool.work([pool.ReportTask("run times", timing, (plan, kept))], progress)["run times"][0]
    rigs = found["rig"]
    raw = {key: pool.joined(each[key] for each in rigs) for key in ("accuracy", "shifts", "diagrams", "second")}
    results["accuracy"] = accuracies(raw["accuracy"], plan.names)
    results["shifts"] = shifts(raw["shifts"])
    results["diagrams"] = diagrams(raw["diagrams"])
    usual = [row for row in results["shifts"] if row["shift"] == NONE.name]
    raw |= {key: pool.joined(found[key]) for key in ("second estimates", "second variants")}
    results["second"] = {
        "digest": SecondParameters().digest(),
        "models": second.table(raw["second"], usual),
        "estimates": second.summed(raw["second estimates"], "threshold", "frames", "physics"),
        "variants": second.summed(raw["second variants"], "variant"),
    }
    results["trainers"] = {row["model"]: row for row in times["trainers"]}
    results["times"] = {
        name: {row["target"]: row for row in each} for (name,), each in formats.grouped(times["predictions"], "model")
    }
    results["generation_s"] = times["generation_s"]
    results["raw"] = raw


def tasks(plan: TactilePlan, kept: str) -> list[pool.ReportTask]:
    """Return all work except the run times, which need an idle computer."""
    found = []
    for rig in plan.rigs:
        for seed in plan.seeds:
            first = (rig, seed) == (plan.rigs[0], plan.seeds[0])
            for part in SETS:
                weight = len(SETS[part]) * (1.0 + 0.5 * len(plan.names))
                found.append(pool.ReportTask("rig", judge_rig, (rig, seed, part, plan, kept if first else ""), weight))
    for rig in plan.rigs:
        found.append(pool.ReportTask("second estimates", second.judge_estimates, (rig, plan.seeds[0], plan), 1.0))
    for rig in plan.variant_rigs:
        found.append(pool.ReportTask("second variants", second.judge_variants, (rig, plan.seeds[0], plan), 2.0))
    return found


def accuracies(rows: Iterable[Row], names: Iterable[str]) -> dict[str, dict[str, Row]]:
    """Return mean accuracy with the half width of its 95 % interval (t over rigs; NaN of one), by model and target."""
    found: dict[str, dict[str, Row]] = {name: {} for name in names}
    for (name, target), chosen in formats.grouped(rows, "model", "target"):
        means = [float(np.mean([row["accuracy"] for row in each])) for _, each in formats.grouped(chosen, "rig")]
        fit = float(np.median([row["fit_s"] for row in chosen]))
        found[name][target] = {"mean": float(np.mean(means)), "half": _half(means), "fit_s": fit}
    return found


def _half(values: list[float]) -> float:
    if len(values) < 2:
        return math.nan
    from scipy.stats import t

    return float(t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values)))


def shifts(rows: Iterable[Row]) -> list[Row]:
    """Return means over rigs and seeds by model, target and shift, with the verdict."""
    found = []
    for (model, target, shift), members in formats.grouped(rows, "model", "target", "shift"):
        means = {key: float(np.mean([row[key] for row in members])) for key in second.SHARES}
        windows = np.mean([row["windows"] for row in members], axis=0).tolist()
        error = _coverage_error(members)
        holds = means["coverage"] >= NOMINAL - POINTS - error
        fires = max(means["drift_rate"], windows[-1]) > _OFTEN
        verdict = HOLDS if holds else FIRES if fires else NEITHER
        where = {"model": model, "target": target, "shift": shift}
        found.append({**where, **means, "windows": windows, "error": error, "verdict": verdict})
    return found


def _coverage_error(members: list[Row]) -> float:
    """Return two standard errors of the mean coverage; below three members binomial, with calibration's error."""
    if len(members) >= 3:
        return 2.0 * float(np.std([row["coverage"] for row in members], ddof=1)) / math.sqrt(len(members))
    frames = members[0]["n"]
    return 2.0 * math.sqrt(NOMINAL * (1.0 - NOMINAL) * (1.0 + 3.0) / frames / len(members))


def diagrams(rows: Iterable[Row]) -> dict[str, dict[str, Row]]:
    """Return the sums over rigs and seeds, by model and target."""
    found: dict[str, dict[str, Row]] = defaultdict(dict)
    for (model, target), each in formats.grouped(rows, "model", "target"):
        keys = ("count", "sure", "right", "matrix")
        found[model][target] = {key: np.sum([row[key] for row in each], axis=0).tolist() for key in keys}
    return dict(found)


def best(figures: Row) -> str:
    """Return the shallow model with the best accuracy of the angle; '' for none."""
    shallow: list[str] = [name for name in figures["models"] if kind(name) == "shallow"]
    return max(shallow, key=lambda name: figures["accuracy"][name]["angle"]["mean"], default="")


def slowest(figures: Row) -> str:
    """Return the paper's model with the longest prediction of the angle."""
    paper: list[str] = [name for name in figures["models"] if kind(name) != "physical"]
    return max(paper, key=lambda name: figures["times"][name]["angle"]["median_ms"])


def _accuracy_targets(results: Row, name: str) -> list[Row]:
    """Return the targets of the paper's figures (within 1.5 points), and those of ours."""
    found = []
    for model, target, published in PAPER_FIGURES:
        if model in results["accuracy"]:
            off = abs(100.0 * results["accuracy"][model][target]["mean"] - published)
            found.append(at_most(f"{title(model)}, {target}, off the paper's {published:g} %", off, 1.5, "points"))
    for target, least in zip(TARGETS, (98.0, 98.5, 94.0), strict=True):
        own = 100.0 * results["accuracy"][name][target]["mean"]
        found.append(at_least(f"{title(name)}, {target}", own, least, "%"))
    return found


def _second_targets(found: Row) -> list[Row]:
    """Return the targets of the models on the physics that none has seen."""
    second_rows = [row["second"] for row in found["models"]]
    lost = [row for row in second_rows if row["coverage"] < NOMINAL - POINTS]
    unseen = [row for row in lost if max(row["drift_rate"], row["windows"][-1]) <= _OFTEN]
    missed = len(unseen) if second_rows else math.nan
    z, unsafe = second.worst_z(found["estimates"]), second.unsafe(found["estimates"], found["variants"])
    return [
        none("pretrained estimates, second physics and its families, unsafe acts", unsafe, ""),
        at_most("pretrained estimate, second physics, rms of error over σ, worst axis", z, second.BELIEVED, ""),
        at_most("judged models, second physics, neither covered nor noticed", missed, 0.0, f"of {len(second_rows)}"),
    ]


def targets(results: Row, plan: TactilePlan) -> list[Row]:
    """Return each target with its measured value and verdict."""
    name = default(plan)
    who = title(name)
    calm = [row for row in results["shifts"] if row["model"] == name and row["shift"] == NONE.name]
    others = [row for row in results["shifts"] if row["model"] == name and row["shift"] != NONE.name]
    worst = max((row["coverage"] for row in calm), key=lambda value: abs(value - NOMINAL), default=math.nan)
    alarms = max((max(row["drift_rate"], *row["windows"]) for row in calm), default=math.nan)
    slow = max(results["times"][name][target]["p99_ms"] for target in TARGETS)
    slowest_of_all = max(each[target]["p99_ms"] for each in results["times"].values() for target in TARGETS)
    unseen = [row for row in others if row["verdict"] == NEITHER]
    missed, off = len(unseen) if others else math.nan, 100.0 * abs(worst - NOMINAL)
    return [
        *_accuracy_targets(results, name),
        at_most(f"{who}, coverage off 95 %, no shift, worst target", off, 100.0 * POINTS, "points"),
        at_most(f"{who}, false drift alarms, frames and windows", 100.0 * alarms, 100.0 * FALSE_ALARMS, "%"),
        at_most(f"{who}, shifts neither covered nor noticed", missed, 0.0, f"of {len(others)}"),
        *_second_targets(results["second"]),
        at_most(f"{who}, one prediction, p99", slow, 0.5, "ms"),
        at_most("slowest model, one prediction, p99", slowest_of_all, 10.0, "ms"),
        at_most("paper-size data set of one rig", results["generation_s"], 1.0, "s"),
        at_most("run time of this report", results["elapsed_s"] / 60.0, 15.0, "min"),
    ]
