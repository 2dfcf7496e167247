# SPDX-License-Identifier: Apache-2.0
"""What a reader of files is, to those who change its files at random: good ones, refusals, and what is sound."""

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
        name: of it.
        kind: of its files.
        place: of the file in a folder.
        good: such files.
        read: called with the path; returns what it made of it.
        refusals: which it raises for a bad file.
        sound: raises AssertionError where what was made is not as it must be.
        changes: mutations.
        beside: other files in the folder.
        names: whether a refusal names the file; else its caller does.
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
