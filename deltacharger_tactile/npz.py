# SPDX-License-Identifier: Apache-2.0
"""Reading npz files that somebody else may have written: no pickle, no surprise in size, one kind of error."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST_MODEL = 256 * 2**20
"""Bytes that the arrays of a model may take."""
LARGEST_DATASET = 8 * 2**30
"""Bytes that the arrays of a data set may take."""


class NpzError(ValueError):
    """A file is no npz file of arrays and a description. Example: a zip bomb; the message is a reason, without path."""


def read(path: str | Path, header: str, largest: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the description that stands as JSON in the array `header`, and every other array.

    Args:
        path: of the file.
        header: name of the 0-d string array.
        largest: bytes that all arrays together may take.

    Raises:
        FileNotFoundError: there is no such file.
        NpzError: it is something else, damaged, too large, or holds Python objects.
    """
    if Path(path).is_dir():
        raise NpzError("it is a folder")
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > largest:
            raise NpzError(f"its arrays take {size / 2**20:.0f} MB, more than the {largest / 2**20:.0f} MB allowed")
        with np.load(path, allow_pickle=False) as file:
            if header not in file.files:
                raise NpzError(f"it has no array {header}")
            described = json.loads(str(file[header]))
            arrays = {name: file[name] for name in file.files if name != header}
    except (NpzError, FileNotFoundError):
        raise
    except _DAMAGED as error:
        raise NpzError("it is no npz file, or damaged") from error
    if not isinstance(described, dict):
        raise NpzError(f"its {header} is no JSON object")
    return described, arrays


def holds(path: str | Path, name: str) -> bool:
    """Whether a file is an npz file with an array of this name; False where it is anything else or missing."""
    try:
        with zipfile.ZipFile(path) as archive:
            return f"{name}.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


_DAMAGED = (
    OSError,  # a stream that ends
    ValueError,  # pickled objects, a header that is none, JSON
    KeyError,
    TypeError,
    AttributeError,
    EOFError,
    MemoryError,  # a shape that lies
    RuntimeError,  # encrypted; JSON too deep; an unknown compression
    SyntaxError,  # numpy reads headers as Python literals
    zipfile.BadZipFile,
    zlib.error,
)
