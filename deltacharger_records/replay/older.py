# SPDX-License-Identifier: Apache-2.0
"""Messages that were recorded before their definitions got further fields, read by the definition in the file."""

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
    """Whether messages have all fields that they had `then`; what came to them is unknown of a recording."""
    return all(set(own) <= set(now.get(name, ())) for name, own in then.items())


def older_decoder(definition: str, name: str, kind: Any) -> Callable[[bytes], Any]:
    """Return what decodes messages by the `definition` in the file of the type `name` into ones of `kind`.

    Numbers that the recording does not tell are NaN, where their type can be, and all else is as in a new message.

    Raises:
        RecordingError: mcap-ros2-support is not installed, or does not understand the definition.
    """
    try:
        from mcap.records import Schema
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise RecordingError("an older version recorded this: pip install mcap-ros2-support") from error
    # The parts of an action are named as messages may not be: Dock_Feedback.
    text, plain = _BETWEEN_WORDS.sub("", definition), _BETWEEN_WORDS.sub("", name)
    schema = Schema(id=1, name=plain, encoding="ros2msg", data=text.encode())
    try:
        decoder = DecoderFactory().decoder_for("cdr", schema)
    except Exception as error:  # of a parser of foreign text
        raise RecordingError(f"its definition of {name} in the file is not understood: {error}") from error
    assert decoder is not None
    return lambda data: _read(decoder, data, kind)


def _read(decoder: Callable[[bytes], Any], data: bytes, kind: Any) -> Any:
    try:
        return _filled(kind(), decoder(data))
    except Exception as error:  # whatever foreign bytes make of it
        raise RecordingError(f"the file is damaged from here on: no {kind.__name__}: {error}") from error


def _filled(message: Any, told: Any) -> Any:
    """Return `message` with what was told in place of what it holds."""
    for name, type_ in message.get_fields_and_field_types().items():
        now = getattr(message, name)
        if not hasattr(told, name):
            if type_ in ("double", "float"):
                setattr(message, name, math.nan)
            continue
        then = getattr(told, name)
        if hasattr(now, "get_fields_and_field_types"):
            _filled(now, then)
        elif isinstance(then, list) and then and hasattr(then[0], "__slots__"):
            raise TypeError(f"{name}: a list of messages")
        else:
            setattr(message, name, list(then) if isinstance(then, bytes) else then)
    return message
