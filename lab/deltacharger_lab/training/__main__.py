# SPDX-License-Identifier: Apache-2.0
"""Data sets, training and evaluation of the classifiers: python -m deltacharger_lab.training ACTION."""

import argparse
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_bringup.cli import arguments, output
from deltacharger_bringup.cli.main import main
from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_docking.codes import DockingError
from deltacharger_lab.campaigns.recording import Protocol, record_paper
from deltacharger_lab.training import classifier, inputs, judgement, labels, pose, splits
from deltacharger_lab.training.estimator import TrainablePoseEstimator
from deltacharger_sim.pads import generate_continuous, generate_paper
from deltacharger_tactile import dataset, errors
from deltacharger_tactile.estimator import THRESHOLD

_TRAINING_SHARE = 0.8  # share of the dockings for training; the rest calibrates when a prediction may be acted on

TARGETS = ("angle", "vertical", "horizontal", "pose")
COMMANDS = {
    "generate": ("deltacharger_lab.training.__main__.generate", "write a simulated data set"),
    "train": ("deltacharger_lab.training.__main__.train", "train a classifier, or the pose estimator"),
    "evaluate": ("deltacharger_lab.training.__main__.evaluate", "evaluate a trained classifier"),
}
"""As those of `deltacharger`."""


def add_generate(parser: argparse.ArgumentParser) -> None:
    """Add the options of `generate`."""
    text = "the paper's two sets, the same by docking's own movements in virtual time on one rig, or signed poses"
    parser.add_argument("--protocol", choices=("paper", "docked", "continuous"), default="paper", help=text)
    parser.add_argument("--rigs", type=arguments.integer(1, 1000), metavar="N", help="simulated rigs (5; docked 1)")
    parser.add_argument("--seed", type=arguments.SEED, default=0, metavar="N", help="random seed of the dockings (0)")
    parser.add_argument("--out", required=True, metavar="F.npz", help="file to write")
    parser.add_argument(
        "--first-rig", type=arguments.integer(0, 10**9), default=0, metavar="N", help="seed of the first rig (0)"
    )
    parser.add_argument(
        "--frames", type=arguments.integer(1, 240), default=1, metavar="N", help="frames averaged in each row (1)"
    )
    parser.add_argument(
        "--rows", type=arguments.integer(1, 240), default=1, metavar="N", help="rows of each docking; docked only (1)"
    )
    parser.add_argument(
        "--threshold",
        type=arguments.between(0.0, 9.0),
        metavar="N",
        help="smaller forces count as 0 (1; continuous 0.25)",
    )
    parser.add_argument(
        "--dockings",
        type=arguments.integer(1, 100_000),
        metavar="N",
        help="dockings per rig in the continuous protocol (400)",
    )


def add_train(parser: argparse.ArgumentParser) -> None:
    """Add the options of `train`."""
    parser.add_argument("--data", required=True, metavar="F.npz", help="data set of `generate`")
    parser.add_argument("--model", required=True, choices=inputs.NAMES, help="what to train")
    parser.add_argument("--target", required=True, choices=TARGETS, help="what it predicts")
    parser.add_argument("--out", required=True, metavar="M.npz", help="file to write")
    parser.add_argument("--seed", type=arguments.SEED, default=0, metavar="N", help="random seed (0)")
    parser.add_argument(
        "--reference", metavar="R.npz", help="dockings with the constant errors of one device (lda, pose)"
    )


def add_evaluate(parser: argparse.ArgumentParser) -> None:
    """Add the options of `evaluate`."""
    parser.add_argument("--data", required=True, metavar="F.npz", help="data set that was not used for training")
    parser.add_argument("--model", required=True, metavar="M.npz", help="model of `train`")


def generate(options: argparse.Namespace) -> output.Result:
    """Write a simulated data set."""
    out = arguments.file_to_write("--out", options.out, ".npz")
    count = options.rigs or (1 if options.protocol == "docked" else 5)
    rigs = range(options.first_rig, options.first_rig + count)
    usual = THRESHOLD if options.protocol == "continuous" else CONTACT_FORCE
    threshold = usual if options.threshold is None else options.threshold
    common = {"seed": options.seed, "frames": options.frames, "threshold": threshold}
    if options.protocol != "continuous" and options.dockings is not None:
        raise output.WrongInput("--dockings is for --protocol continuous; the paper's numbers are fixed")
    if options.protocol == "paper":
        data = generate_paper(**common, rigs=rigs)
    elif options.protocol == "docked":
        data = _docked(options, Protocol(**common, rows=options.rows, rig=options.first_rig))
    else:
        data = generate_continuous(**common, rigs=rigs, count=options.dockings or 400)
    data.save(out)
    summary = {"out": str(out), "n": len(data), "protocol": options.protocol, "digest": data.meta["digest"]}
    text = f"{out}: {len(data)} rows on {count} simulated rigs, parameters {data.meta['digest']}"
    return output.Result(text, summary)


