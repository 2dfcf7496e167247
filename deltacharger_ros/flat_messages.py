# SPDX-License-Identifier: Apache-2.0
"""Messages of a fixed size, published as bytes in which only the numbers change; stamps from the monotonic clock."""

from __future__ import annotations

import struct
import time
from array import array
from collections.abc import Sequence
from typing import Any

from rclpy.clock import Clock, ROSClock
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message

_CODES = {"boolean": "?", "uint8": "B", "int32": "i", "uint32": "I", "uint64": "Q", "float": "f", "double": "d"}
_SEQUENCE = "sequence<"
_HEAD = 4  # bytes in front of a message's CDR: its kind
_LOOK = 0.1  # s between two looks at both clocks
_LOOKS = 3  # of which the quickest counts: in one of a hundred the thread is interrupted between the clocks


class Stamps:
    """Translates instants from the monotonic clock to a node's clock; used by one thread.

    The difference is measured ten times a second and not for every message: reading ROS time costs as much as filling
    a message, and meanwhile the two drift apart by 50 ns at most where the system's clock is being slewed. A clock that
    follows /clock runs at any rate, so there it is measured each time.

    Args:
        clock: of the node.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._follows = False
        self._offset = 0  # ns
        self._due = -1.0

    def convert(self, instant: float) -> tuple[int, int]:
        """Return `instant` (s, monotonic) as the s and ns of a stamp."""
        now = time.monotonic()
        if self._follows or now >= self._due:
            self._due = now + _LOOK
            self._follows = isinstance(self._clock, ROSClock) and self._clock.ros_time_is_active
            self._offset = min(self._look() for _ in range(_LOOKS))[1]
        return divmod(max(int(instant * 1e9) + self._offset, 0), 1_000_000_000)

    def _look(self) -> tuple[int, int]:
        """Return how long, ns, a look at both clocks took, and by how much the node's is ahead."""
        before = time.monotonic_ns()
        there = int(self._clock.now().nanoseconds)
        after = time.monotonic_ns()
        return after - before, there - (before + after) // 2


class FlatPublisher:
    """Publishes one stamped message again and again with other numbers in it.

    ROS serialises the message once, and then numbers are written over its bytes: with servo_state and tactile_frame
    filled and serialised each time, the bench scene at rest took 8 % more processor time. Where the numbers stand
    follows from the types of the fields, as plain CDR, and is tried once; where they are read back otherwise, messages
    are filled and published as usual.

    Args:
        publisher: of a type with a header.
        message: every string set, every sequence as long as it shall be and zero.
        fields: names of the fields that change, in the order of `publish`'s arguments; the stamp always does.
        stamps: translates the instants of `publish`.

    Attributes:
        is_flat: whether the message goes out as bytes.
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
            rows: what each field becomes, also one of a single number: a one-dimensional array of its type, of the
                standard library or of numpy; bytes for uint8 and for booleans.
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
        """Return whether marks, written over the bytes, are read as the fields."""
        bytes_before, before = bytes(self._buffer), [field.value for field in self._fields]
        try:
            for field, view in zip(self._fields, self._views, strict=True):
                marks = field.marks()
                view.cast("B")[:] = marks
                field.set(struct.unpack(f"{len(view)}{field.code}", marks))
            kind, usual = type(self._message), serialize_message(self._message)
            return bool(deserialize_message(bytes(self._buffer), kind) == deserialize_message(usual, kind))
        except Exception:  # each middleware has its own
            return False
        finally:
            self._buffer[:] = bytes_before
            for field, value in zip(self._fields, before, strict=True):
                field.value = value


class _Field:
    """A field of numbers: of a message, or the stamp's.

    Attributes:
        code: of its numbers, as `struct` calls them.
    """

    def __init__(self, owner: Any, name: str) -> None:
        self._owner, self._name = owner, name
        declared = owner.get_fields_and_field_types()[name]
        self._is_sequence = declared.startswith(_SEQUENCE)
        self.code = _CODES[declared.removeprefix(_SEQUENCE).removesuffix(">")]

    @property
    def value(self) -> Any:
        """What the message holds."""
        return getattr(self._owner, self._name)

    @value.setter
    def value(self, value: Any) -> None:
        setattr(self._owner, self._name, value)

    def set(self, row: Sequence[Any]) -> None:
        """Set it to the numbers of `row`."""
        values = [bool(value) for value in row] if self.code == "?" else array(self.code, row)
        self.value = values if self._is_sequence else values[0]

    def marks(self) -> bytes:
        """Return as many numbers as it has, in whose bytes an error of place shows."""
        mark = b"\1" if self.code == "?" else b"ABCDEFGH"[: struct.calcsize(self.code)]
        return mark * (len(self.value) if self._is_sequence else 1)


def _places(message: Any, begin: int = 0, prefix: str = "") -> dict[str, tuple[int, int, str]]:
    """Return where each field of a message stands in its CDR behind the head: begin, end (bytes), code of its numbers.

    In plain CDR each number stands at a multiple of its size. A string or sequence is its length as a uint32, then what
    it holds; a string ends with a zero. Fields of messages in it have dotted names; its own is `prefix`.
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
