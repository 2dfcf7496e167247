# SPDX-License-Identifier: Apache-2.0
"""Reads .npy arrays from untrusted files: checks the header before allocating memory and never unpickles."""

from __future__ import annotations

import math
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

_LONGEST_HEADER = 10_000  # characters, as numpy has it
_MOST_AXES = 8
_BLOCK = 2**18


class ArrayError(ValueError):
    """The stream holds no array of numbers, booleans or text. Example: a header that claims 10 TB."""


def read_array(stream: IO[bytes], size: int) -> NDArray[Any]:
    """Return the array stored from the current position to the end of a stream.

    Args:
        stream: byte stream; it may be shorter than it claims.
        size: bytes left in the stream.

    Raises:
        ArrayError: this is no .npy file, it holds Python objects, or its header does not match `size`.
    """
    try:
        shape, by_columns, kind, header = _header(stream)
    except Exception as error:  # numpy parses the header as a Python literal, which may raise anything
        raise ArrayError(f"it has no valid .npy header ({type(error).__name__})") from error
    plain = (kind.kind in "biuf" and kind.itemsize <= 8) or (kind.kind == "U" and kind.itemsize)
    if not plain or len(shape) > _MOST_AXES:
        held = f"it holds an array of {str(kind)[:80]} with {len(shape)} axes"
        raise ArrayError(f"{held}; allowed are numbers, booleans or text with at most {_MOST_AXES} axes")
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
        raise ArrayError("a boolean in it is neither 0 nor 1")
    found = content.view(kind)
    return found.reshape(shape[::-1]).T if by_columns else found.reshape(shape)


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return shape, whether the order is by columns, type, and the header's size in bytes."""
    start = stream.tell()
    if np.lib.format.read_magic(stream) != (1, 0):  # newer versions allow longer headers
        raise ValueError("version")
    shape, by_columns, kind = np.lib.format.read_array_header_1_0(stream, max_header_size=_LONGEST_HEADER)
    if min(shape, default=0) < 0:
        raise ValueError("shape")
    return shape, by_columns, kind, stream.tell() - start
