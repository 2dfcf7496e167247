# SPDX-License-Identifier: Apache-2.0
"""Reads npz files of unknown origin: no pickle, bounded size, one kind of error."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from deltacharger_core.array_file import read_array
from deltacharger_core.bounded_file import FileRefused, open_file, parse_json, size_text

LARGEST_MODEL = 256 * 2**20
"""Largest size of a model's arrays, bytes."""
LARGEST_DATASET = 8 * 2**30
"""Largest size of a data set's arrays, bytes."""
_SMALL, _DENSEST = 64 * 2**20, 100
"""Bytes that any file may unpack to, plus this many per packed byte; recorded frames pack to a 15th."""


class NpzError(ValueError):
    """A file is not an npz file of arrays and a description. Example: a zip bomb; the message has no path."""


def read(path: str | Path, header: str, largest: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the JSON description in the array `header`, and all other arrays.

    Args:
        path: of the file.
        header: name of the 0-d string array.
        largest: most bytes of all arrays together.

    Raises:
        FileNotFoundError: no such file.
        NpzError: another format, damaged, too large, or contains Python objects.
    """
    try:
        with open_file(path, largest) as file, zipfile.ZipFile(file) as archive:
            arrays = _arrays(archive, min(largest, _SMALL + _DENSEST * os.fstat(file.fileno()).st_size))
        if header not in arrays:
            raise NpzError(f"it has no array {header}")
        described = parse_json(str(arrays.pop(header)))
    except FileNotFoundError:
        raise
    except FileRefused as error:
        raise NpzError(str(error.strerror)) from error
    except NpzError:
        raise
    except Exception as error:  # zipfile and numpy may raise anything on damaged files
        raise NpzError(f"it is not an npz file, or damaged ({type(error).__name__})") from error
    if not isinstance(described, dict):
        raise NpzError(f"its {header} is no JSON object")
    return described, arrays


def holds(path: str | Path, name: str) -> bool:
    """Whether a file is an npz file with this array; False also if it is missing or unreadable."""
    try:
        with open_file(path, LARGEST_DATASET) as file, zipfile.ZipFile(file) as archive:
            return f"{name}.npy" in archive.namelist()
    except Exception:  # as in `read`, which reports the error
        return False


def _arrays(archive: zipfile.ZipFile, largest: int) -> dict[str, NDArray[Any]]:
    members = archive.infolist()
    size = sum(member.file_size for member in members)
    if size > largest:
        raise NpzError(f"its arrays take {size_text(size)}, more than the {size_text(largest)} allowed")
    arrays: dict[str, NDArray[Any]] = {}
    for member in members:
        name = member.filename.removesuffix(".npy")
        if name in arrays or name == member.filename:
            raise NpzError(f"its member {member.filename[:80]!r} is a duplicate or no array")
        with archive.open(member) as stream:
            arrays[name] = read_array(stream, member.file_size)  # to the end, where the checksum is verified
    return arrays
