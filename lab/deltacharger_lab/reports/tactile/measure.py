# SPDX-License-Identifier: Apache-2.0
"""Trains, judges and times every model on one rig: accuracy, shifts, reliability, confusion, run time."""

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_lab.reports.tactile import second
from deltacharger_lab.reports.tactile.plan import SETS, TARGETS, TactilePlan, kind, threshold
from deltacharger_lab.training import classifier, inputs, judgement, labels, reliability, splits
from deltacharger_sim.pads import Rig, generate_paper, measure
from deltacharger_tactile.classifiers.classifier import Classifier, classes
from deltacharger_tactile.dataset import SUBSET_ANGLE, SUBSET_POSITION, Dataset
from deltacharger_tactile.parameters import TactileParameters

_OTHER = 100  # added to a rig's seed for another rig
_TILT = math.radians(0.06)


@dataclass(frozen=True)
class Shift:
    """One change.

    Attributes:
        name: in tables.
        parameters: of the changed rig.
        other: added to the rig's seed.
        rig: change of the rig.
        frames: change of frames (N, 2, 10, 10) N, NaN where dead.
    """

    name: str
    parameters: TactileParameters = dataclasses.field(default_factory=TactileParameters)
    other: int = 0
    rig: Callable[[Rig], Rig] = lambda rig: rig
    frames: Callable[[Array], Array] = lambda frames: frames


def changed(part: str, **values: Any) -> TactileParameters:
    """Return the default parameters with others in one part of them."""
    base = TactileParameters()
    return dataclasses.replace(base, **{part: dataclasses.replace(getattr(base, part), **values)})


def _weaker(share: float) -> TactileParameters:
    usual = TactileParameters().docking
    return changed("docking", magnet_force=share * usual.magnet_force, push_per_ampere=share * usual.push_per_ampere)


def _left_weaker(rig: Rig) -> Rig:
    return dataclasses.replace(rig, gain=rig.gain * np.array([0.8, 1.0])[:, None, None])


def _tilted(rig: Rig) -> Rig:
    return dataclasses.replace(rig, tilt=rig.tilt + np.array([0.0, _TILT]))


def _left_offset(frames: Array) -> Array:
    return np.asarray(np.clip(frames + np.array([0.3, 0.0])[:, None, None], 0.0, 9.0))


def _rows_silent(frames: Array) -> Array:
    silent = frames.copy()
    silent[:, 0, 4:6] = 0.0
    return silent


NONE = Shift("none")
SHIFTS = (
    NONE,
    Shift("3 dead taxels", changed("sensor", dead_taxels=3)),
    Shift("6 dead taxels", changed("sensor", dead_taxels=6)),
    Shift("left pad × 0.8", rig=_left_weaker),
    Shift("gain spread 25 %", changed("sensor", gain_spread=0.25)),
    Shift("docking offsets × 3", changed("sensor", docking_offset=0.15)),
    Shift("left pad + 0.3 N", frames=_left_offset),
    Shift("force − 20 %", _weaker(0.8)),
    Shift("constant tilt 0.06° about y", rig=_tilted),
    Shift("ridge 8 mm high", changed("contact", ridge_height=0.008)),
    Shift("crown radius 30 mm", changed("contact", crown_radius=0.03)),
    Shift("another sensor and rig", other=_OTHER),
    Shift("two rows of a pad read 0", frames=_rows_silent),
)
"""Shifts of the table; changes of a rig keep everything else that its seed decides."""


