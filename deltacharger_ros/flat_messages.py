# SPDX-License-Identifier: Apache-2.0
"""Messages of a fixed size, published as bytes in which only the numbers change; stamps from the monotonic clock."""

from __future__ import annotations

import struct
import time
from array import array
from collections.abc import Sequence
from typing import Any

from rclpy.clock import Clock
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message

_CODES = {"boolean": "?", "uint8": "B", "int32": "i", "uint32": "I", "uint64": "Q", "float": "f", "double": "d"}
_LOOK = 0.1  # s between two looks at both clocks
_LOOKS = 3  # of which the quickest counts: in one of a hundred the thread is interrupted between the clocks


class Stamps:
    """Translates instants from the monotonic clock to a node's clock; used by one thread.

    The difference is measured ten times a second and not for every message: reading ROS time costs as much as filling
    a message, and meanwhile the two drift apart by 50 ns at most where the system's clock is being slewed.

    Args:
        clock: of the node.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._offset = 0  # ns
        self._due = -1.0

    def convert(self, instant: float) -> tuple[int, int]:
        """Return `instant` (s, monotonic) as the s and ns of a stamp."""
        now = time.monotonic()
        if now >= self._due:
            self._due = now + _LOOK
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

    ROS serialises the message once, and then numbers are written over its bytes: that spares the conversion of every
    field, which costs more than publishing itself. Where a field stands is found by setting it to a mark and looking
    for it; where writing the mark there does not read back as the field, messages are filled and published as usual.

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
        self._fields = [_Field(message, name) for name in fields]
        self._buffer = bytearray(serialize_message(message))
        stamp = [_Field(message.header.stamp, name) for name in ("sec", "nanosec")]
        views = [field.find(message, self._buffer) for field in (*stamp, *self._fields)]
        self._views = [view for view in views if view is not None]
        self.is_flat = len(self._views) == len(views)

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
        stamp = self._message.header.stamp
        stamp.sec, stamp.nanosec = sec, nanosec
        for field, row in zip(self._fields, rows, strict=True):
            field.set(row)
        self._publisher.publish(self._message)


class _Field:
    """A field of numbers: of a message, or the stamp's."""

    def __init__(self, owner: Any, name: str) -> None:
        self._owner, self._name = owner, name
        declared = owner.get_fields_and_field_types()[name]
        self._is_sequence = declared.startswith("sequence")
        self._code = _CODES[declared.removeprefix("sequence<").removesuffix(">")]

    def set(self, row: Sequence[Any]) -> None:
        """Set it to the numbers of `row`."""
        values = [bool(value) for value in row] if self._code == "?" else array(self._code, row)
        setattr(self._owner, self._name, values if self._is_sequence else values[0])

    def find(self, message: Any, buffer: bytearray) -> memoryview[Any] | None:
        """Return the field's part of the serialised `message`, which is `buffer`; None where it is not seen in it."""
        kept = getattr(self._owner, self._name)
        count = len(kept) if self._is_sequence else 1
        mark = (b"\1" if self._code == "?" else b"ABCDEFGH"[: struct.calcsize(self._code)]) * count
        self.set(struct.unpack(f"<{count}{self._code}", mark))
        marked = serialize_message(message)
        expected = _read(marked, type(message))
        found = -1
        while expected is not None and (found := marked.find(mark, found + 1)) >= 0:
            written = bytes(buffer[:found]) + mark + bytes(buffer[found + len(mark) :])
            if _read(written, type(message)) == expected:
                break
        setattr(self._owner, self._name, kept)
        if found < 0:
            return None
        code: Any = "B" if self._code == "?" else self._code
        return memoryview(buffer)[found : found + len(mark)].cast(code)


def _read(data: bytes, kind: Any) -> Any:
    """Return the message in `data`; None where there is none, as where a mark was written over a length."""
    try:
        return deserialize_message(data, kind)
    except Exception:  # each middleware has its own
        return None