def _docked(options: argparse.Namespace, protocol: Protocol) -> dataset.Dataset:
    if options.rigs not in (None, 1):
        raise output.WrongInput("--rigs: --protocol docked records one rig; give another --first-rig instead")
    try:
        return record_paper(protocol, output.log_line)
    except DockingError as error:
        raise output.CommandError(str(error), code=int(error.code)) from error


def train(options: argparse.Namespace) -> output.Result:
    """Train a classifier, or the pose estimator, on a data set."""
    if options.target == "pose" and options.model != "pose":
        raise output.WrongInput(f"--model {options.model} predicts classes; give --model pose")
    out, data = arguments.file_to_write("--out", options.out, ".npz"), _load(options.data)
    with output.wrong_input(errors.TactileError):
        result = _train_pose(options, data, out) if options.target == "pose" else _train_class(options, data, out)
    summary = {"out": str(out), "model": options.model, "target": options.target, **result}
    text = f"{out}: {options.model} for {options.target}, trained on {result['n']} rows in {result['fit_time']:.2f} s"
    return output.Result(text, summary)


def _train_class(options: argparse.Namespace, data: dataset.Dataset, out: Path) -> dict[str, Any]:
    rows = labels.examples(data, options.target)
    learns, checks = splits.by_docking(rows, options.seed, _TRAINING_SHARE)
    cut = data.threshold
    model = classifier.TrainableClassifier(
        options.model, options.target, max(cut, THRESHOLD) if cut >= 0.0 else CONTACT_FORCE
    )
    model.about = {"data": data.meta, "seed": options.seed, "dockings": len(np.unique(rows.groups[learns]))}
    model.fit(rows.frames[learns], rows.labels[learns], options.seed, output.Tenths())
    model.calibrate(rows.frames[checks], rows.labels[checks], rows.frames[learns])
    if options.reference is not None:
        known = labels.examples(_load(options.reference, "--reference"), options.target)
        model.refer(known.frames, known.labels)
    model.save(out)
    return {"n": len(learns), "fit_time": model.fit_time}


def _train_pose(options: argparse.Namespace, data: dataset.Dataset, out: Path) -> dict[str, Any]:
    if options.reference is not None:
        raise output.WrongInput("--reference is for classes; for the pose use `deltacharger calibrate tactile`")
    started = time.perf_counter()
    pose.fit_dataset(data, options.seed, output.Tenths()).save(out)
    return {"n": len(data), "fit_time": time.perf_counter() - started}


def evaluate(options: argparse.Namespace) -> output.Result:
    """Evaluate a trained classifier or pose estimator on a data set."""
    data = _load(options.data)
    arguments.file_to_read("--model", options.model)
    with output.wrong_input(errors.TactileError):
        if zipfile.is_zipfile(options.model) and "meta.npy" in zipfile.ZipFile(options.model).namelist():
            estimator = TrainablePoseEstimator.load(options.model)
            name, trained_on = estimator.name, estimator.about.get("data")
            found = judgement.evaluate_pose(estimator, data)
        else:
            model = classifier.TrainableClassifier.load(options.model)
            name, trained_on = model.name, model.about.get("data")
            found = judgement.evaluate_classifier(model, labels.examples(data, model.target))
    if "protocol" in data.meta and trained_on == data.meta:  # files of other programs do not record their origin
        output.log_line(
            f"warning: {options.model} was trained on {options.data}: the figures are too optimistic; evaluate it on "
            "other data"
        )
    parts = [found[axis] for axis in judgement.AXES] if found["target"] == "pose" else [found]
    head = f"{name} on {found['n']} {'simulated' if data.simulated else 'recorded'} rows"
    return output.Result("\n".join([head, *(line for part in parts for line in _lines(part))]), found)


def _lines(found: dict[str, Any]) -> Iterator[str]:
    """Yield the result of one target."""
    unit, scale = ("°", 57.29577951308232) if found["target"] == "angle" else ("mm", 1e3)
    yield f"{found['target']}"
    yield f"  accuracy                {100 * found['accuracy']:.1f} %"
    yield f"  mean absolute error     {scale * found['mean_absolute_error']:.2f} {unit}"
    yield f"  sets with true class    {100 * found['coverage']:.1f} % (nominal {100 * found['nominal']:.0f} %)"
    yield f"  sure enough to act on   {100 * found['act_rate']:.1f} %"
    yield f"  unlike training data    {100 * found['drift_rate']:.1f} %"
    if found.get("drifted_together", 0.0) > 0.0:
        yield "  taken together, the rows are unlike the training data: calibrate or train again"


def _load(name: str, flag: str = "--data") -> dataset.Dataset:
    with output.wrong_input(errors.TactileError):
        return dataset.Dataset.load(arguments.file_to_read(flag, name))


if __name__ == "__main__":
    sys.exit(main(None, COMMANDS, "python -m deltacharger_lab.training"))
