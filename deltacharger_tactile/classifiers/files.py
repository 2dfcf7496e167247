# SPDX-License-Identifier: Apache-2.0
"""A trained classifier as a file: arrays and a description, without pickle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_tactile import npz
from deltacharger_tactile.classifiers.runtime import KINDS
from deltacharger_tactile.errors import ModelError

FORMAT = 1


def read(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the description (`kind`, `name`, `target`, …) and the arrays of a file.

    Raises:
        FileNotFoundError: no such file.
        ModelError: another kind of file or version, or the arrays do not fit together.
    """
    try:
        about, arrays = npz.read(path, "about", npz.LARGEST_MODEL)
    except npz.NpzError as error:
        raise ModelError(str(path), str(error)) from error
    if about.get("format") != FORMAT or about.get("kind") not in KINDS:
        found = f"format {about.get('format')}, kind '{about.get('kind')}'"
        raise ModelError(str(path), f"{found} is unknown to this version; train it again")
    if not all(np.issubdtype(array.dtype, np.number) or array.dtype == bool for array in arrays.values()):
        raise ModelError(str(path), "an array holds no numbers")
    if not all(np.all(np.isfinite(array)) for array in arrays.values()):
        raise ModelError(str(path), "an array holds NaN or infinity")
    if "feature" in arrays:
        _check_trees(str(path), arrays)
    return about, full(arrays)


def full(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return arrays with float16, which only files use, converted to float32."""
    return {name: array.astype(np.float32) if array.dtype == np.float16 else array for name, array in arrays.items()}


def _check_trees(path: str, arrays: dict[str, NDArray[Any]]) -> None:
    """Refuse trees whose traversal might not end: children must follow their parent in the table."""
    try:
        inner = np.flatnonzero(arrays["feature"] >= 0)
        count = len(arrays["feature"])
        children = np.stack([arrays["left"][inner], arrays["right"][inner]])
        same = all(len(arrays[name]) == count for name in ("threshold", "left", "right", "value"))
        rooted = len(arrays["root"]) > 0 and np.all((arrays["root"] >= 0) & (arrays["root"] < count))
        sound = same and rooted and np.all(children > inner) and np.all(children < count)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise ModelError(path, "its trees are not complete") from error
    if not sound:
        raise ModelError(path, "its trees are not trees")
