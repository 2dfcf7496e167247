# SPDX-License-Identifier: Apache-2.0
"""The paper's estimate in place of ours: three of its CNNs, trained once and kept beside a campaign."""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_core.files import whole
from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_docking.clearance import FeltPose
from deltacharger_tactile.classifiers.classifier import Classifier
from deltacharger_tactile.classifiers.labels import TARGETS, centres, examples

FOLDER = "DELTACHARGER_PAPER_CLASSES"
"""Environment variable: the folder of the trained classifiers, for worker processes."""
NAME, MODEL = "paper_classes", "cnn"
RIGS, FIRST_RIG, SEED = 20, 1_000_000, 0  # devices of the training data, none of which docks
_KEY = ("estimator", "paper")


def are_wanted(content: Mapping[str, Any]) -> bool:
    """Return whether a scene's content asks for the paper's classes."""
    section = content.get(_KEY[0])
    return isinstance(section, Mapping) and section.get(_KEY[1]) is True


def prepare(campaign: Path, tell: Callable[[str], None]) -> None:
    """Train what is missing beside a campaign's folder, unless `FOLDER` names another place, and tell workers of it.

    Args:
        campaign: folder of the campaign.
        tell: told what takes minutes.

    Raises:
        ModuleNotFoundError: a classifier is missing and PyTorch is not installed.
    """
    folder = Path(os.environ.get(FOLDER) or campaign.absolute().parent / NAME)
    folder.mkdir(parents=True, exist_ok=True)
    missing = [target for target in TARGETS if not _file(folder, target).exists()]
    if missing:
        from deltacharger_tactile.generator import generate_paper

        data = generate_paper(rigs=range(FIRST_RIG, FIRST_RIG + RIGS), seed=SEED)
        for target in missing:
            tell(f"{folder}: training the paper's {MODEL} for {target}, some minutes; once")
            known = examples(data, target)
            model = Classifier(MODEL, target).fit(known.frames, known.labels, SEED)
            model.about = {"rigs": RIGS, "first_rig": FIRST_RIG, "seed": SEED}
            with whole(_file(folder, target)) as path:
                model.save(path)
    os.environ[FOLDER] = str(folder)


def digest() -> str:
    """Return 16 hexadecimal digits of the classifiers that dockings use here; "none" without them."""
    files = [_file(Path(os.environ.get(FOLDER, "")), target) for target in TARGETS]
    if FOLDER not in os.environ or not all(path.is_file() for path in files):
        return "none"
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


def _file(folder: Path, target: str) -> Path:
    return folder / f"{target}.npz"


class PaperClasses:
    """Tells whole degrees 0–5 and steps of 5 mm, without any doubt.

    Args:
        folder: of the trained classifiers.

    Raises:
        FileNotFoundError: they are not there.
    """

    def __init__(self, folder: Path) -> None:
        self._networks = {target: Classifier.load(_file(folder, target)) for target in TARGETS}

    def predict(self, left: Any, right: Any) -> FeltPose:
        """Return the classes' centres as an estimate; pads (10, 10) N that feel less than 1 N have no contact."""
        frame = np.stack((left, right))
        told = {target: float(centres(target)[net.predict(frame[None])[0]]) for target, net in self._networks.items()}
        return FeltPose(
            angle=told["angle"],
            angle_stddev=0.0,
            vertical=told["vertical"],
            vertical_stddev=0.0,
            horizontal=told["horizontal"],
            horizontal_stddev=0.0,
            contact=bool(np.nanmax(frame) >= CONTACT_FORCE),
        )


@functools.lru_cache(maxsize=2)
def paper_classes(folder: str) -> PaperClasses:
    """Return the classifiers of a folder, read once per process."""
    return PaperClasses(Path(folder))
