# SPDX-License-Identifier: Apache-2.0
"""A recording of a docking as it is read back: whole, truncated by a kill, or without some topics.

Records of docking_recorder_node and MCAP files of `ros2 bag record` alike.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from deltacharger_records.recording.docking_topics import KINDS, STATE, TOPICS
from deltacharger_records.recording.mcap_recording import RecordingError, require_mcap, schema_text, type_name

CUT_SHORT = "the file ends early: its recorder was stopped"
"""What is told as damage of a file that is whole as far as it goes."""

_LARGEST = 2**28  # bytes of one record of the file; more is damage
_TYPES = {topic.name: type_name(topic.kind) for topic in TOPICS}


@dataclass
class Recording:
    """What a file holds besides its messages.

    Attributes:
        path: the file.
        namespace: of the charger, '/' = none.
        metadata: by name, in order.
        counts: messages of each topic, by relative name.
        first, last: when the first and the last message came, ns since 1970; 0 where there is none.
        damage: why reading ended before the end; '' = the file is complete.
        unreadable: topics that another version recorded, with the reason.
    """

    path: Path
    namespace: str = "/"
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    first: int = 0
    last: int = 0
    damage: str = ""
    unreadable: dict[str, str] = field(default_factory=dict)

    def told(self, name: str) -> list[dict[str, str]]:
        """Return the metadata of one name."""
        return [values for each, values in self.metadata if each == name]


@dataclass
class _Channels:
    """Schemas and channels met so far."""

    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)


def read(path: Path, take: Callable[[str, int, Any], None], namespace: str | None = None) -> Recording:
    """Read a recording, handing each message of a docking to `take`: relative topic, ns since 1970, message.

    Args:
        path: of the file.
        take: called in the order of the file.
        namespace: of the charger; None = the only one that it holds.

    Raises:
        RecordingError: mcap is not installed, or this is no recording of a docking.
        OSError: it cannot be read.
    """
    recording = Recording(path, _charger(path, namespace))
    for name, received, data in _messages(recording):
        take(name, received, decoded(name, data))
    return _with_states(recording)


def survey(path: Path, namespace: str | None = None) -> Recording:
    """Read a recording through without decoding its messages; arguments and errors as those of `read`."""
    recording = Recording(path, _charger(path, namespace))
    for _ in _messages(recording):
        pass
    return _with_states(recording)


def messages(path: Path, namespace: str) -> Iterator[tuple[str, int, bytes]]:
    """Yield each message of a docking, undecoded, in the order of the file: relative topic, ns since 1970, CDR.

    Args:
        path: of the file.
        namespace: of the charger, as `survey` found it.
    """
    return _messages(Recording(path, namespace))


def decoded(name: str, data: bytes) -> Any:
    """Return the message of a topic, named relatively."""
    return deserialize_message(data, KINDS[_TYPES[name]])


def _messages(recording: Recording) -> Iterator[tuple[str, int, bytes]]:
    """Yield the messages of the recording's charger and note in it what else it holds."""
    met, known = _Channels(), dict[int, str]()
    for record in _records(recording.path, recording):
        kind = type(record).__name__
        if kind == "Metadata":
            recording.metadata.append((record.name, dict(record.metadata)))
        elif kind == "Schema":
            met.schemas[record.id] = record
        elif kind == "Channel" and record.id not in met.channels:
            met.channels[record.id] = record
            name = _relative(record.topic, recording.namespace)
            if name is not None and _is_readable(recording, name, met.schemas.get(record.schema_id)):
                known[record.id] = name
        elif kind == "Message" and record.channel_id in known:
            name = known[record.channel_id]
            recording.counts[name] = recording.counts.get(name, 0) + 1
            recording.first, recording.last = recording.first or record.log_time, record.log_time
            yield name, record.log_time, record.data


def _with_states(recording: Recording) -> Recording:
    """Return a recording that tells what docking did.

    Raises:
        RecordingError: it does not.
    """
    if not recording.counts.get(STATE):
        why = recording.unreadable.get(STATE) or recording.damage or "there is no message of it"
        raise RecordingError(f"{recording.path} tells no docking_state: {why}")
    return recording


