# SPDX-License-Identifier: Apache-2.0
"""A trained classifier as a file: arrays and a description, without pickle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_tactile import npz
from deltacharger_tactile.classifiers.runtime import KINDS
from deltacharger_tactile.errors import ModelError

FORMAT = 1


def write(path: str | Path, about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write arrays and a description (`kind`, `name`, `target`, …) as npz."""
    every: dict[str, Any] = {"about": np.array(json.dumps({"format": FORMAT, **about}, sort_keys=True)), **arrays}
    np.savez_compressed(path, **every)


def shrunk(arrays: dict[str, NDArray[Any]], half: bool) -> dict[str, NDArray[Any]]:
    """Return arrays in the smallest integer types, and in float32 or rounded to `half`.

    Thresholds of trees are rounded down, so that every float32 reading stays on its side of "at most".
    """
    return {name: _shrunk(name, array, half) for name, array in arrays.items()}


def _shrunk(name: str, array: NDArray[Any], half: bool) -> NDArray[Any]:
    if array.dtype == bool:
        return array
    if np.issubdtype(array.dtype, np.integer):
        return array.astype(np.promote_types(np.min_scalar_type(array.min()), np.min_scalar_type(array.max())))
    small = array.astype(np.float32)
    if name == "threshold":
        return np.where(small > array, np.nextafter(small, np.float32(-np.inf)), small)
    return array.astype(np.float16) if half else small


def read(path: str | Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a file written by `write`.

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
