# SPDX-License-Identifier: Apache-2.0
"""A charger's topics in MCAP files that `ros2 bag` and Foxglove read, too.

Messages are stored as received bytes (CDR), so that nothing is lost or rounded, with the text of their .msg files, so
that other readers need no message packages. Needs the package mcap, `deltacharger[record]`.
"""

from __future__ import annotations

import importlib
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

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
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from deltacharger_core.files import flush
from deltacharger_core.mcap_file import DamagedRecording, McapFile, Raw, RecordingError, require_mcap
from deltacharger_records.recording.folder import ABOUT, LIBRARY
from deltacharger_ros import qos
from deltacharger_ros.on_demand import PolledTopic

_DEFAULT = QoSProfile(depth=qos.DEFAULT_DEPTH)


@dataclass(frozen=True)
class Topic:
    """A topic of a charger.

    Attributes:
        name: relative.
        kind: message class.
        qos: quality of service that its publisher offers.
        queue: messages that a polling reader keeps; 500 lose none if the disk hangs for seconds.
    """

    name: str
    kind: Any
    qos: QoSProfile
    queue: int = 500


class PolledTopics:
    """Undecoded topics of a charger, in order of reception.

    Args:
        node: subscriber.
        topics: names relative to its namespace; their queues bound the time between two calls of `take_messages`.
    """

    def __init__(self, node: Node, topics: Sequence[Topic]) -> None:
        self._topics = []
        for topic in topics:
            wanted = QoSProfile(depth=topic.queue, reliability=topic.qos.reliability, durability=topic.qos.durability)
            self._topics.append(PolledTopic(node, topic.kind, topic.name, wanted, raw=True))

    def take_messages(self) -> list[Raw]:
        """Return the messages since the last call, in order of reception."""
        found = []
        for topic in self._topics:
            for data, info in topic.take():
                received = int(info["received_timestamp"]) or time.time_ns()
                found.append(Raw(topic.name, received, int(info["source_timestamp"]), bytes(data)))
        return sorted(found, key=lambda message: message.received)


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
    Topic("undock/_action/feedback", Undock.Impl.FeedbackMessage, _DEFAULT),
)
"""In a record, each has its full name."""

ALWAYS = (STATE, DECISION, "electrode_detection")
"""Topics of which every message is kept, even over hours of charging."""

_SEPARATOR = "=" * 80
_PART = re.compile(r"\n=+\nMSG: ")
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


class McapWriter:
    """Writes MCAP message by message, so that flushed data outlive this process.

    Args:
        stream: to write to; closed with the writer.
        topics: by their full names.
        metadata: records by name, written in this order directly after the header.

    Raises:
        RecordingError: mcap or a message's .msg file is not installed.
        OSError: the file cannot be written.
    """

    def __init__(
        self, stream: BinaryIO, topics: Mapping[str, Topic], metadata: Iterable[tuple[str, Mapping[str, str]]] = ()
    ) -> None:
        require_mcap()
        from mcap.writer import Writer

        self.stream = stream
        self._channels: dict[str, int] = {}
        self._writer: Any = Writer(stream, use_chunking=False)
        self._writer.start(profile="ros2", library=LIBRARY)
        for name, values in metadata:
            self.add_metadata(name, values)
        for full, topic in topics.items():
            schema = self._writer.register_schema(type_name(topic.kind), "ros2msg", schema_text(topic.kind).encode())
            offered = {"offered_qos_profiles": _offered(topic.qos)}
            self._channels[full] = self._writer.register_channel(full, "cdr", schema, offered)

    def __enter__(self) -> McapWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def add(self, message: Raw) -> None:
        """Append a message; KeyError for an undeclared topic."""
        self._writer.add_message(self._channels[message.topic], message.received, message.data, message.published)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record of text values, shown by `ros2 bag` and Foxglove."""
        self._writer.add_metadata(name, dict(values))

    def close(self) -> None:
        """Write the index, and close the stream when everything is on the disk."""
        self._writer.finish()
        flush(self.stream)
        self.stream.close()


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
    found, waiting = {f"{package}/{name}": _definition(package, name)}, [kind()]
    while waiting:
        own = waiting.pop(0)
        for field, described in own.get_fields_and_field_types().items():
            for part in re.findall(r"\w+/\w+", described):
                if part not in found:
                    found[part] = _definition(*part.split("/"))
                    waiting.append(_part(getattr(own, field), *part.split("/")))
    first, *parts = found.items()
    return "".join([first[1], *(f"\n{_SEPARATOR}\nMSG: {part}\n{text}" for part, text in parts)])


def _part(value: Any, package: str, name: str) -> Any:
    """Return a message of the class of a field's value; of an empty sequence the class is found by its name."""
    if hasattr(value, "get_fields_and_field_types"):
        return value
    return getattr(importlib.import_module(f"{package}.msg"), name)()


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