def span(path: Path) -> tuple[int, int, Recording]:
    """Return the times (ns since 1970) of the first and last message without reading them all, and the metadata.

    Raises:
        RecordingError: mcap is not installed, or it is no MCAP file.
        OSError: it cannot be read.
    """
    recording = Recording(path)
    first, last = 2**63, 0
    for record in _records(path, recording, whole_chunks=True):
        kind = type(record).__name__
        if kind == "Metadata":
            recording.metadata.append((record.name, dict(record.metadata)))
        elif kind == "Chunk" and record.message_end_time:
            first, last = min(first, record.message_start_time), max(last, record.message_end_time)
    return min(first, last), last, recording


def _records(path: Path, recording: Recording, whole_chunks: bool = False) -> Iterator[Any]:
    """Yield the records of a file up to its end or damage."""
    require_mcap()
    from mcap.exceptions import EndOfFile, InvalidMagic
    from mcap.stream_reader import StreamReader

    if path.stat().st_size == 0:
        raise RecordingError(f"{path} is empty: its recorder was stopped before it had written anything")
    with path.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=whole_chunks, validate_crcs=True, record_size_limit=_LARGEST)
        begun = False
        try:
            for record in reader.records:
                begun = True
                yield record
        except (EndOfFile, InvalidMagic, struct.error) as error:
            if not begun:
                raise RecordingError(f"{path} is no MCAP file") from error
            recording.damage = CUT_SHORT
        except Exception as error:  # damage raises what zstandard, zlib or mcap raise
            recording.damage = f"the file is damaged from here on: {error}"


def _charger(path: Path, namespace: str | None) -> str:
    """Return the namespace whose docking_state the file holds."""
    found: dict[str, None] = {}
    schemas: dict[int, str] = {}
    recording = Recording(path)
    for record in _records(path, recording):
        kind = type(record).__name__
        if kind == "Schema":
            schemas[record.id] = record.name
        elif (
            kind == "Channel" and schemas.get(record.schema_id) == _TYPES[STATE] and record.topic.endswith(f"/{STATE}")
        ):
            found[record.topic.removesuffix(STATE).rstrip("/") or "/"] = None
    if namespace is not None:
        wanted = "/" + namespace.strip("/")
        if wanted not in found:
            raise RecordingError(f"{path} holds no docking_state of {wanted}; there is {', '.join(found) or 'none'}")
        return wanted
    if len(found) > 1:
        raise RecordingError(f"{path} holds several chargers, {', '.join(found)}: name one with --namespace")
    if not found:
        why = f" ({recording.damage})" if recording.damage else ""
        raise RecordingError(
            f"{path} holds no docking_state{why}: record that topic, or use `deltacharger up --record`"
        )
    return next(iter(found))


def _relative(topic: str, namespace: str) -> str | None:
    head = namespace.rstrip("/") + "/"
    name = topic.removeprefix(head) if topic.startswith(head) else ""
    return name if name in _TYPES else None


def _is_readable(recording: Recording, name: str, schema: Any) -> bool:
    """Whether the messages were defined then as they are now."""
    wanted = _TYPES[name]
    if schema is None or schema.name != wanted:
        recording.unreadable[name] = f"is {schema.name if schema else 'untyped'}, not {wanted}"
        return False
    if _fields(schema.data.decode(errors="replace")) != _fields(schema_text(KINDS[wanted])):
        recording.unreadable[name] = f"{wanted} was defined otherwise when this was recorded; replay with that version"
        return False
    return True


def _fields(text: str) -> list[str]:
    """Return the fields of the first definition in a schema, without comments and constants."""
    top = text.split("\n===")[0]
    lines = (line.partition("#")[0].split() for line in top.splitlines())
    return [" ".join(words[:2]) for words in lines if words and "=" not in " ".join(words)]


def counts_missing(recording: Recording) -> Mapping[str, str]:
    """Return the topics that a docking has and the recording lacks, with the reason."""
    missing = {name: recording.unreadable.get(name, "not in the recording") for name in _TYPES}
    return {name: why for name, why in missing.items() if not recording.counts.get(name)}
