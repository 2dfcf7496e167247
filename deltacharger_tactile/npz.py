# SPDX-License-Identifier: Apache-2.0
"""Reading npz files that somebody else may have written: no pickle, no surprise in size, one kind of error."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

from numpy.typing import NDArray

from deltacharger_core.array_file import read_array
from deltacharger_core.bounded_file import FileRefused, open_file, parse_json, size_text

LARGEST_MODEL = 256 * 2**20
"""Bytes that the arrays of a model may take."""
LARGEST_DATASET = 8 * 2**30
"""Bytes that the arrays of a data set may take."""
_SMALL, _DENSEST = 64 * 2**20, 100
"""Bytes that any file may unpack to, and how many more for each of its own; recorded frames pack to a 15th."""
_LONGEST_READ = 2**18  # bytes; the list of a zip file's members is read at once
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what numpy writes; others unpack without bounds
_ENDING = ".npy"


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
    try:
        with open_file(path, largest) as file, zipfile.ZipFile(_Bounded(file)) as archive:
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
    except Exception as error:  # zipfile and numpy raise of damaged files whatever they stumble over
        raise NpzError(f"it is no npz file, or damaged ({type(error).__name__})") from error
    if not isinstance(described, dict):
        raise NpzError(f"its {header} is no JSON object")
    return described, arrays


def holds(path: str | Path, name: str) -> bool:
    """Whether a file is an npz file with an array of this name; False where it is anything else or missing."""
    try:
        with open_file(path, LARGEST_DATASET) as file, zipfile.ZipFile(_Bounded(file)) as archive:
            return name + _ENDING in archive.namelist()
    except Exception:  # as in `read`, which tells what is wrong
        return False


def _arrays(archive: zipfile.ZipFile, largest: int) -> dict[str, NDArray[Any]]:
    members = archive.infolist()
    size = sum(member.file_size for member in members)
    if size > largest:
        raise NpzError(f"its arrays take {size_text(size)}, more than the {size_text(largest)} allowed")
    arrays: dict[str, NDArray[Any]] = {}
    for member in members:
        name = member.filename.removesuffix(_ENDING)
        if name in arrays or name == member.filename or member.compress_type not in _METHODS:
            raise NpzError(f"its member {member.filename[:80]!r} is there twice or no array as numpy writes it")
        with archive.open(member) as stream:
            arrays[name] = read_array(stream, member.file_size)  # to its end, where the checksum is compared
    return arrays


class _Bounded:
    """A file of which no more is read at once than an honest list of members takes."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.seek, self.tell, self.seekable, self.close = file.seek, file.tell, file.seekable, file.close

    def read(self, count: int = -1) -> bytes:
        found = self._file.read(_LONGEST_READ + 1 if count < 0 else count if count <= _LONGEST_READ else 0)
        if count > _LONGEST_READ or len(found) > _LONGEST_READ:
            raise NpzError("its list of members is too long")
        return found
