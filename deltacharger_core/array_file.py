# SPDX-License-Identifier: Apache-2.0
"""Arrays in the .npy format that somebody else may have written: looked at before memory is taken, never unpickled."""

from __future__ import annotations

import math
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

_LONGEST_HEADER = 10_000  # characters, as numpy has it
_MOST_AXES = 8
_BLOCK = 2**18


class ArrayError(ValueError):
    """A stream holds no array of numbers, truth values or text. Example: a header that claims 10 TB."""


def read_array(stream: IO[bytes], size: int) -> NDArray[Any]:
    """Return the array that a stream holds from here to its end.

    Args:
        stream: of bytes, read from where it stands; it may claim to be longer than it is.
        size: bytes that it has left.

    Raises:
        ArrayError: it is no .npy file, holds Python objects, or its header claims more or less than `size`.
    """
    try:
        shape, by_columns, kind, header = _header(stream)
    except Exception as error:  # numpy reads a header as a Python literal, and raises whatever that raises
        raise ArrayError(f"it has no header of an .npy file ({type(error).__name__})") from error
    plain = (kind.kind in "biuf" and kind.itemsize <= 8) or (kind.kind == "U" and kind.itemsize)
    if not plain or len(shape) > _MOST_AXES:
        raise ArrayError(f"it holds {len(shape)} axes of {str(kind)[:80]} and must hold numbers or text")
    needed = math.prod(shape) * kind.itemsize
    if needed != size - header or max(shape, default=0) > size:
        raise ArrayError(f"its header claims {needed} bytes, and {size - header} follow")
    content = np.empty(needed, dtype=np.uint8)
    for start in range(0, needed, _BLOCK):
        block = stream.read(min(_BLOCK, needed - start))
        if not block:
            raise ArrayError("it ends early")
        content[start : start + len(block)] = np.frombuffer(block, dtype=np.uint8)
    if kind.kind == "b" and content.max(initial=0) > 1:
        raise ArrayError("a truth value in it is neither true nor false")
    found = content.view(kind)
    return found.reshape(shape[::-1]).T if by_columns else found.reshape(shape)


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return shape, whether columns stand together, type, and the bytes that the header took."""
    begun = stream.tell()
    if np.lib.format.read_magic(stream) != (1, 0):  # others have headers that are too long
        raise ValueError("version")
    shape, by_columns, kind = np.lib.format.read_array_header_1_0(stream, max_header_size=_LONGEST_HEADER)
    if min(shape, default=0) < 0:
        raise ValueError("shape")
    return shape, by_columns, kind, stream.tell() - begun
