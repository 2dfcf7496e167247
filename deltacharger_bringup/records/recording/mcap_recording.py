# SPDX-License-Identifier: Apache-2.0
"""A charger's topics in MCAP files that `ros2 bag` and Foxglove read, too.

Messages are stored as received bytes (CDR), so that nothing is lost or rounded, with the text of their .msg files, so
that other readers need no message packages. Needs the package mcap, `deltacharger[record]`.
"""

from __future__ import annotations

import importlib
import re
import time
from collections.abc import Iterable, Mapping, Sequence
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
from trajectory_msgs.msg import JointTrajectory

from deltacharger_bringup.records.recording.folder import LIBRARY
from deltacharger_core import files, mcap_file
from deltacharger_core.ros import qos
from deltacharger_core.ros.on_demand import PolledTopic

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

    def take_messages(self) -> list[mcap_file.Raw]:
        """Return the messages since the last call, in order of reception."""
        found = []
        for topic in self._topics:
            for data, info in topic.take():
                received = int(info["received_timestamp"]) or time.time_ns()
                found.append(mcap_file.Raw(topic.name, received, int(info["source_timestamp"]), bytes(data)))
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
        mcap_file.require_mcap()
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

    def add(self, message: mcap_file.Raw) -> None:
        """Append a message; KeyError for an undeclared topic."""
        self._writer.add_message(self._channels[message.topic], message.received, message.data, message.published)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record of text values, shown by `ros2 bag` and Foxglove."""
        self._writer.add_metadata(name, dict(values))

    def close(self) -> None:
        """Write the index, and close the stream when everything is on the disk."""
        self._writer.finish()
        files.flush(self.stream)
        self.stream.close()


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
        raise mcap_file.RecordingError(f"the definition of {package}/msg/{name} is not installed: {error}") from error