def dock_again(known: Dataset, shift: Shift, rig: int, seed: int, rows: Mask) -> Dataset:
    """Dock a (changed) rig at the commanded poses of a data set of the same rig.

    Args:
        known: of the rig, one row of each docking.
        shift: the change.
        rig: seed of the device.
        seed: of the dockings.
        rows: the data set's dockings to repeat.
    """
    pose = np.column_stack([known.horizontal, known.vertical, known.angle])[rows]
    changed = shift.rig(Rig.draw(shift.parameters, rig + shift.other))
    random = np.random.default_rng([0x5417, seed, rig])
    found = measure(shift.parameters, changed, pose, random, 1, 0.0)
    frames = np.stack([found["left"], found["right"]], axis=1).astype(float)
    frames = np.where(found["dead"], 0.0, shift.frames(frames))
    columns = {**found, "left": frames[:, 0].astype(np.float32), "right": frames[:, 1].astype(np.float32)}
    return Dataset(meta=known.meta, rig=np.full(len(pose), rig), subset=known.subset[rows], **columns)


BINS = 10
"""Bins of the predicted probability in the reliability diagrams."""
WINDOWS = (reliability.WINDOW, 2 * reliability.WINDOW)
"""Dockings in one window of the drift check."""
PAPER = tuple(name for name in inputs.NAMES if kind(name) != "physical")
_WARM_UP = 20  # predictions that are not counted
_PASSES = 300  # forward passes; their median counts


def paper_set(rig: int, seed: int) -> Dataset:
    """Return the paper's protocol on one rig; every model drops readings below its own threshold."""
    return generate_paper(rigs=(rig,), seed=seed, threshold=0.0)


def fitted(name: str, target: str, rows: labels.Examples, seed: int) -> classifier.TrainableClassifier:
    """Return a model trained on examples, with its usual threshold."""
    return classifier.TrainableClassifier(name, target, threshold(name)).fit(rows.frames, rows.labels, seed)


def accuracy(model: Classifier, rows: labels.Examples) -> float:
    """Return the share of examples that a model classifies correctly."""
    return float(np.mean(model.predict(rows.frames) == rows.labels))


def judge_rig(rig: int, seed: int, part: str, plan: TactilePlan, keep: str) -> dict[str, list[dict[str, Any]]]:
    """Train every model on one data set of one rig, and judge it.

    Args:
        rig: seed of the device.
        seed: of the dockings.
        part: of `SETS`.
        plan: what is measured.
        keep: folder for the models; '' = none.
    """
    with contextlib.suppress(ImportError):
        import torch

        torch.set_num_threads(1)
    known = paper_set(rig, seed)
    found, models = [], {}
    for target in SETS[part]:
        rows = labels.examples(known, target)
        turns = splits.thirds(rows, seed)[: 1 if plan.quick else 3]
        for name in plan.names:
            where = {"rig": rig, "seed": seed, "target": target, "model": name}
            for turn, (learns, checks) in enumerate(turns):
                model = fitted(name, target, rows.part(learns), seed)
                right = accuracy(model, rows.part(checks))
                found.append({**where, "accuracy": right, "n": len(checks), "fit_s": model.fit_time})
                if turn:
                    continue
                if keep:
                    model.save(Path(keep) / f"{name}-{target}.npz")
                if name in plan.judged:
                    held = rows.part(checks)
                    model.calibrate(held.frames, held.labels, rows.frames[learns])
                    models[name, target] = model
    return {"accuracy": found, **_judge_shifts(models, known, part, (rig, seed), plan)}


def _judge_shifts(
    models: second.Models, known: Dataset, part: str, device: tuple[int, int], plan: TactilePlan
) -> dict[str, list[dict[str, Any]]]:
    def drifted(model: classifier.TrainableClassifier, rows: labels.Examples) -> list[float]:
        return [_windows(model, rows, size, plan.windows) for size in WINDOWS]

    found: dict[str, list[dict[str, Any]]] = {"shifts": [], "diagrams": []}
    subset = known.subset == (SUBSET_ANGLE if part == "angle" else SUBSET_POSITION)
    for shift in SHIFTS:
        fresh = dock_again(known, shift, *device, subset)
        windows: dict[float, list[float]] = {}  # they depend only on the threshold of readings
        for (name, target), model in models.items():
            rows = labels.examples(fresh, target)
            if model.threshold not in windows:
                windows[model.threshold] = drifted(model, rows)
            where = {"rig": device[0], "seed": device[1], "target": target, "model": name}
            result = judgement.evaluate_classifier(model, rows)
            found["shifts"].append({**where, "shift": shift.name, **result, "windows": windows[model.threshold]})
            if shift is NONE:
                found["diagrams"].append({**where, **_diagram(model, rows)})
    found["second"] = second.judge_models(models, known, subset, device, drifted)
    return found


