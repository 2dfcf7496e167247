# SPDX-License-Identifier: Apache-2.0
"""Publishes messages of fixed size as bytes in which only numbers change; stamps from the monotonic clock."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence
from typing import Any

from rclpy.clock import Clock
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message

from deltacharger_core.host_clock import HOST, HostClock
from deltacharger_ros.clock import follows

_CODES = {"boolean": "?", "uint8": "B", "int32": "i", "uint32": "I", "uint64": "Q", "float": "f", "double": "d"}
_SEQUENCE = "sequence<"
_HEAD = 4  # bytes of the header of a message's CDR
_LOOK = 0.1  # s between checks whether the node follows /clock


class Stamps:
    """Converts times from the monotonic clock to a node's clock; used by one thread.

    Reading ROS time costs as much as filling a message, so it is read for each stamp only if the node follows /clock,
    whose rate is arbitrary.

    Args:
        clock: clock of the node.
        host: clock of the computer.
    """

    def __init__(self, clock: Clock, host: HostClock = HOST) -> None:
        self._clock, self._host = clock, host
        self._follows = False
        self._due = -1.0

    def convert(self, instant: float) -> tuple[int, int]:
        """Return `instant` (s, monotonic) as s and ns of a stamp."""
        if (now := self._host.now()) >= self._due:
            self._due, self._follows = now + _LOOK, follows(self._clock)
        # An interruption between the clocks makes the stamp older, not younger.
        lead = int(self._clock.now().nanoseconds - 1e9 * self._host.now()) if self._follows else self._host.lead()
        return divmod(max(int(instant * 1e9) + lead, 0), 1_000_000_000)


class FlatPublisher:
    """Publishes one stamped message repeatedly with new numbers.

    ROS serialises the message once; then numbers are written over its bytes. Filling and serialising servo_state and
    tactile_frame each time cost the bench scene at rest 8 % more processor time. The offsets follow from the field
    types (plain CDR) and are tested once. If the test fails, messages are filled and published as usual.

    Args:
        publisher: of a type with a header.
        message: with every string set, and every sequence at its final length and zero.
        fields: names of the changing fields, in the order of `publish`'s arguments; the stamp always changes.
        stamps: converts the times of `publish`.

    Attributes:
        is_flat: whether the message is published as bytes.
    """

    def __init__(self, publisher: Publisher[Any], message: Any, fields: Sequence[str], stamps: Stamps) -> None:
        self._publisher = publisher
        self._message = message
        self._stamps = stamps
        self._fields = [_Field(message.header.stamp, name) for name in ("sec", "nanosec")]
        self._fields += [_Field(message, name) for name in fields]
        self._buffer = bytearray(serialize_message(message))
        places = _places(message)
        stamp = ("header.stamp.sec", "header.stamp.nanosec")
        self._views = [_view(self._buffer, *places[name]) for name in (*stamp, *fields)]
        self.is_flat = self._reads_back()

    def publish(self, instant: float, *rows: Any) -> None:
        """Publish the message, stamped `instant` (s, monotonic).

        Args:
            rows: new content of each field, also of a single number: a one-dimensional array of its type (standard
                library or numpy); bytes for uint8 and booleans.
        """
        sec, nanosec = self._stamps.convert(instant)
        if self.is_flat:
            views = self._views
            views[0][0], views[1][0] = sec, nanosec
            for index, row in enumerate(rows, 2):
                views[index][:] = row
            self._publisher.publish(bytes(self._buffer))
            return
        for field, row in zip(self._fields, ((sec,), (nanosec,), *rows), strict=True):
            field.set(row)
        self._publisher.publish(self._message)

    def _reads_back(self) -> bool:
        """Return whether test patterns written to the bytes are read back as the fields."""
        bytes_before, before = bytes(self._buffer), [field.value for field in self._fields]
        try:
            for field, view in zip(self._fields, self._views, strict=True):
                marks = field.marks()
                view.cast("B")[:] = marks
                field.set(struct.unpack(f"{len(view)}{field.code}", marks))
            kind, usual = type(self._message), serialize_message(self._message)
            return bool(deserialize_message(bytes(self._buffer), kind) == deserialize_message(usual, kind))
        except Exception:  # each middleware raises its own
            return False
        finally:
            self._buffer[:] = bytes_before
            for field, value in zip(self._fields, before, strict=True):
                field.value = value


class _Field:
    """A numeric field of a message or of its stamp.

    Attributes:
        code: `struct` code of its numbers.
    """

    def __init__(self, owner: Any, name: str) -> None:
        self._owner, self._name = owner, name
        declared = owner.get_fields_and_field_types()[name]
        self._is_sequence = declared.startswith(_SEQUENCE)
        self.code = _CODES[declared.removeprefix(_SEQUENCE).removesuffix(">")]

    @property
    def value(self) -> Any:
        """Value in the message."""
        return getattr(self._owner, self._name)

    @value.setter
    def value(self, value: Any) -> None:
        setattr(self._owner, self._name, value)

    def set(self, row: Sequence[Any]) -> None:
        """Set the field to the numbers of `row`."""
        values = [bool(value) for value in row] if self.code == "?" else array(self.code, row)
        self.value = values if self._is_sequence else values[0]

    def marks(self) -> bytes:
        """Return a test pattern of its size, whose bytes reveal a wrong offset."""
        mark = b"\1" if self.code == "?" else b"ABCDEFGH"[: struct.calcsize(self.code)]
        return mark * (len(self.value) if self._is_sequence else 1)


def _places(message: Any, begin: int = 0, prefix: str = "") -> dict[str, tuple[int, int, str]]:
    """Return begin, end (bytes behind the CDR header) and `struct` code of each field of a message.

    In plain CDR each number is aligned to its size. A string or sequence is its length as uint32, then its content; a
    string ends with a zero. Fields of nested messages have dotted names; the message itself has the name `prefix`.
    """
    found: dict[str, tuple[int, int, str]] = {}
    at = begin

    def append(code: str, count: int = 1) -> tuple[int, int, str]:
        nonlocal at
        size = struct.calcsize(code)
        first = -(-at // size) * size
        at = first + size * count
        return first, at, code

    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        is_sequence = kind.startswith(_SEQUENCE)
        if is_sequence:
            append("I")
        code = _CODES.get(kind.removeprefix(_SEQUENCE).removesuffix(">"))
        if code is not None:
            found[prefix + name] = append(code, len(value) if is_sequence else 1)
            continue
        for each in value if is_sequence else [value]:
            if isinstance(each, str):
                append("I")
                at += len(each.encode()) + 1
            else:
                found |= (inner := _places(each, at, f"{prefix}{name}."))
                at = inner[f"{prefix}{name}."][1]
    return found | {prefix: (begin, at, "B")}


def _view(buffer: bytearray, begin: int, end: int, code: str) -> memoryview[Any]:
    as_code: Any = "B" if code == "?" else code
    view: memoryview[Any] = memoryview(buffer)[_HEAD + begin : _HEAD + end].cast(as_code)
    return view
