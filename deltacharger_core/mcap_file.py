# SPDX-License-Identifier: Apache-2.0
"""What stands in an MCAP file, whole, cut short or damaged: the one reader of recordings, without ROS.

Messages stay the bytes that came over the wire (CDR); who has ROS decodes them. Needs the package mcap,
`deltacharger[record]`.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

CUT_SHORT = "the file ends early: its recorder was stopped"
"""Why reading ended in a file that is whole as far as it goes."""

_LARGEST = 2**28  # bytes of one record of the file; more is damage


class RecordingError(RuntimeError):
    """A recording cannot be written or read; the message says why and what to do."""


class DamagedRecording(RecordingError):
    """A recording ends before its end.

    Args:
        path: of the file.
        reason: what is wrong with it, or CUT_SHORT.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.reason = reason


class Raw(NamedTuple):
    """A message as it came.

    Attributes:
        topic: its name as the topic's owner and reader know it.
        received: when, ns since 1970.
        published: when by its publisher, ns since 1970; `received` where that is not known.
        data: CDR.
    """

    topic: str
    received: int
    published: int
    data: bytes


class McapFile:
    """An MCAP file: what its index tells, or a look through all of it where a kill or damage left none.

    Args:
        path: of the file.

    Attributes:
        types: name of each topic's message type, such as std_msgs/msg/Header; '' = untyped.
        definitions: text of each topic's message definition.
        counts: messages of each topic.
        metadata: name and values, in the order of the file.
        first, last: when the earliest and the latest message came, ns since 1970; 0 where there is none.
        damage: why looking through it ended before the end; '' = it has an index, or is whole.

    Raises:
        RecordingError: mcap is not installed, or this is no MCAP file.
        OSError: it cannot be read.
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
        if path.stat().st_size == 0:
            raise RecordingError(f"{path} is empty: its recorder was stopped before it had written anything")
        if not self._read_index():
            self._look_through()

    def told(self, name: str) -> list[dict[str, str]]:
        """Return the metadata of one name."""
        return [values for each, values in self.metadata if each == name]

    def messages(self, *topics: str) -> Iterator[Raw]:
        """Yield the messages of some topics, or of all, in the order of the file.

        Raises:
            DamagedRecording: the file ends early, or is damaged from here on.
        """
        from mcap.records import Channel, Message

        names: dict[int, str] = {}
        for record in self._records():
            if isinstance(record, Channel) and (not topics or record.topic in topics):
                names[record.id] = record.topic
            elif isinstance(record, Message) and record.channel_id in names:
                yield Raw(names[record.channel_id], record.log_time, record.publish_time, record.data)

    def attachments(self) -> dict[str, bytes]:
        """Return the attached files by name.

        Raises:
            DamagedRecording: they cannot be read.
        """
        from mcap.reader import make_reader

        with self.path.open("rb") as stream:
            try:
                return {each.name: each.data for each in make_reader(stream).iter_attachments()}
            except Exception as error:
                raise DamagedRecording(self.path, f"the file is damaged: {error}") from error

    def _read_index(self) -> bool:
        """Take what stands at the end of a file that was ended; return whether it tells everything."""
        from mcap.reader import make_reader

        with self.path.open("rb") as stream:
            try:
                reader = make_reader(stream)
                summary = reader.get_summary()
                statistics = summary.statistics if summary is not None else None
                if summary is None or statistics is None or len(summary.channels) != statistics.channel_count:
                    return False
                if len(summary.metadata_indexes) != statistics.metadata_count:
                    return False
                metadata = [(each.name, dict(each.metadata)) for each in reader.iter_metadata()]
            except Exception:  # cut short, damaged or no MCAP file, which looking through it tells
                return False
        for number, channel in summary.channels.items():
            self._meet(channel, summary.schemas.get(channel.schema_id))
            self.counts[channel.topic] += statistics.channel_message_counts.get(number, 0)
        self.metadata = metadata
        self.first, self.last = statistics.message_start_time, statistics.message_end_time
        return True

    def _look_through(self) -> None:
        from mcap.records import Channel, Message, Metadata, Schema

        schemas, topics, begun = dict[int, Any](), dict[int, str](), False
        try:
            for record in self._records():
                begun = True
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    topics[record.id] = record.topic
                    self._meet(record, schemas.get(record.schema_id))
                elif isinstance(record, Metadata):
                    self.metadata.append((record.name, dict(record.metadata)))
                elif isinstance(record, Message) and record.channel_id in topics:
                    self.counts[topics[record.channel_id]] += 1
                    self.first = min(self.first or record.log_time, record.log_time)
                    self.last = max(self.last, record.log_time)
        except DamagedRecording as error:
            if not begun:
                raise RecordingError(f"{self.path} is no MCAP file") from error
            self.damage = error.reason

    def _meet(self, channel: Any, schema: Any) -> None:
        self.types.setdefault(channel.topic, schema.name if schema else "")
        self.definitions.setdefault(channel.topic, schema.data.decode(errors="replace") if schema else "")

    def _records(self) -> Iterator[Any]:
        """Yield the records of the file from its beginning."""
        from mcap.exceptions import EndOfFile, InvalidMagic
        from mcap.stream_reader import StreamReader

        with self.path.open("rb") as stream:
            try:
                yield from StreamReader(stream, validate_crcs=True, record_size_limit=_LARGEST).records
            except (EndOfFile, InvalidMagic, struct.error) as error:
                raise DamagedRecording(self.path, CUT_SHORT) from error
            except OSError:
                raise
            except Exception as error:  # damage raises what zstandard, lz4, zlib or mcap raise
                raise DamagedRecording(self.path, f"the file is damaged from here on: {error}") from error


def require_mcap() -> None:
    """Raise RecordingError where the package mcap is missing, before anything moves."""
    try:
        import mcap.reader
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise RecordingError(
            f"{error.name} is not installed; install deltacharger[record], or `pip install mcap`"
        ) from error
