# SPDX-License-Identifier: Apache-2.0
"""A reader of files for fuzzing: good files, its errors, and checks of its results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fuzz_mutations as change
import numpy as np


@dataclass(frozen=True)
class Reader:
    """A reader.

    Attributes:
        name: of the reader.
        kind: of its files.
        place: relative path of the file.
        good: contents of good files.
        read: reads a path and returns the result.
        refusals: errors that it raises for a bad file.
        sound: raises AssertionError for an invalid result.
        changes: mutations.
        beside: other files in the folder.
        names: whether an error names the file; else its caller does.
    """

    name: str
    kind: str
    place: str
    good: Sequence[bytes]
    read: Callable[[Path], Any]
    refusals: tuple[type[Exception], ...]
    sound: Callable[[Any], None]
    changes: Sequence[change.Mutation]
    beside: dict[str, bytes] = field(default_factory=dict)
    names: bool = True


def finite(*values: Any) -> None:
    assert all(np.isfinite(np.asarray(value, dtype=float)).all() for value in values), values


def written(folder: Path, name: str, write: Callable[[Path], Any]) -> bytes:
    path = folder / name
    write(path)
    return path.read_bytes()
