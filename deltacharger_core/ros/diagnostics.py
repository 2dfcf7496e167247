# SPDX-License-Identifier: Apache-2.0
"""A node's state on /diagnostics (REP 107), and second sources in its ROS graph.

A check costs 10 µs per name (`count_publishers`, `count_services`); names of nodes are read only if there is a
duplicate. A killed node stays in the graph until its middleware's lease ends: 5 s with config/fastdds.xml, 20 s by
default.
"""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from deltacharger_core import streams, texts

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics:
    """Publishes a node's diagnostics.

    Args:
        node: publisher.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def status(
        self, level: bytes, message: str, values: Mapping[str, object], part: str, hardware: str = ""
    ) -> DiagnosticStatus:
        """Return the status of a part of the node, named "NAMESPACE/NODE: PART".

        Args:
            level: OK, WARN or ERROR.
            message: one sentence.
            values: further values, published as text; None and NaN as "unknown".
            part: name of the part.
            hardware: the hardware that it drives; '' = none.
        """
        return DiagnosticStatus(
            level=level,
            name=f"{self._node.get_fully_qualified_name().lstrip('/')}: {part}",
            message=message,
            hardware_id=hardware,
            values=[KeyValue(key=key, value=_as_text(value)) for key, value in values.items()],
        )

    def report(self, level: bytes, message: str, values: Mapping[str, object], part: str, hardware: str = "") -> None:
        """Publish the status of one part; arguments as in `status`."""
        self.publish(self.status(level, message, values, part, hardware))

    def publish(self, *statuses: DiagnosticStatus) -> None:
        """Publish; does nothing after ROS was shut down."""
        if not self._node.context.ok():
            return
        message = DiagnosticArray(status=list(statuses))
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)


def _as_text(value: object) -> str:
    unknown = value is None or (isinstance(value, float) and math.isnan(value))
    return texts.UNKNOWN if unknown else str(value)


_NAMES = 4  # nodes named per topic or service; further ones are counted
_LENGTH = 120  # maximum characters of a node's name in a message
_NAMELESS = "_NODE_NAME_UNKNOWN_"


class Duplicates:
    """Finds second sources in the graph.

    Args:
        node: reads the graph; its own publishers and servers count too.
        topics: topics of a single publisher, relative to the node's namespace.
        services: services of a single server, relative to the node's namespace.
    """

    def __init__(self, node: Node, topics: Sequence[str], services: Sequence[str]) -> None:
        self._node = node
        self._topics = {name: node.resolve_topic_name(name) for name in topics}
        self._services = {name: node.resolve_service_name(name) for name in services}

    def look(self) -> str:
        """Return the duplicates, such as "servo_state from /servo_node and /stranger"; '' = none."""
        node = self._node
        duplicates = [
            f"{short} from {publishers(node, name)}"
            for short, name in self._topics.items()
            if node.count_publishers(name) > 1
        ]
        duplicates += [
            # "rr…Reply" is the DDS name of a service; with other middlewares servers have no names.
            f"{short} from {publishers(node, f'rr{name}Reply', no_mangle=True)}"
            for short, name in self._services.items()
            if node.count_services(name) > 1
        ]
        return "; ".join(duplicates)


def publishers(node: Node, topic: str, ids: Collection[bytes] = (b"",), no_mangle: bool = False) -> str:
    """Return the fully qualified names of the nodes that publish a topic, each once.

    Args:
        node: reads the graph.
        topic: full name.
        ids: ids of the wanted publishers; an empty id = all.
        no_mangle: whether the name is a DDS name.
    """
    try:
        found = node.get_publishers_info_by_topic(topic, no_mangle=no_mangle)
    except UnicodeDecodeError:  # a forged name, which rclpy cannot decode
        return "nodes whose names cannot be read"
    sources = [each for each in found if b"" in ids or bytes(each.endpoint_gid) in ids]
    counts = Counter(map(_name, sources))
    names = [f"{name} ({count} times)" if count > 1 else name for name, count in sorted(counts.items())]
    if len(names) > _NAMES:
        names[_NAMES:] = [f"{len(names) - _NAMES} more"]
    return " and ".join(names) or "nodes that are gone or have no name"


def _name(source: object) -> str:
    namespace, name = getattr(source, "node_namespace", ""), getattr(source, "node_name", _NAMELESS)
    return "a node without a name" if name == _NAMELESS else streams.plain(f"{namespace.rstrip('/')}/{name}")[:_LENGTH]
