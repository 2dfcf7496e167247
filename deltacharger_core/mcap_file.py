# SPDX-License-Identifier: Apache-2.0
"""Reads MCAP recordings, complete, truncated or damaged, without ROS.

Messages stay CDR bytes; callers that have ROS decode them. Needs the package mcap (`deltacharger[record]`).
"""

import contextlib
import io
import os
import zlib
from collections import Counter
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from deltacharger_core.files import brief, open_file

CUT_SHORT = "the file ends early: its recorder was stopped"
"""Reason for a truncated but otherwise valid file."""

BAGS = (".mcap", ".db3", ".zstd")
"""Endings of the files that `ros2 bag record` writes."""

LARGEST_FILE = 2**40
"""Maximum bytes of a recording."""
_LARGEST_RECORD = 48 * 2**20  # bytes, also of an unpacked chunk; a colour image of 4096 × 3072 px has 38 MB
_LARGEST_HEAD = 32_768  # bytes of one record at the head of a file, as docking_recorder_node writes it
_LARGEST_SUMMARY = 16 * 2**20  # bytes; at 80 bytes a chunk, 200 000 chunks
_LONGEST = 300  # characters of a reason
_CONVERT = (
    "convert a bag in SQLite (db3) or compressed files (zstd) by `rosbags-convert --src BAG --dst NEW "
    "--dst-storage mcap` (pip install rosbags)"
)


class RecordingError(RuntimeError):
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
        path: file, or a folder with one, as `ros2 bag record` writes.

    Attributes:
        path: the file.
        types: message type of each topic, such as std_msgs/msg/Header; '' = untyped.
        definitions: message definition of each topic as text of .msg files; '' = in another form or none.
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
        self.path = path = _only_recording(path) if path.is_dir() else path
        self.types: dict[str, str] = {}
        self.definitions: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        self.metadata: list[tuple[str, dict[str, str]]] = []
        self.first = self.last = 0
        self.damage = ""
        with open_file(path, LARGEST_FILE) as stream:
            if not os.fstat(stream.fileno()).st_size:
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
        for record in _walk(self.path):
            kind = type(record).__name__
            if kind == "Channel" and (not topics or record.topic in topics):
                names[record.id] = record.topic
            elif kind == "Message" and record.channel_id in names:
                yield Raw(names[record.channel_id], record.log_time, record.publish_time, record.data)

    def _read_index(self) -> bool:
        """Read the index at the end of a complete file; return whether it is complete."""
        from mcap.reader import SeekingReader

        with open_file(self.path, LARGEST_FILE) as stream:
            try:
                reader = SeekingReader(stream, validate_crcs=True, record_size_limit=_LARGEST_SUMMARY)
                summary = reader.get_summary()
                if summary is None or summary.statistics is None:
                    return False
                statistics, counts = summary.statistics, summary.statistics.channel_message_counts
                places = len(summary.metadata_indexes)
                if (len(summary.channels), places) != (statistics.channel_count, statistics.metadata_count):
                    return False
                if sum(counts.values()) != statistics.message_count or not counts.keys() <= summary.channels.keys():
                    return False
                self.metadata = [(each.name, dict(each.metadata)) for each in reader.iter_metadata()]
            except Exception:  # truncated, damaged or no MCAP file: the scan finds out
                return False
        for channel in summary.channels.values():
            self._add_channel(channel, summary.schemas.get(channel.schema_id))
            self.counts[channel.topic] += counts.get(channel.id, 0)
        self.first, self.last = statistics.message_start_time, statistics.message_end_time
        return True

    def _scan(self) -> None:
        schemas, topics, begun = dict[int, Any](), dict[int, str](), False
        try:
            for record in _walk(self.path):
                begun, kind = True, type(record).__name__
                if kind == "Schema":
                    schemas[record.id] = record
                elif kind == "Channel":
                    topics[record.id] = record.topic
                    self._add_channel(record, schemas.get(record.schema_id))
                elif kind == "Metadata":
                    self.metadata.append((record.name, dict(record.metadata)))
                elif kind == "Message" and record.channel_id in topics:
                    self.counts[topics[record.channel_id]] += 1
                    self.first = min(self.first or record.log_time, record.log_time)
                    self.last = max(self.last, record.log_time)
        except DamagedRecording as error:
            if not begun:
                raise RecordingError(f"{self.path} is no MCAP file: {_CONVERT}") from error
            self.damage = error.reason

    def _add_channel(self, channel: Any, schema: Any) -> None:
        self.types.setdefault(channel.topic, schema.name if schema else "")
        text = schema.data.decode(errors="replace") if schema and schema.encoding == "ros2msg" else ""
        self.definitions.setdefault(channel.topic, text)


