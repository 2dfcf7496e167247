# SPDX-License-Identifier: Apache-2.0
"""Type aliases of arrays, and arrays in untrusted .npy and .npz files. Docstrings state shapes, units and frames."""

from __future__ import annotations

import os
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.files import FileRefused, open_file, parse_json, size_text

if TYPE_CHECKING:
    import zipfile

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


class ArrayError(ValueError):
    """The stream holds no array of numbers, booleans or text. Example: a header that claims 10 TB."""


def read_array(stream: IO[bytes]) -> NDArray[Any]:
    """Return the array stored from the current position to the end of a stream.

    numpy reads it in blocks, so one that claims more than it holds takes no memory.

    Raises:
        ArrayError: this is no .npy file, it holds Python objects, or its header does not match its size.
    """
    try:
        found = np.lib.format.read_array(stream, allow_pickle=False)
    except Exception as error:  # numpy parses the header as a Python literal, which may raise anything
        raise ArrayError(f"it is no valid .npy file ({type(error).__name__})") from error
    if found.dtype.kind not in "biufU":
        raise ArrayError(f"it holds {str(found.dtype)[:80]}; allowed are numbers, booleans or text")
    if stream.read(1):
        raise ArrayError("it is longer than its header claims")
    return found


LARGEST_MODEL = 256 * 2**20
"""Largest size of a model's arrays, bytes."""
LARGEST_DATASET = 8 * 2**30
"""Largest size of a data set's arrays, bytes."""
_SMALL, _DENSEST = 64 * 2**20, 100
"""Bytes that any file may unpack to, plus this many per packed byte; recorded frames pack to a 15th."""


class NpzError(ValueError):
    """A file is not an npz file of arrays and a description. Example: a zip bomb; the message has no path."""


def read_npz(path: str | Path, header: str, largest: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the JSON description in the array `header`, and all other arrays.

    Args:
        path: of the file.
        header: name of the 0-d string array.
        largest: most bytes of all arrays together.

    Raises:
        FileNotFoundError: no such file.
        NpzError: another format, damaged, too large, or contains Python objects.
    """
    import zipfile  # here, because nodes that read no such file do without its 10 ms

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
            arrays[name] = read_array(stream)  # to the end, where the checksum is verified
    return arrays
