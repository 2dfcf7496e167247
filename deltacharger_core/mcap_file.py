# SPDX-License-Identifier: Apache-2.0
"""Reads MCAP recordings, complete, truncated or damaged, without ROS.

Messages stay CDR bytes; callers that have ROS decode them. Needs the package mcap (`deltacharger[record]`).
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from deltacharger_core.bounded_file import open_file
from deltacharger_core.mcap_records import (
    ATTACHMENT,
    CHANNEL,
    LARGEST_FILE,
    MESSAGE,
    METADATA,
    METADATA_INDEX,
    SCHEMA,
    STATISTICS,
    EndsEarly,
    Records,
)
from deltacharger_core.picklable import Picklable

CUT_SHORT = "the file ends early: its recorder was stopped"
"""Reason for a truncated but otherwise valid file."""

_LONGEST = 300  # characters of a reason


class RecordingError(Picklable, RuntimeError):
    """A recording cannot be written or read. The message states the reason and the remedy."""


class DamagedRecording(RecordingError):
    """A recording is truncated or damaged.

    Args:
        path: file.
        reason: the defect, or CUT_SHORT.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.reason = reason


class Raw(NamedTuple):
    """A message as received.

    Attributes:
        topic: name.
        received: time of reception, ns since 1970.
        published: publisher's time, ns since 1970; `received` if unknown.
        data: CDR.
    """

    topic: str
    received: int
    published: int
    data: bytes


class McapFile:
    """An MCAP file, described by its index. Without an index (recorder killed, damage) the complete file is scanned.

    Args:
        path: file.

    Attributes:
        types: message type of each topic, such as std_msgs/msg/Header; '' = untyped.
        definitions: message definition of each topic.
        counts: number of messages of each topic.
        metadata: names and values in file order.
        first, last: reception of the earliest and latest message, ns since 1970; 0 if there is none.
        damage: why the scan stopped early; '' = the file has an index or is complete.

    Raises:
        RecordingError: mcap is not installed, or this is no MCAP file.
        OSError: the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        require_mcap()
        self.path = path
        self.types: dict[str, str] = {}
        self.definitions: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.first = self.last = 0
        self.damage = ""
        with open_file(path, LARGEST_FILE) as stream:
            empty = not os.fstat(stream.fileno()).st_size
        if empty:
            raise RecordingError(f"{path} is empty: its recorder stopped before it wrote anything")
        if not self._read_index():
            self._scan()

    def metadata_named(self, name: str) -> list[dict[str, str]]:
        """Return all metadata with this name."""
        return [values for each, values in self.metadata if each == name]

    def messages(self, *topics: str) -> Iterator[Raw]:
        """Yield the messages of the given topics (none given = all) in file order.

        Raises:
            DamagedRecording: the file is truncated or damaged from here on.
        """
        names: dict[int, str] = {}
        for opcode, record in self._walk():
            if opcode == CHANNEL and (not topics or record.topic in topics):
                names[record.id] = record.topic
            elif opcode == MESSAGE and record.channel in names:
                yield Raw(names[record.channel], record.received, record.published, bytes(record.data))

    def attachment(self, name: str) -> bytes:
        """Return the attachment with this name.

        Raises:
            DamagedRecording: the file is damaged before it.
            KeyError: there is none.
        """
        for _, record in self._walk((ATTACHMENT,)):
            if record.name == name:
                return bytes(record.data)
        raise KeyError(name)

    def _read_index(self) -> bool:
        """Read the index at the end of a complete file; return whether it is complete."""
        try:
            with open_file(self.path, LARGEST_FILE) as stream:
                records = Records(stream)
                summary = records.summary()
                schemas, channels, places = (summary.get(kind, []) for kind in (SCHEMA, CHANNEL, METADATA_INDEX))
                (statistics,) = summary[STATISTICS]
                counts = statistics.channel_message_counts
                if len(channels) != statistics.channel_count or len(places) != statistics.metadata_count:
                    return False
                if sum(counts.values()) != statistics.message_count or not counts.keys() <= {c.id for c in channels}:
                    return False
                metadata = [records.read(each.offset, METADATA) for each in places]
        except OSError:
            raise
        except Exception:  # truncated, damaged or no MCAP file: the scan finds out
            return False
        named = {schema.id: schema for schema in schemas}
        for channel in channels:
            self._add_channel(channel, named.get(channel.schema_id))
            self.counts[channel.topic] += counts.get(channel.id, 0)
        self.metadata = [(each.name, dict(each.metadata)) for each in metadata]
        self.first, self.last = statistics.message_start_time, statistics.message_end_time
        return True

    def _scan(self) -> None:
        schemas, topics, begun = dict[int, Any](), dict[int, str](), False
        try:
            for opcode, record in self._walk():
                begun = True
                if opcode == SCHEMA:
                    schemas[record.id] = record
                elif opcode == CHANNEL:
                    topics[record.id] = record.topic
                    self._add_channel(record, schemas.get(record.schema_id))
                elif opcode == METADATA:
                    self.metadata.append((record.name, dict(record.metadata)))
                elif opcode == MESSAGE and record.channel in topics:
                    self.counts[topics[record.channel]] += 1
                    self.first = min(self.first or record.received, record.received)
                    self.last = max(self.last, record.received)
        except DamagedRecording as error:
            if not begun:
                raise RecordingError(f"{self.path} is no MCAP file") from error
            self.damage = error.reason

    def _add_channel(self, channel: Any, schema: Any) -> None:
        self.types.setdefault(channel.topic, schema.name if schema else "")
        self.definitions.setdefault(channel.topic, schema.data.decode(errors="replace") if schema else "")

    def _walk(self, wanted: Collection[int] = ()) -> Iterator[tuple[int, Any]]:
        """Yield the records of the file from its beginning."""
        with open_file(self.path, LARGEST_FILE) as stream:
            try:
                yield from Records(stream).walk(wanted)
            except EndsEarly as error:
                raise DamagedRecording(self.path, CUT_SHORT) from error
            except OSError:
                raise
            except Exception as error:  # on damage zstandard, lz4, struct or mcap raise their own errors
                raise DamagedRecording(self.path, f"the file is damaged from here on: {error}"[:_LONGEST]) from error


def require_mcap() -> None:
    """Raise RecordingError if the package mcap is missing; call before anything moves."""
    try:
        import mcap.reader
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise RecordingError(
            f"{error.name} is not installed; install deltacharger[record], or `pip install mcap`"
        ) from error
