# SPDX-License-Identifier: Apache-2.0
"""A charger's topics in MCAP files that `ros2 bag` and Foxglove read, too.

Messages are stored as received bytes (CDR), so that nothing is lost or rounded, with the text of their .msg files, so
that other readers need no message packages. Needs the package mcap, `deltacharger[record]`.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

from action_msgs.msg import GoalStatusArray
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from deltacharger.action import Dock, Undock
from deltacharger.msg import (
    ChargerPower,
    DockingDecision,
    DockingState,
    ElectrodeDetection,
    Misalignment,
    ServoState,
    TactileFrame,
)
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory

from deltacharger_core.files import atomic_write
from deltacharger_core.mcap_file import DamagedRecording, McapFile, Raw, RecordingError, require_mcap
from deltacharger_records.raw_topics import Topic
from deltacharger_records.recording.folder import ABOUT, LIBRARY
from deltacharger_ros import qos

_DEFAULT = QoSProfile(depth=qos.DEFAULT_DEPTH)

STATE = "docking_state"
DECISION = "docking_decision"
ACTIONS = ("dock", "undock")

TOPICS: tuple[Topic, ...] = (
    Topic(STATE, DockingState, qos.STATE),
    Topic(DECISION, DockingDecision, _DEFAULT),
    Topic("servo_state", ServoState, qos.LATEST),
    Topic("tactile_frame", TactileFrame, qos.SENSOR),
    Topic("charger_power", ChargerPower, qos.LATEST),
    Topic("misalignment", Misalignment, _DEFAULT),
    Topic("electrode_detection", ElectrodeDetection, _DEFAULT),
    Topic("joint_trajectory", JointTrajectory, qos.LATEST),
    Topic("contact_wrench", WrenchStamped, _DEFAULT),
    Topic("end_effector_pose", PoseStamped, _DEFAULT),
    Topic("dock/_action/feedback", Dock.Impl.FeedbackMessage, _DEFAULT),
    Topic("dock/_action/status", GoalStatusArray, qos.STATE),
    Topic("undock/_action/feedback", Undock.Impl.FeedbackMessage, _DEFAULT),
    Topic("undock/_action/status", GoalStatusArray, qos.STATE),
)
"""In a record, each has its full name."""

ALWAYS = (STATE, DECISION, "electrode_detection", "dock/_action/status", "undock/_action/status")
"""Topics of which every message is kept, even over hours of charging."""

_SEPARATOR = "=" * 80
_FIELD = re.compile(r"^\s*([A-Za-z]\w*(?:/\w+)?)(?:<=\d+)?(?:\[[^\]]*\])?\s+\w+")
_PART = re.compile(r"\n=+\nMSG: ")
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


class Recording:
    """One charger's topics in a file: a record of docking_recorder_node, or MCAP of `ros2 bag record`.

    Args:
        path: of the file, or of a folder with one.
        namespace: of the charger; '' = the only one in the file.
        topics: to read.
        states: whether docking_state must be among them.

    Attributes:
        path, file: the file.
        namespace: of the charger, '/' = none.
        counts: messages of each topic, by relative name.
        damage: why reading stopped before the end; '' = the file is complete, as far as it was read.

    Raises:
        RecordingError: mcap is not installed, the file holds no such charger or several, or messages with other fields
            than the installed ones.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, namespace: str = "", topics: Sequence[Topic] = TOPICS, states: bool = True) -> None:
        self.file = McapFile(path)
        self.path, self.damage = self.file.path, self.file.damage
        chargers = _chargers(self.file, topics, states)
        wanted = f"/{namespace.strip('/')}" if namespace else ""
        if not chargers or (wanted and wanted not in chargers):
            what = f"{STATE if states else 'topic of a charger'}{f' of {wanted}' if wanted else ''}"
            held = ", ".join(chargers or sorted(self.file.types)) or "nothing"
            why = f" ({self.damage})" if self.damage else ""
            raise RecordingError(f"{self.path} holds no {what}; it holds {held}{why}")
        if not wanted and len(chargers) > 1:
            names = ", ".join(sorted(chargers))
            raise RecordingError(f"{self.path} holds several chargers, {names}: name one with --namespace")
        self.namespace = wanted or next(iter(chargers))
        self._topics = chargers[self.namespace]
        self.counts = {topic.name: self.file.counts[full] for full, topic in self._topics.items()}
        for full, topic in self._topics.items():
            _check_fields(self.file, full, topic.kind)
        if states and not self.counts[STATE]:
            raise RecordingError(f"{self.path} has no readable docking_state: {self.damage or 'no messages'}")

    def messages(self) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield each message, undecoded, in the order of the file, up to its damage: topic, ns since 1970, CDR."""
        try:
            for message in self.file.messages(*self._topics):
                yield self._topics[message.topic], message.received, message.data
        except DamagedRecording as error:
            self.damage = error.reason

    def read(self, take: Callable[[str, int, Any], None]) -> None:
        """Pass each message to `take` in the order of the file, up to its damage: relative topic, ns, message."""
        try:
            for topic, received, data in self.messages():
                take(topic.name, received, decode(data, topic.kind))
        except RecordingError as error:
            self.damage = str(error)


def _chargers(file: McapFile, topics: Sequence[Topic], states: bool) -> dict[str, dict[str, Topic]]:
    """Return each charger's topics by full name, by its namespace: with docking_state only, if any or `states`."""
    found: dict[str, dict[str, Topic]] = {}
    for full, kind in file.types.items():
        for topic in topics:
            if full.endswith(f"/{topic.name}") and kind == type_name(topic.kind):
                found.setdefault(full.removesuffix(topic.name).rstrip("/") or "/", {})[full] = topic
    docking = {name: own for name, own in found.items() if any(topic.name == STATE for topic in own.values())}
    return docking if docking or states else found


def _check_fields(file: McapFile, topic: str, kind: Any) -> None:
    """Refuse messages with other fields than the installed ones, whose bytes would be misread.

    `ros2 bag record` stores no definition that it does not find, and none of an action in a form of its own.
    """
    about = file.metadata_named(ABOUT)
    definition = file.definitions[topic] if about or "/action/" not in type_name(kind) else ""
    if definition and _fields(definition) != _fields(schema_text(kind)):
        writer = f"deltacharger {about[0].get('version', '')}" if about else "the version that published them"
        raise RecordingError(
            f"{file.path}: {topic} has other fields than the installed {type_name(kind)}: use {writer}"
        )


def _fields(text: str) -> dict[str, list[str]]:
    """Return the fields (type and name) of each message in a schema, without comments and constants; '' = the first."""
    first, *parts = _PART.split(text)
    named = {name: own for name, _, own in (part.partition("\n") for part in parts)} | {"": first}
    lines = {name: [line.partition("#")[0].split() for line in own.splitlines()] for name, own in named.items()}
    return {
        name: [" ".join(words[:2]) for words in own if words and "=" not in " ".join(words)]
        for name, own in lines.items()
    }


def decode(data: bytes, kind: Any) -> Any:
    """Return a recorded message.

    Raises:
        RecordingError: the bytes are not of this class; live files have no checksums that would detect this earlier.
    """
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # rclpy raises private error classes
        raise RecordingError(f"the file is damaged from here on: no {kind.__name__}: {error}") from error


def _offered(given: QoSProfile) -> str:
    """Return a publisher's quality of service as YAML in the form of `ros2 bag`, which offers it when it plays."""
    return _OFFERED.format(reliability=given.reliability, durability=given.durability, forever=_FOREVER)


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
