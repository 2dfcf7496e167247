"""A trained classifier as a file: arrays and a description, without pickle."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_tactile.classifiers.runtime import KINDS
from deltacharger_tactile.errors import ModelError

FORMAT = 1


def write(path: str | Path, about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write arrays and a description (`kind`, `name`, `target`, …) as npz."""
    every: dict[str, Any] = {"about": np.array(json.dumps({"format": FORMAT, **about}, sort_keys=True)), **arrays}
    np.savez_compressed(path, **every)


def read(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read what `write` wrote.

    Raises:
        ModelError: it is no such file, or of another version.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files if name != "about"}
            about = json.loads(str(file["about"]))
    except (KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ModelError(str(path), "it is no classifier in npz format") from error
    if about.get("format") != FORMAT or about.get("kind") not in KINDS:
        found = f"format {about.get('format')}, kind '{about.get('kind')}'"
        raise ModelError(str(path), f"{found} is not known to this version; train it anew")
    return about, arrays
