# SPDX-License-Identifier: Apache-2.0
"""Models of the first contact physics judged on the second: classifiers and pretrained estimates."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from deltacharger_core import arrays, machine
from deltacharger_docking.clearance import CLEARANCE_SIGMAS, clearance
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.reports.formats import grouped
from deltacharger_lab.reports.tactile.plan import TactilePlan
from deltacharger_lab.second import generator, parameters
from deltacharger_lab.training import classifier, estimator, judgement, labels
from deltacharger_sim.pads import generate_continuous
from deltacharger_tactile import default_model
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.estimator import THRESHOLD, Estimate

Row = dict[str, Any]
Models = Mapping[tuple[str, str], classifier.TrainableClassifier]
Windows = Callable[[classifier.TrainableClassifier, labels.Examples], list[float]]
FIRST, SECOND = "first", "second"
FRAMES = (12, 1)
"""Frames averaged in an estimate: the robot's number, and one."""
CUTS = (THRESHOLD, machine.CONTACT_FORCE)
"""Thresholds of the two pretrained estimates, N."""
AXES = {"angle": (2, 180.0 / math.pi, "°"), "vertical": (1, 1e3, "mm"), "horizontal": (0, 1e3, "mm")}
"""Index of an axis in a pose, and the scale and unit of its errors."""
BELIEVED = 1.5
"""Largest rms of error over σ for which σ counts as right."""
_DOCKING = DockingParameters()
_UNCHANGED = "unchanged"
_COUNTED = ("n", "contact", "in_range", "sure", "drift", "acts", "unsafe")
SHARES = ("accuracy", "coverage", "act_rate", "drift_rate")


def judge_models(
    models: Models, known: Dataset, rows: arrays.Mask, device: tuple[int, int], windows: Windows
) -> list[Row]:
    """Judge models of one rig by dockings of the second physics.

    Args:
        models: from `judge_rig`, by name and target.
        known: data set of the first physics; its commanded poses are docked again.
        rows: of these poses.
        device: seeds of rig and dockings.
        windows: shares of windows of dockings that differ from training.
    """
    columns = {item.name: getattr(known, item.name) for item in dataclasses.fields(Dataset) if item.name != "meta"}
    fresh = generator.dock_anew(
        Dataset(meta=known.meta, **{name: each[rows] for name, each in columns.items()}), device[1]
    )
    found = []
    for (name, target), model in models.items():
        judged = labels.examples(fresh, target)
        result = judgement.evaluate_classifier(model, judged)
        kept = {key: result[key] for key in SHARES}
        where = {"rig": device[0], "seed": device[1], "target": target, "model": name}
        found.append({**where, **kept, "windows": windows(model, judged)})
    return found


def table(rows: Iterable[Row], usual: Iterable[Row]) -> list[Row]:
    """Return means over rigs and seeds, by model and target, with those of the first physics without shift."""
    before = {(row["model"], row["target"]): row for row in usual}
    found = []
    for (name, target), members in grouped(rows, "model", "target"):
        here = {key: float(np.mean([row[key] for row in members])) for key in SHARES}
        here["windows"] = np.mean([row["windows"] for row in members], axis=0).tolist()
        found.append({"model": name, "target": target, FIRST: before[name, target], SECOND: here})
    return found


def judge_estimates(rig: int, seed: int, plan: TactilePlan) -> list[Row]:
    """Count the results of both pretrained estimates on one rig of each physics, of one frame and of twelve."""
    found = []
    for frames in FRAMES:
        known = generate_continuous(rigs=(rig,), count=plan.second_count, seed=seed, frames=frames, threshold=0.0)
        sets = {FIRST: known, SECOND: generator.dock_anew(known, seed, frames, since_tare=generator.JUST_NOW)}
        for cut in CUTS:
            for physics, data in sets.items():
                about = {"physics": physics, "threshold": cut, "frames": frames}
                found.append({**about, **_counts(data, cut)})
    return found


def judge_variants(rig: int, seed: int, plan: TactilePlan) -> list[Row]:
    """Count the same for the packaged estimate on families without single laws of the second physics."""
    known = generate_continuous(rigs=(rig,), count=plan.second_count, seed=seed, frames=FRAMES[0], threshold=0.0)
    return [
        {
            "variant": name,
            **_counts(generator.dock_anew(known, seed, FRAMES[0], 0.0, generator.JUST_NOW, family), THRESHOLD),
        }
        for name, family in variants().items()
    ]


