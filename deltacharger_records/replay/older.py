# SPDX-License-Identifier: Apache-2.0
"""Decode messages recorded by an older version whose definitions had fewer fields."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from deltacharger_core.mcap_file import RecordingError

_SEPARATOR = re.compile(r"\n=+\nMSG: ")
_BETWEEN_WORDS = re.compile(r"(?<=[a-z])_(?=[A-Z])")
Fields = dict[str, list[str]]


def fields(text: str) -> Fields:
    """Return the fields (type and name) of each message in a schema, without comments and constants; '' = the first."""
    first, *parts = _SEPARATOR.split(text)
    return {"": _own(first)} | {name: _own(part) for name, _, part in (each.partition("\n") for each in parts)}


def _own(text: str) -> list[str]:
    lines = (line.partition("#")[0].split() for line in text.splitlines())
    return [" ".join(words[:2]) for words in lines if words and "=" not in " ".join(words)]


def is_older(then: Fields, now: Fields) -> bool:
    """Whether `now` has all fields of `then`; the recording has no values for the added ones."""
    return all(set(own) <= set(now.get(name, ())) for name, own in then.items())


def older_decoder(definition: str, name: str, kind: Any) -> Callable[[bytes], Any]:
    """Return a decoder that reads type `name` by the file's `definition` and returns messages of `kind`.

    Numbers missing in the recording are NaN, if their type permits; all else has its default.

    Raises:
        RecordingError: mcap-ros2-support is not installed, or rejects the definition.
    """
    try:
        from mcap.records import Schema
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise RecordingError("recorded by an older version: pip install mcap-ros2-support") from error
    # Parts of an action have names such as Dock_Feedback, which are invalid for messages.
    text, plain = _BETWEEN_WORDS.sub("", definition), _BETWEEN_WORDS.sub("", name)
    schema = Schema(id=1, name=plain, encoding="ros2msg", data=text.encode())
    try:
        decoder = DecoderFactory().decoder_for("cdr", schema)
    except Exception as error:  # the parser may raise anything for foreign text
        raise RecordingError(f"the file's definition of {name} is not readable: {error}") from error
    assert decoder is not None
    return lambda data: _read(decoder, data, kind)


def _read(decoder: Callable[[bytes], Any], data: bytes, kind: Any) -> Any:
    try:
        return _filled(kind(), decoder(data))
    except Exception as error:  # foreign bytes may raise anything
        raise RecordingError(f"the file is damaged from here on: no {kind.__name__}: {error}") from error


def _filled(message: Any, recorded: Any) -> Any:
    """Return `message` with the fields of `recorded` copied into it."""
    for name, type_ in message.get_fields_and_field_types().items():
        now = getattr(message, name)
        if not hasattr(recorded, name):
            if type_ in ("double", "float"):
                setattr(message, name, math.nan)
            continue
        then = getattr(recorded, name)
        if hasattr(now, "get_fields_and_field_types"):
            _filled(now, then)
        elif isinstance(then, list) and then and hasattr(then[0], "__slots__"):
            raise TypeError(f"{name}: a list of messages")
        else:
            setattr(message, name, list(then) if isinstance(then, bytes) else then)
    return message
