# SPDX-License-Identifier: Apache-2.0
"""Data set of generated or recorded dockings with known misalignment: the npz file and its checks."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import machine, texts
from deltacharger_core.arrays import LARGEST_DATASET, Array, Mask, NpzError, read_npz
from deltacharger_tactile.errors import DatasetError

SUBSET_CONTINUOUS, SUBSET_ANGLE, SUBSET_POSITION = -1, 0, 1
VERSION = 1


@dataclass(frozen=True)
class Dataset:
    """N rows, one or several per docking (attempt); the row-aligned arrays of the npz file.

    Attributes:
        left: (N, 10, 10) float32 N, the pad at +x, tared and thresholded; a dead taxel is 0.
        right: (N, 10, 10) float32 N, the pad at −x.
        tare: (N, 2, 10, 10) float32 N, subtracted baseline; NaN if the board does not report it.
        dead: (N, 2, 10, 10) taxels without a reading.
        angle: (N,) rad, commanded, signed.
        vertical: (N,) m, commanded.
        horizontal: (N,) m, commanded.
        contact_pose: (N, 3) m, m, rad: (horizontal, vertical, angle) in contact, jitter included; NaN = unknown.
        attempt: (N,) number of the docking, unique in the file.
        session: (N,) number of the session, unique in the file; one tare each.
        rig: (N,) seed of the simulated device, or the number of the real one.
        subset: (N,) 0 angle set, 1 position set, −1 continuous.
        current: (N,) A, contact current.
        force: (N,) N, total contact force; NaN = unknown.
        meta: origin of the data; if generated: protocol, seed, frames, threshold, parameters, digest.
    """

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    tare: NDArray[np.float32]
    dead: Mask
    angle: Array
    vertical: Array
    horizontal: Array
    contact_pose: Array
    attempt: NDArray[np.int64]
    session: NDArray[np.int64]
    rig: NDArray[np.int64]
    subset: NDArray[np.int64]
    current: Array
    force: Array
    meta: dict[str, Any]

    def __len__(self) -> int:
        return len(self.left)

    @property
    def simulated(self) -> bool:
        """Whether the data come from the contact generator, or were recorded from a simulated charger."""
        return "parameters" in self.meta or bool(self.meta.get("simulated"))

    @property
    def threshold(self) -> float:
        """N; lower readings are stored as 0; NaN = unknown."""
        return float(self.meta.get("threshold", float("nan")))

    def poses(self) -> Array:
        """Return (N, 3) m, m, rad: (horizontal, vertical, angle) in contact where known, else as commanded."""
        commanded = np.column_stack([self.horizontal, self.vertical, self.angle])
        return np.where(np.isfinite(self.contact_pose), self.contact_pose, commanded)

    def robot_frames(self) -> tuple[Array, Array]:
        """Return left, right (N, 10, 10) as in the robot's messages: NaN where dead."""
        left, right = self.left.astype(float), self.right.astype(float)
        left[self.dead[:, 0]] = np.nan
        right[self.dead[:, 1]] = np.nan
        return left, right

    def save(self, path: str | Path) -> None:
        """Write an npz file that loads without pickle; `meta` is a 0-d JSON string."""
        arrays = {name: getattr(self, name) for name in (*_NEEDED, *_OPTIONAL)}
        np.savez_compressed(path, meta=np.array(json.dumps(self.meta, sort_keys=True)), **arrays)

    @staticmethod
    def load(path: str | Path) -> Dataset:
        """Read a file written by `save`, or by another program with the same fields.

        `dead`, `contact_pose` and `force` may be missing: none dead, both others unknown.

        Raises:
            FileNotFoundError: no such file.
            DatasetError: not an npz file; an array is missing, has another shape, or holds invalid values.
        """
        source = str(path)
        try:
            meta, found = read_npz(path, "meta", LARGEST_DATASET)
        except NpzError as error:
            raise DatasetError(source, f"{error}; generate or record a data set") from error
        missing = [name for name in _NEEDED if name not in found]
        if missing:
            raise DatasetError(source, f"no array {', '.join(missing)}; generate or record the data again")
        arrays = {name: found[name] for name in (*_NEEDED, *_OPTIONAL) if name in found}
        if meta.get("version", VERSION) != VERSION:
            raise DatasetError(source, f"its meta is not of version {VERSION}; generate or record the data again")
        return Dataset(meta=meta, **_checked(source, arrays))


_INTEGERS = ("attempt", "session", "rig", "subset")
_NEEDED = ("left", "right", "tare", "angle", "vertical", "horizontal", "current", *_INTEGERS)
_OPTIONAL = ("dead", "contact_pose", "force")
_FRAME = (machine.ROWS, machine.COLUMNS)
_SHAPES = {
    "left": _FRAME,
    "right": _FRAME,
    "tare": (machine.PADS, *_FRAME),
    "dead": (machine.PADS, *_FRAME),
    "contact_pose": (3,),
}
_LARGEST_FORCE = 1e3  # N; larger values are in other units


def _checked(source: str, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return every array, with defaults for missing ones.

    Raises:
        DatasetError: a shape, type or value violates the format.
    """
    count = len(arrays["angle"]) if arrays["angle"].ndim else 0
    if not count:
        raise DatasetError(source, "it has no rows; generate or record some")
    arrays.setdefault("dead", np.zeros((count, machine.PADS, *_FRAME), dtype=bool))
    arrays.setdefault("contact_pose", np.full((count, 3), np.nan))
    arrays.setdefault("force", np.full(count, np.nan))
    for name, array in arrays.items():
        wanted = (count, *_SHAPES.get(name, ()))
        if array.shape != wanted:
            raise DatasetError(source, f"array {name} has shape {array.shape}; it must have {wanted}")
        if name in _INTEGERS and not np.issubdtype(array.dtype, np.integer):
            raise DatasetError(source, f"array {name} holds {array.dtype}; it must hold integers")
        if not np.issubdtype(array.dtype, np.number) and array.dtype != bool:
            raise DatasetError(source, f"array {name} holds {array.dtype}; it must hold numbers")
    _check_values(source, arrays)
    return arrays


def _check_values(source: str, arrays: dict[str, NDArray[Any]]) -> None:
    """Refuse forces and poses that are not finite, or in other units than N, m and rad."""
    bounds = [(name, arrays[name], _LARGEST_FORCE, "N; give 0 for a dead taxel") for name in ("left", "right")]
    bounds += [(name, arrays[name], *limit) for name, limit in texts.IN_TOUCH.items()]
    contact = zip(texts.IN_TOUCH.items(), np.nan_to_num(arrays["contact_pose"]).T, strict=True)
    bounds += [(f"contact_pose ({name})", column, *limit) for (name, limit), column in contact]
    for name, values, most, unit in bounds:
        for wrong in np.argwhere(~(np.abs(values) <= most))[:1]:
            problem = texts.outside(float(values[tuple(wrong)]), -most, most, unit)
            raise DatasetError(source, f"row {wrong[0]} of {name}: {problem}")
