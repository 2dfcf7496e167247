# SPDX-License-Identifier: Apache-2.0
"""Second sources: who publishes or serves beside another what only one node may, as the ROS graph tells.

A look costs 10 µs a name (`count_publishers`, `count_services`); who is double is asked for only where somebody is.
A node that was killed stays in the graph until its middleware's lease is over: 5 s by
config/fastdds.xml, 20 s by default.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from rclpy.node import Node

from deltacharger_core.streams import plain

_NAMES = 4  # nodes named for one source; the others are counted
_LENGTH = 120  # characters of a node's name that are repeated
_NAMELESS = "_NODE_NAME_UNKNOWN_"


class Duplicates:
    """Looks for second sources in the graph.

    Args:
        node: asks; its own publishers and servers count as any other's.
        topics: that one node may publish, relative to the node's namespace.
        services: that one node may serve, as well.
    """

    def __init__(self, node: Node, topics: Sequence[str], services: Sequence[str]) -> None:
        self._node = node
        self._topics = {name: node.resolve_topic_name(name) for name in topics}
        self._services = {name: node.resolve_service_name(name) for name in services}

    def look(self) -> str:
        """Return who is double, such as "servo_state from /servo_node and /stranger"; '' = nobody."""
        node = self._node
        told = [
            f"{short} from {publishers(node, name)}"
            for short, name in self._topics.items()
            if node.count_publishers(name) > 1
        ]
        told += [
            # Where services are told from topics by other prefixes than those of DDS, servers have no names.
            f"{short} from {publishers(node, f'rr{name}Reply', no_mangle=True)}"
            for short, name in self._services.items()
            if node.count_services(name) > 1
        ]
        return "; ".join(told)


def publishers(node: Node, topic: str, ids: Collection[bytes] = (b"",), no_mangle: bool = False) -> str:
    """Return the fully qualified names of the nodes that publish a topic, each once.

    Args:
        node: asks.
        topic: its full name.
        ids: of the publishers that are asked for; where one of them is empty, of all.
        no_mangle: whether the name is one of DDS.
    """
    try:
        found = node.get_publishers_info_by_topic(topic, no_mangle=no_mangle)
    except UnicodeDecodeError:  # a forged name, which rclpy does not tell
        return "nodes whose names cannot be read"
    sources = [each for each in found if b"" in ids or bytes(each.endpoint_gid) in ids]
    counts = Counter(map(_name, sources))
    names = [f"{name} ({count} times)" if count > 1 else name for name, count in sorted(counts.items())]
    if len(names) > _NAMES:
        names[_NAMES:] = [f"{len(names) - _NAMES} more"]
    return " and ".join(names) or "nodes that are gone or have no name"


def _name(source: object) -> str:
    namespace, name = getattr(source, "node_namespace", ""), getattr(source, "node_name", _NAMELESS)
    return "a node without a name" if name == _NAMELESS else plain(f"{namespace.rstrip('/')}/{name}")[:_LENGTH]