def head_of(path: Path) -> tuple[str, str, dict[str, str]]:
    """Return the writer that a file's header names, and name and values of the metadata right after it; '' = none.

    Reads nothing else, however large the file.

    Raises:
        RecordingError: mcap is not installed.
        OSError: the file cannot be read.
    """
    require_mcap()
    with contextlib.closing(_walk(path, _LARGEST_HEAD, unpack=False)) as records:
        try:
            header, about = next(records), next(records)
        except (DamagedRecording, StopIteration):
            return "", "", {}
    if (type(header).__name__, type(about).__name__) != ("Header", "Metadata"):
        return "", "", {}
    return header.library, about.name, dict(about.metadata)


def _walk(path: Path, largest: int = _LARGEST_RECORD, unpack: bool = True) -> Generator[Any, None, None]:
    """Yield mcap's records from the beginning, those of chunks in place of the chunks if `unpack`.

    Raises:
        DamagedRecording: the file is truncated or damaged from here on.
    """
    from mcap.stream_reader import StreamReader

    with open_file(path, LARGEST_FILE) as stream:
        how: Any = {"emit_chunks": True, "validate_crcs": True, "record_size_limit": largest}
        try:
            for record in StreamReader(stream, **how).records:
                if unpack and type(record).__name__ == "Chunk":
                    yield from _inside(record)
                else:
                    yield record
        except OSError:
            raise
        except Exception as error:  # on damage zstandard, lz4, struct and mcap raise their own errors
            reason = f"the file is damaged from here on: {error}"[:_LONGEST] if stream.read(1) else CUT_SHORT
            raise DamagedRecording(path, reason) from error


def _inside(chunk: Any) -> Iterator[Any]:
    """Yield the records of a chunk one by one: a list of them may be many times its size."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Channel, Message, Schema

    data = _unpacked(chunk)
    stream = ReadDataStream(io.BytesIO(data))
    while stream.count < len(data):
        opcode, length = stream.read1(), stream.read8()
        if opcode == 5:
            yield Message.read(stream, length)
        elif opcode in (3, 4):
            yield (Schema if opcode == 3 else Channel).read(stream)
        else:
            stream.read(length)


def _unpacked(chunk: Any) -> bytes:
    """Return a chunk's content; more than it claims or than is allowed is refused before it is unpacked."""
    size, method = chunk.uncompressed_size, chunk.compression
    if size > _LARGEST_RECORD:
        raise ValueError(f"a chunk claims {size} bytes, more than {_LARGEST_RECORD}")
    if method == "zstd":
        import zstandard

        unpacker = zstandard.ZstdDecompressor(max_window_size=_LARGEST_RECORD)
        data = unpacker.stream_reader(chunk.data, read_across_frames=True).read(size + 1)
    elif method == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif method:
        raise ValueError(f"a chunk has the unsupported compression {method[:20]!r}")
    else:
        data = chunk.data
    if len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("a chunk does not unpack to what it states")
    return bytes(data)


def recordings_in(path: Path) -> list[Path]:
    """Return the files that are named like recordings, in order: those of a folder, or the file itself."""
    return sorted(each for each in (path.iterdir() if path.is_dir() else [path]) if each.suffix.lower() in BAGS)


def _only_recording(folder: Path) -> Path:
    """Return the recording in a folder; RecordingError unless there is exactly one."""
    found = recordings_in(folder)
    if len(found) == 1:
        return found[0]
    if not found:
        raise RecordingError(f"{folder} holds no recording (*{BAGS[0]}): give a file, or a folder of `ros2 bag record`")
    names = brief([path.name for path in found])
    raise RecordingError(f"{folder} holds {len(found)} recordings: give one of its files, {names}")


def require_mcap() -> None:
    """Raise RecordingError if the package mcap is missing; call before anything moves."""
    try:
        import mcap.reader
        import mcap.writer  # noqa: F401
    except ImportError as error:
        raise RecordingError(
            f"{error.name} is not installed; install deltacharger[record], or with ROS by rosdep and "
            "DELTACHARGER_EXTRAS=record"
        ) from error
