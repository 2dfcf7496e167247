# SPDX-License-Identifier: Apache-2.0
"""Trains the nine packaged models: `python -m deltacharger_lab.training.nine` writes models/*.npz.

Training uses the paper's protocol on several rigs, so that models fit an unknown rig; testing uses other rigs. It takes
minutes on two cores. No other data use these rigs.
"""

import argparse
import functools
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from deltacharger_lab.training.classifier import TrainableClassifier
from deltacharger_lab.training.labels import Examples, examples
from deltacharger_sim.pads import generate_paper
from deltacharger_tactile import dataset, parameters
from deltacharger_tactile.classifiers import classifier
from deltacharger_tactile.classifiers.classifier import TARGETS

TRAINING_RIGS = range(1_200_000, 1_200_020)
JUDGING_RIGS = range(900, 910)
SEED = 20_260_102
_SLOWEST_FIRST = ("cnn", "nn", "gbdt", "xgboost", "logistic", "forest", "knn", "tree", "svm")


def make(name: str, target: str, folder: Path) -> tuple[float, float]:
    """Train and write one model; return its accuracy on unseen rigs and the training time in s."""
    _use_one_core()
    rows, judged = _examples(target)
    model = TrainableClassifier(name, target).fit(rows.frames, rows.labels, SEED)
    found = model.predict(judged.frames)
    model.shrink(judged.frames)
    right = float(np.mean(found == judged.labels))
    model.about = {
        classifier.GENERATOR: parameters.TactileParameters().digest(),
        classifier.ACCURACY: right,
        "fit_s": model.fit_time,
        "rigs": list(TRAINING_RIGS),
        "judged_on": list(JUDGING_RIGS),
        "seed": SEED,
    }
    model.save(classifier.path(name, target, folder))
    return right, model.fit_time


def _use_one_core() -> None:
    import torch

    torch.set_num_threads(1)


@functools.cache
def _sets() -> tuple[dataset.Dataset, dataset.Dataset]:
    return generate_paper(rigs=TRAINING_RIGS, seed=SEED), generate_paper(rigs=JUDGING_RIGS, seed=SEED)


def _examples(target: str) -> tuple[Examples, Examples]:
    known, fresh = _sets()
    return examples(known, target), examples(fresh, target)


def make_all(folder: Path, workers: int, progress: Callable[[int, str], None]) -> None:
    """Train all nine for all targets.

    Args:
        folder: output.
        workers: processes, one core each.
        progress: called with the number done and a line on the latest.
    """
    tasks = [(name, target) for name in _SLOWEST_FIRST for target in TARGETS]
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        futures = {pool.submit(make, name, target, folder): (name, target) for name, target in tasks}
        for done, future in enumerate(as_completed(futures), start=1):
            (name, target), (right, seconds) = futures[future], future.result()
            progress(done, f"{name} for {target}: {100.0 * right:.1f} % in {seconds:.2f} s")


def main(arguments: Sequence[str] | None = None) -> int:
    """Train the nine packaged models and write them."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--output", type=Path, default=classifier.FOLDER, help="folder")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes, one core each")
    options = parser.parse_args(arguments)
    if not options.output.is_dir():
        parser.error(f"--output {options.output}: there is no such folder; make it")
    count = len(classifier.MODELS) * len(TARGETS)
    make_all(options.output, options.workers, lambda done, text: print(f"{done} of {count}  {text}", file=sys.stderr))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
