# SPDX-License-Identifier: Apache-2.0
"""Measures the electrode detector on simulated images and writes the report: figures as JSON, a page, pictures."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_bringup.records.replay.picture import BLUE, FAINT, ORANGE, RED
from deltacharger_core.arrays import Array
from deltacharger_lab.campaigns.summary import quantiles, upper_bound
from deltacharger_lab.plotting import note, picture, plain_ticks, top_legend
from deltacharger_lab.reports.pool import ReportTask, work
from deltacharger_lab.reports.report import Progress, Report, at_least, at_most
from deltacharger_lab.reports.vision import conditions, measure

FULL, QUICK = 150, 15
"""Images of a usual row."""
FIRST_SEED = 20_000
"""Tuning used seeds below 1000."""
_SEEDS_APART = 10_000
_CHUNK = 25  # images of one task
_TIMED = {False: 40, True: 8}
_SIZE_WEIGHT = {"320 × 200 px": 0.6, "1280 × 800 px": 3.0}


@dataclass(frozen=True)
class VisionPlan:
    """Extent of the measurement.

    Attributes:
        images: of a usual row.
        seed: shifts the seeds of all images.
        quick: whether this is the short plan.
        absent: by missing library, the reason and what is left out.
    """

    images: int
    seed: int
    quick: bool
    absent: dict[str, str]

    @property
    def first_seed(self) -> int:
        """Seed of the first image of every row."""
        return FIRST_SEED + _SEEDS_APART * self.seed

    def conditions(self) -> list[conditions.Condition]:
        """Return the rows that can be measured here."""
        return [
            each
            for each in conditions.CONDITIONS.values()
            if not (each.renderer == conditions.MUJOCO and "mujoco" in self.absent)
        ]

    def count(self, weight: float) -> int:
        """Return the images of a row."""
        return max(2, round(self.images * weight))

    def seeds(self, count: int) -> range:
        """Return the seeds of a row."""
        return range(self.first_seed, self.first_seed + count)

    def tasks(self) -> list[ReportTask]:
        """Return all work except the run times, which need an idle computer."""
        found = []
        for each in self.conditions():
            cost = 4.0 if each.renderer == conditions.MUJOCO else _SIZE_WEIGHT.get(each.name, 1.0)
            for part in _chunks(self.seeds(self.count(each.weight))):
                found.append(ReportTask("images", measure.judge, (conditions.key(each), part), cost * len(part)))
        for level in measure.LEVELS:
            for part in _chunks(self.seeds(self.count(4 / 3))):
                found.append(ReportTask("mount", measure.judge_mount, (level, part), float(len(part))))
        return found

    def timing(self) -> ReportTask:
        """Return the measurement of run times."""
        names = conditions.keys(conditions.BY_RANGE, conditions.HIDDEN, conditions.SIZE)
        names += [f"{conditions.DEFECTS}: {conditions.ALONE}"]
        names += [f"{conditions.ALARMS}: {name}" for name in (conditions.CLUTTER, conditions.CLUTTER_FLAT)]
        names += [
            conditions.key(each)
            for each in self.conditions()
            if each.group == conditions.RENDERERS and "docking" in each.name
        ]
        return ReportTask("run times", measure.times, (names, self.seeds(_TIMED[self.quick])))


def plan(images: int | None, seed: int, quick: bool) -> VisionPlan:
    """Return the plan for this machine."""
    return VisionPlan(images or (QUICK if quick else FULL), seed, quick, absent())


def absent() -> dict[str, str]:
    """Return for each missing or broken library what is left out, and what to install."""
    from deltacharger_lab.mujoco.camera import MujocoCamera, RendererError
    from deltacharger_vision.rendering.camera import OAK_D

    found = {}
    if find_spec("cv2") is None:
        found["opencv"] = "the detector needs it; install deltacharger[vision]"
    try:
        MujocoCamera(OAK_D.scaled(64, 40)).close()
    except RendererError as error:
        found["mujoco"] = f"its rows are left out: {error}"
    return found


def _chunks(seeds: range) -> list[tuple[int, ...]]:
    return [tuple(seeds[start : start + _CHUNK]) for start in range(0, len(seeds), _CHUNK)]


_ABOUT = "simulated images; "
_ERRORS = {
    "xy_mm": ("across the line of sight", "mm", 0.5),
    "z_mm": ("along the optical axis", "mm", 2.0),
    "roll_deg": ("roll", "°", 1.0),
}
"""Title, unit and target of the 95 % error of each."""


def _range(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "640 × 400 px, exact intrinsics; no depth below 0.174 m; the target is for the 95 %"
    rows = [(each.away, results["rows"][conditions.key(each)]) for each in conditions.members(conditions.BY_RANGE)]
    with picture(path, 11.0, 4.6, "Error against range", about) as figure:
        panels = figure.subplots(1, 3)
        for axes, (name, (title, unit, target)) in zip(panels, _ERRORS.items(), strict=True):
            away = [each for each, _ in rows]
            for share, colour, text in ((95, ORANGE, "95 %"), (50, BLUE, "median")):
                values = [row[f"{name}_p{share}"] for _, row in rows]
                axes.plot(away, values, "o-", color=colour, linewidth=1.6, markersize=4.5, label=text)
            axes.plot(conditions.BAND, [target] * 2, color=RED, linewidth=1.3, linestyle=(0, (4, 3)), label="target")
            axes.set_yscale("log")
            plain_ticks(axes)
            axes.set(title=f"{title}, {unit}", xlabel="range, m", xlim=(0.1, 1.05))
        top_legend(figure, panels[0].get_legend_handles_labels()[0])


def _found(results: dict[str, Any], path: Path) -> None:
    rows = [
        each
        for group in (conditions.DEFECTS, conditions.HIDDEN)
        for each in conditions.members(group)
        if conditions.key(each) in results["rows"]
    ]
    about = _ABOUT + "0.2–0.8 m, hidden bars 0.2–0.6 m; share of images in which the electrodes were found"
    figures = [results["rows"][conditions.key(each)] for each in rows]
    found, wrong = (np.array([100.0 * each[name] / each["images"] for each in figures]) for name in ("found", "wrong"))
    with picture(path, 9.0, 1.15 + 0.225 * len(rows), "Found share under each defect", about) as figure:
        axes, lines = figure.subplots(), range(len(rows))
        whole = axes.barh(lines, 100.0, 0.7, color="#e4e8ec")
        axes.barh(lines, found, 0.7, color=BLUE)
        axes.barh(lines, wrong, 0.7, left=found, color=RED)
        axes.bar_label(whole, [f"{each:.1f}" for each in found], padding=3.0, fontsize=8.5)
        axes.set_yticks(lines, [each.name for each in rows])
        axes.set(ylim=(len(rows) - 0.4, -0.6), xlim=(0.0, 106.0), xlabel="found, %; red: wrong")
        axes.tick_params(axis="y", length=0)


def _error_time(results: dict[str, Any], path: Path) -> None:
    about = _ABOUT + "0.15–0.8 m, three sizes of the image; processor time of one core, median"
    with picture(path, 9.0, 4.4, "Error against run time", about) as figure:
        panels = figure.subplots(1, 2)
        for axes, name in zip(panels, ("xy_mm", "z_mm"), strict=True):
            title, unit, target = _ERRORS[name]
            for number, each in enumerate(conditions.members(conditions.SIZE)):
                row, time = results["rows"][conditions.key(each)], results["times"][conditions.key(each)]["median_ms"]
                low, high = row[f"{name}_p50"], row[f"{name}_p95"]
                axes.plot([time] * 2, [low, high], color=FAINT, linewidth=1.4, zorder=2)
                axes.plot(time, low, "o", color=BLUE, markersize=7, zorder=3, label="median")
                axes.plot(time, high, "o", color=ORANGE, markersize=7, zorder=3, label="95 %")
                # Above the first and the last, below the middle one: they are close together.
                place, shift = (low, -16) if number == 1 else (high, 8)
                note(axes, each.name, (time, place), (0, shift))
            axes.axhline(target, color=RED, linewidth=1.3, linestyle=(0, (4, 3)), label="targets")
            axes.axvline(15.0, color=RED, linewidth=1.3, linestyle=(0, (1, 2)))
            axes.set(yscale="log", xscale="log")
            axes.margins(x=0.3, y=0.14)
            plain_ticks(axes)
            axes.set_xticks([5, 10, 15, 20, 30, 50], ["5", "10", "15", "20", "30", "50"])
            axes.xaxis.minorticks_off()
            axes.set(title=f"{title}, {unit}", xlabel="ms a frame, log scale")
        top_legend(figure, panels[0].get_legend_handles_labels()[0][-3:])


PICTURES = {
    "vision-range.png": _range,
    "vision-found.png": _found,
    "vision-error-time.png": _error_time,
}


_NORMAL_95 = 1.96
_CHI_SQUARE_95 = 7.815  # of three degrees of freedom
_LIBRARIES = ("numpy", "opencv-python-headless", "opencv-python", "mujoco", "matplotlib")


def build(plan: VisionPlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, figures and pictures into `directory` and return the figures.

    Raises:
        ModuleNotFoundError: OpenCV is missing.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    if "opencv" in plan.absent:
        raise ModuleNotFoundError(plan.absent["opencv"], name="cv2")
    report = Report("vision", command, _LIBRARIES)
    results = report.results
    results |= {
        "simulated": True,
        "seed": plan.seed,
        "first_seed": plan.first_seed,
        "images": plan.images,
        "quick": plan.quick,
        "absent": plan.absent,
    }
    _measure(results, plan, progress)
    progress("pictures")
    report.draw(PICTURES, directory)
    results["targets"] = targets(results)
    return report.write(directory, view=conditions, upper_bound=upper_bound)


def _measure(results: dict[str, Any], plan: VisionPlan, progress: Progress) -> None:
    found = work(plan.tasks(), progress)
    progress("run times, alone")
    results["times"] = work([plan.timing()], progress)["run times"][0]
    images, mounts = gathered(found["images"]), gathered(found["mount"])
    results["rows"] = {name: row(each) for name, each in images.items()}
    results["band"] = row(band(images))
    for group in (conditions.OBSTRUCTED, conditions.CLEAR):
        parts = [images[conditions.key(each)] for each in conditions.members(group) if conditions.key(each) in images]
        results[group] = row([image for part in parts for image in part])
    results["mount"] = {name: row(each, measure.MOUNT_FIELDS) for name, each in mounts.items()}
    results["raw"] = {"fields": measure.FIELDS, "images": images, "mount_fields": measure.MOUNT_FIELDS, "mount": mounts}


def gathered(parts: Iterable[tuple[str, list[list[float]]]]) -> dict[str, list[list[float]]]:
    """Return the images of each row together."""
    found: dict[str, list[list[float]]] = {}
    for name, rows in parts:
        found.setdefault(name, []).extend(rows)
    return found


def row(images: Sequence[Sequence[float]], fields: Sequence[str] = measure.FIELDS) -> dict[str, Any]:
    """Return the summary of images (N, fields) of one kind; `found` counts right detections."""
    table = np.array(images, dtype=float).reshape(-1, len(fields))
    column = dict(zip(fields, table.T, strict=True))
    right = column["found"] > 0.0
    found: dict[str, Any] = {"images": len(table)}
    if "wrong" in column:
        right &= column["wrong"] == 0.0
        found["wrong"] = int(column["wrong"].sum())
        found["sure"] = int(column["sure"].sum())
        found["sure_held"] = float(np.mean(column["nees"][right] <= _CHI_SQUARE_95)) if right.any() else math.nan
    found["found"] = int(right.sum())
    for name in ("yaw", "pitch"):
        degrees, sigmas = (column[f"{name}_{each}"][right] for each in ("deg", "sigma"))
        found |= {f"{name}_rms": _rms(degrees), f"{name}_sigma_rms": _rms(sigmas), f"{name}_held": _held(sigmas)}
    found["leans"] = int(np.isfinite(column["yaw_deg"][right]).sum())
    for name in (each for each in fields if each.endswith(("_mm", "_deg"))):
        found[f"{name}_p50"], found[f"{name}_p95"] = quantiles(column[name][right], 0.5, 0.95)
    return {**found, "nees": float(np.mean(column["nees"][right])) if right.any() else math.nan}


def _rms(values: Array) -> float:
    """Return the root mean square of the known values, NaN for none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def _held(sigmas: Array) -> float:
    """Return the share of errors, in standard deviations, within the 95 % interval."""
    known = sigmas[np.isfinite(sigmas)]
    return float(np.mean(np.abs(known) <= _NORMAL_95)) if len(known) else math.nan


