"""`deltacharger tactile`: data sets, training and judging of the classifiers."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from deltacharger_bringup.cli_output import DONE, FAILED, WRONG_INPUT, CommandError, say, tell, write_json

if TYPE_CHECKING:
    from deltacharger_tactile.generator import Dataset

_CALIBRATED = 0.8  # share of the dockings that are learnt from; the rest tells when an answer may be acted on


def generate(options: argparse.Namespace) -> int:
    """Write a simulated data set."""
    from deltacharger_tactile.generator import generate_continuous, generate_paper

    out = _writable(options.out)
    rigs = range(options.rigs)
    if options.protocol == "paper":
        data = generate_paper(rigs=rigs, seed=options.seed)
    else:
        data = generate_continuous(rigs=rigs, count=options.dockings, seed=options.seed, frames=options.frames)
    data.save(out)
    summary = {"out": str(out), "n": len(data), "protocol": options.protocol, "digest": data.meta["digest"]}
    if options.json:
        write_json({"success": True, **summary})
    else:
        tell(f"{out}: {len(data)} dockings on {options.rigs} simulated rigs, parameters {data.meta['digest']}")
    return DONE


def train(options: argparse.Namespace) -> int:
    """Train a classifier on a data set."""
    from deltacharger_tactile.classifiers.classifier import Classifier
    from deltacharger_tactile.classifiers.labels import examples
    from deltacharger_tactile.classifiers.splits import by_docking

    out, data = _writable(options.out), _load(options.data)
    rows = examples(data, options.target)
    learns, checks = by_docking(rows, options.seed, _CALIBRATED)
    model = Classifier(options.model, options.target)
    model.about = {"data": data.meta, "seed": options.seed, "dockings": len(learns)}
    try:
        model.fit(rows.frames[learns], rows.labels[learns], options.seed, _Progress())
    except ModuleNotFoundError as error:
        raise CommandError(f"{error.name} is not installed; install deltacharger[train]", FAILED) from error
    model.calibrate(rows.frames[checks], rows.labels[checks])
    model.save(out)
    summary = {"out": str(out), "model": options.model, "target": options.target, "n": len(learns)}
    if options.json:
        write_json({"success": True, **summary, "fit_time": model.fit_time})
    else:
        tell(
            f"{out}: {options.model} for {options.target}, learnt from {len(learns)} dockings in {model.fit_time:.2f} s"
        )
    return DONE


def evaluate(options: argparse.Namespace) -> int:
    """Judge a trained classifier on a data set."""
    from deltacharger_tactile.classifiers.classifier import Classifier
    from deltacharger_tactile.classifiers.judgement import evaluate as judge
    from deltacharger_tactile.classifiers.labels import examples
    from deltacharger_tactile.errors import TactileError

    data = _load(options.data)
    try:
        model = Classifier.load(options.model)
        found = judge(model, examples(data, model.target))
    except TactileError as error:
        raise CommandError(str(error), WRONG_INPUT) from error
    if options.json:
        write_json(found)
        return DONE
    unit, scale = ("°", 57.29577951308232) if model.target == "angle" else ("mm", 1e3)
    tell(f"{model.name} for {model.target} on {found['n']} simulated frames" if _is_simulated(data) else model.name)
    tell(f"  accuracy                {100 * found['accuracy']:.1f} %")
    tell(f"  mean absolute error     {scale * found['mean_absolute_error']:.2f} {unit}")
    tell(f"  sets hold the truth     {100 * found['coverage']:.1f} % (nominal {100 * found['nominal']:.0f} %)")
    tell(f"  may be acted on         {100 * found['act_rate']:.1f} %")
    tell(f"  look unlike training    {100 * found['drift_rate']:.1f} %")
    return DONE


def _is_simulated(data: Dataset) -> bool:
    return "parameters" in data.meta


def _load(name: str) -> Dataset:
    from deltacharger_tactile.errors import TactileError
    from deltacharger_tactile.generator import Dataset

    try:
        return Dataset.load(name)
    except FileNotFoundError as error:
        raise CommandError(f"--data {name}: there is no such file", WRONG_INPUT) from error
    except (TactileError, OSError) as error:
        raise CommandError(str(error), WRONG_INPUT) from error


def _writable(name: str) -> Path:
    """Return where to write, with a folder that is there."""
    path = Path(name)
    if path.suffix != ".npz":
        raise CommandError(f"--out {name}: give a name that ends in .npz", WRONG_INPUT)
    if not path.parent.is_dir():
        raise CommandError(f"--out {name}: the folder {path.parent} does not exist; make it", WRONG_INPUT)
    return path


class _Progress:
    """Says how far training is, at most at every tenth."""

    def __init__(self) -> None:
        self._told = -1

    def __call__(self, share: float, text: str) -> None:
        """Take note, and say it where another tenth is done."""
        tenth = int(10 * share)
        if tenth != self._told:
            self._told = tenth
            say(f"{100 * share:3.0f} %  {text}")