def variants() -> dict[str, parameters.SecondParameters]:
    """Return families of the second physics that lack a law, by name."""
    base = parameters.SecondParameters()

    def other(**groups: dict[str, Any]) -> parameters.SecondParameters:
        changed = {name: dataclasses.replace(getattr(base, name), **values) for name, values in groups.items()}
        return dataclasses.replace(base, **changed)

    result, free = {"dead_band": 0.0, "dead_band_spread": 0.0}, {"rate": 0.0, "preload": 0.0}
    upright, twice = {"lean_bias": 0.0, "lean_spread": 0.0}, {"line_share": 2.0}
    stiff = twice | {"compliance": 0.1 * base.platform.compliance}
    plain = dict.fromkeys(
        ("hysteresis", "creep", "linearity", "repeatability", "edge_loss", "neighbour", "matrix", "gain_drift",
         "offset_drift"), 0.0,
    )  # fmt: skip
    return {
        _UNCHANGED: base,
        "no dead band": other(sheet=result),
        "bars bear nothing": other(bars=free),
        "no lean": other(platform=upright),
        "the force acts at twice the offset": other(platform=twice),
        "plain sheets with a dead band": other(sheet=plain),
        "plain sheets without dead band": other(sheet=plain | result),
        "the same, bars bear nothing": other(sheet=plain | result, bars=free),
        "the same, the force at twice the offset": other(sheet=plain | result, bars=free, platform=twice),
        "the same, the platform ten times as stiff": other(sheet=plain | result, bars=free, platform=stiff),
    }


def _counts(data: Dataset, cut: float) -> Row:
    """Return counts and sums of one estimate over a data set, which can be added over several."""
    model, truth = default_model(cut), data.contact_pose
    left, right = data.robot_frames()
    result = model.predict(left, right)
    used, sure = np.asarray(result.in_range), np.asarray(result.sure)
    acts = _acts(result)
    _, across, angle = estimator.to_seat(truth).T
    short = _clearances(angle, across) < 0.0
    found: Row = {
        "n": len(data), "contact": int(np.sum(result.contact)), "in_range": int(used.sum()), "sure": int(sure.sum()),
        "drift": int(model.drifted(left, right).sum()), "acts": int(acts.sum()), "unsafe": int((acts & short).sum()),
    }  # fmt: skip
    for name, (axis, scale, _) in AXES.items():
        error = (np.asarray(getattr(result, name)) - truth[:, axis])[used]
        z = error / np.asarray(getattr(result, f"{name}_stddev"))[used]
        found[name] = [float(np.sum((scale * error) ** 2)), float(np.sum(z**2)), int(np.sum(np.abs(z) > 3.0))]
    return found


def _acts(result: Estimate) -> Any:
    """Return (N,) whether an estimate is sure and leaves docking's minimum clearance at docking's number of σ."""
    half = _DOCKING.electrode_half_length
    spread = np.hypot(half * np.asarray(result.angle_stddev), np.asarray(result.across_stddev))
    left = _clearances(result.angle, result.across) - CLEARANCE_SIGMAS * spread
    return np.asarray(result.sure) & (left >= _DOCKING.clearance_min)


def _clearances(angles: Any, across: Any) -> Any:
    sizes = _DOCKING.electrode_half_gap, _DOCKING.electrode_half_length
    return np.array([clearance(*pose, *sizes) for pose in zip(angles, across, strict=True)])


def summed(rows: Iterable[Row], *keys: str) -> list[Row]:
    """Return for each value of the keys the shares and root mean squares over all rigs' dockings."""
    found = []
    for values, members in grouped(rows, *keys):
        total = {key: sum(row[key] for row in members) for key in _COUNTED}
        row: Row = dict(zip(keys, values, strict=True)) | {key: total[key] for key in ("n", "acts", "unsafe")}
        row |= {key: total[key] / total["n"] for key in ("contact", "in_range", "sure", "drift")}
        for name in AXES:
            error, z, beyond = np.sum([each[name] for each in members], axis=0) / (total["in_range"] or math.nan)
            row[name] = {"rms": math.sqrt(error), "z": math.sqrt(z), "beyond": float(beyond)}
        found.append(row)
    return found


def worst_z(estimates: Iterable[Row]) -> float:
    """Return the largest rms of error over σ of the packaged estimate of twelve frames on the second physics."""
    packaged = (SECOND, CUTS[0], FRAMES[0])
    chosen = [row for row in estimates if (row["physics"], row["threshold"], row["frames"]) == packaged]
    return max((row[name]["z"] for row in chosen for name in AXES), default=math.nan)


def unsafe(estimates: Iterable[Row], variants: Iterable[Row]) -> float:
    """Return how often an estimate would have energised without clearance on the second physics or one of its families.

    Dockings of the unchanged family are also in those of the estimates, and count once.
    """
    chosen = [row["unsafe"] for row in estimates if row["physics"] != FIRST]
    chosen += [row["unsafe"] for row in variants if row["variant"] != _UNCHANGED]
    return float(sum(chosen)) if chosen else math.nan