def _windows(model: classifier.TrainableClassifier, rows: labels.Examples, size: int, count: int) -> float:
    """Return the share of windows of `size` dockings, drawn from the examples, that look unlike training."""
    assert model.reliability is not None
    random = np.random.default_rng(size)
    chosen = (random.choice(len(rows), size, replace=False) for _ in range(count))
    result = [model.reliability.drifted_together(rows.frames[rows_], model.threshold) for rows_ in chosen]
    return float(np.mean(result))


def _diagram(model: Classifier, rows: labels.Examples) -> dict[str, Any]:
    """Return counts of the winning class's probability and how often it was right, and the confusion matrix."""
    shares = model.predict_proba(rows.frames)
    winner, sure = shares.argmax(axis=1), shares.max(axis=1)
    bins = np.minimum((BINS * sure).astype(int), BINS - 1)
    count = classes(model.target)
    matrix = np.zeros((count, count), dtype=int)
    np.add.at(matrix, (rows.labels, winner), 1)
    return {
        "count": np.bincount(bins, minlength=BINS).tolist(),
        "sure": np.bincount(bins, sure, BINS).tolist(),
        "right": np.bincount(bins, winner == rows.labels, BINS).tolist(),
        "matrix": matrix.tolist(),
    }


def predictions(plan: TactilePlan, kept: str) -> list[dict[str, Any]]:
    """Return median and 99th percentile of single predictions, ms, of the models in a folder."""
    data = paper_set(plan.rigs[0], plan.seeds[0] + 1)
    found = []
    for target in TARGETS:
        frames = labels.examples(data, target).frames
        for name in plan.names:
            model = classifier.TrainableClassifier.load(Path(kept) / f"{name}-{target}.npz")
            times = np.array(
                [_timed(model.predict_proba, frames[index % len(frames)]) for index in range(plan.repeats + _WARM_UP)]
            )
            median, slow = np.quantile(times[_WARM_UP:], (0.5, 0.99))
            found.append({"model": name, "target": target, "median_ms": float(median), "p99_ms": float(slow)})
    return found


def generation() -> float:
    """Return the time (s) to generate a paper-size data set of one rig."""
    started = time.perf_counter()
    paper_set(0, 0)
    return time.perf_counter() - started


def timing(plan: TactilePlan, kept: str) -> dict[str, Any]:
    """Return every run time; runs without other work, in a process with one thread."""
    generation()  # loading and first allocation are not counted
    return {
        "predictions": predictions(plan, kept),
        "generation_s": min(generation() for _ in range(3)),
        "trainers": trainers(plan),
    }


def trainers(plan: TactilePlan) -> list[dict[str, Any]]:
    """Return the paper's times for the angle: training, s, and one forward pass in the trainer's library, ms."""
    rows = labels.examples(paper_set(plan.rigs[0], plan.seeds[0]), "angle")
    learns, judges = splits.by_docking(rows, plan.seeds[0])
    found = []
    for name in (name for name in PAPER if name in plan.names):
        for _ in range(2):  # the first imports the trainer
            model = fitted(name, "angle", rows.part(learns), plan.seeds[0])
        times = [_timed(model.trainer_proba, rows.frames[judges[index % len(judges)]]) for index in range(_PASSES)]
        found.append({"model": name, "fit_s": model.fit_time, "forward_ms": float(np.median(times))})
    return found


def _timed(predict: Callable[[Any], Any], frame: Any) -> float:
    """Return the time (ms) of one prediction."""
    started = time.perf_counter()
    predict(frame)
    return 1e3 * (time.perf_counter() - started)