def band(images: dict[str, list[list[float]]]) -> list[list[float]]:
    """Return the images at all ranges of the targets."""
    return [image for name in _near() for image in images[name]]


def _near() -> list[str]:
    return [
        conditions.key(each)
        for each in conditions.members(conditions.BY_RANGE)
        if conditions.BAND[0] <= each.away <= conditions.BAND[1]
    ]


def targets(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Return each target with its measured value and verdict."""
    band_row, rows = results["band"], results["rows"]
    half, alarms = (
        rows[f"{conditions.HIDDEN}: {conditions.HALF_HIDDEN}"],
        rows[f"{conditions.ALARMS}: {conditions.CLUTTER}"],
    )
    hidden, clear = results[conditions.OBSTRUCTED], results[conditions.CLEAR]
    slowest = max(results["times"][name]["median_ms"] for name in _near())
    where = f"{conditions.BAND[0]:g}–{conditions.BAND[1]:g} m"
    return [
        at_least(f"{where}, electrodes found", 100.0 * band_row["found"] / band_row["images"], 99.0, "%"),
        at_most(f"{where}, wrong", 100.0 * band_row["wrong"] / band_row["images"], 0.2, "%"),
        at_most(f"{where}, error across, 95 %", band_row["xy_mm_p95"], 0.5, "mm"),
        at_most(f"{where}, error of range, 95 %", band_row["z_mm_p95"], 2.0, "mm"),
        at_most(f"{where}, error of roll, 95 %", band_row["roll_deg_p95"], 1.0, "°"),
        at_least("half of one bar hidden, found", 100.0 * half["found"] / half["images"], 85.0, "%"),
        at_most("one frame on one core, slowest range, median", slowest, 15.0, "ms"),
        at_least("something before the bars, found", 100.0 * hidden["found"] / hidden["images"], 60.0, "%"),
        at_most("something before the bars, wrong and sure", hidden["sure"], 0.0, f"of {hidden['images']}"),
        at_least("nothing before the bars, 0.15–1 m, found", 100.0 * clear["found"] / clear["images"], 99.0, "%"),
        at_most("nothing before the bars, wrong and sure", clear["sure"], 0.0, f"of {clear['images']}"),
        at_most("false alarms in clutter, with depth", alarms["wrong"], 0.0, f"of {alarms['images']}"),
    ]
