# SPDX-License-Identifier: Apache-2.0
"""Write ROS topics, as received, to MCAP files that `ros2 bag` and Foxglove read.

Messages are stored as received bytes (CDR), so that nothing is lost or rounded, with the text of their .msg files, so
that a reader needs no message packages. Needs the package mcap, `deltacharger[record]`.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

from deltacharger_core.files import atomic_write
from deltacharger_core.mcap_file import McapFile, Raw, RecordingError, require_mcap
from deltacharger_records.recording.own import LIBRARY
from deltacharger_ros.raw_topics import Topic

_SEPARATOR = "=" * 80
_FIELD = re.compile(r"^\s*([A-Za-z]\w*(?:/\w+)?)(?:<=\d+)?(?:\[[^\]]*\])?\s+\w+")
_PLAIN = {"bool", "byte", "char", "string", "wstring", "float32", "float64"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
# As `ros2 bag record` writes it: numbers, which all its versions read, and no history, which a recorder never learns.
_OFFERED = """\
- history: 3
  depth: 0
  reliability: {reliability:d}
  durability: {durability:d}
  deadline: {forever}
  lifespan: {forever}
  liveliness: 1
  liveliness_lease_duration: {forever}
  avoid_ros_namespace_conventions: false
"""
_FOREVER = "{sec: 9223372036, nsec: 854775807}"


class McapStream:
    """Write MCAP to a stream that the caller opens and closes.

    Args:
        stream: to write to.
        topics: by their full names.
        live: write message by message, so that flushed data outlive this process; False = in chunks.
        metadata: records by name, written in this order directly after the header.

    Raises:
        RecordingError: mcap or a message's .msg file is not installed.
        OSError: the file cannot be written.
    """

    def __init__(
        self,
        stream: BinaryIO,
        topics: Mapping[str, Topic],
        *,
        live: bool,
        metadata: Iterable[tuple[str, Mapping[str, str]]] = (),
    ) -> None:
        require_mcap()
        from mcap.writer import Writer

        self._stream = stream
        self._channels: dict[str, int] = {}
        self._writer: Any = Writer(stream, use_chunking=not live)
        self._writer.start(profile="ros2", library=LIBRARY)
        for name, values in metadata:
            self.add_metadata(name, values)
        for full, topic in topics.items():
            schema = self._writer.register_schema(type_name(topic.kind), "ros2msg", schema_text(topic.kind).encode())
            offered = {"offered_qos_profiles": _offered(topic.qos)}
            self._channels[full] = self._writer.register_channel(full, "cdr", schema, offered)

    def add(self, message: Raw) -> None:
        """Append a message; KeyError for an undeclared topic."""
        self._writer.add_message(self._channels[message.topic], message.received, message.data, message.published)

    def add_message(self, topic: str, message: Any, received: int, published: int) -> None:
        """Append a message object; times in ns since 1970."""
        self.add(Raw(topic, received, published, serialize_message(message)))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record of text values, shown by `ros2 bag` and Foxglove."""
        self._writer.add_metadata(name, dict(values))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Append a file."""
        now = time.time_ns()
        self._writer.add_attachment(now, now, name, media_type, data)

    def flush(self) -> None:
        """Pass live data to the operating system."""
        self._stream.flush()

    def finish(self) -> None:
        """Write the index; nothing can be added afterwards."""
        self._writer.finish()
        self._stream.flush()


class McapWriter(McapStream):
    """Write one MCAP file; it gets its name when it is complete and on the disk.

    A `with` block left by an exception leaves no file.

    Args:
        path: of the file; an existing file is replaced at the end.
        topics: by their full names.

    Raises:
        RecordingError: mcap or a message's .msg file is not installed.
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, topics: Mapping[str, Topic]) -> None:
        with ExitStack() as undo:
            super().__init__(undo.enter_context(undo.enter_context(atomic_write(path)).open("wb")), topics, live=False)
            undo.push(self._complete)
            self._exit = undo.pop_all()

    def __enter__(self) -> McapWriter:
        return self

    def __exit__(self, *exception: Any) -> None:
        self._exit.__exit__(*exception)

    def _complete(self, kind: object, *_: object) -> None:
        if kind is None:
            self.finish()


def pack(path: Path, stream: BinaryIO, topics: Mapping[str, Topic]) -> None:
    """Rewrite in chunks a file that McapStream wrote live: a third of the size, and `ros2 bag` plays it by time.

    Args:
        path: of the file.
        stream: to write to.
        topics: by their full names.

    Raises:
        RecordingError: it is damaged.
        OSError: the disk does not accept it.
    """
    file = McapFile(path)
    writer = McapStream(stream, topics, live=False, metadata=file.metadata)
    for message in file.messages():
        writer.add(message)
    writer.finish()


def _offered(qos: QoSProfile) -> str:
    """Return a publisher's quality of service as YAML in the form of `ros2 bag`, which offers it when it plays."""
    return _OFFERED.format(reliability=qos.reliability, durability=qos.durability, forever=_FOREVER)


def decode(data: bytes, kind: Any) -> Any:
    """Return a recorded message.

    Raises:
        RecordingError: the bytes are not of this class; live files have no checksums that would detect this earlier.
    """
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # rclpy raises private error classes
        raise RecordingError(f"the file is damaged from here on: no {kind.__name__}: {error}") from error


def type_name(kind: Any) -> str:
    """Return the full name of a message class, such as std_msgs/msg/Header."""
    package, interface, *_ = kind.__module__.split(".")
    return f"{package}/{interface}/{kind.__name__}"


def schema_text(kind: Any) -> str:
    """Return a message's .msg text, followed by the texts of its parts, as `ros2 bag` writes it.

    Raises:
        RecordingError: a .msg file is not installed.
    """
    package, _, name = type_name(kind).split("/")
    top = f"{package}/{name}"
    texts, waiting = {top: _definition(package, name)}, [top]
    while waiting:
        own = waiting.pop(0)
        for part in _parts(texts[own], own.split("/")[0]):
            if part not in texts:
                texts[part] = _definition(*part.split("/"))
                waiting.append(part)
    first = texts.pop(top)
    return "".join([first, *(f"\n{_SEPARATOR}\nMSG: {part}\n{text}" for part, text in texts.items())])


def _parts(text: str, package: str) -> Iterator[str]:
    """Yield the messages (package/Name) used by the fields of a definition."""
    for line in text.splitlines():
        found = _FIELD.match(line.partition("#")[0])
        if found is None or found[1] in _PLAIN:
            continue
        yield found[1] if "/" in found[1] else f"{package}/{found[1]}"


def _definition(package: str, name: str) -> str:
    action, _, part = name.partition("_Feedback")
    if part == "Message" and action:
        return f"unique_identifier_msgs/UUID goal_id\n{package}/{action}_Feedback feedback\n"
    try:
        share = Path(get_package_share_directory(package))
        if action != name:  # the third part of an .action file
            return (share / "action" / f"{action}.action").read_text(encoding="utf-8").split("\n---\n")[2]
        return (share / "msg" / f"{name}.msg").read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError) as error:
        raise RecordingError(f"the definition of {package}/msg/{name} is not installed: {error}") from error
