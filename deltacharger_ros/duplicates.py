# SPDX-License-Identifier: Apache-2.0
"""Second sources: who publishes or serves beside another what only one node may, as the ROS graph tells.

A look costs 10 µs a name (`count_publishers`, `count_services`); who is double is asked for only where somebody is.
A node that was killed stays in the graph until its middleware's lease is over: 5 s by
config/fastdds.xml, 20 s by default.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from rclpy.node import Node

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
            f"{short} from {_listed(node.get_publishers_info_by_topic(name))}"
            for short, name in self._topics.items()
            if node.count_publishers(name) > 1
        ]
        told += [
            # Where services are told from topics by other prefixes than those of DDS, servers have no names.
            f"{short} from {_listed(node.get_publishers_info_by_topic(f'rr{name}Reply', no_mangle=True))}"
            for short, name in self._services.items()
            if node.count_services(name) > 1
        ]
        return "; ".join(told)


def _listed(sources: Sequence[object]) -> str:
    """Return the fully qualified names of endpoints' nodes, each once."""
    counts = Counter(map(_name, sources))
    names = [f"{name} ({count} times)" if count > 1 else name for name, count in sorted(counts.items())]
    if len(names) > _NAMES:
        names[_NAMES:] = [f"{len(names) - _NAMES} more"]
    return " and ".join(names) or "nodes without a name"


def _name(source: object) -> str:
    namespace, name = getattr(source, "node_namespace", ""), getattr(source, "node_name", _NAMELESS)
    return "a node without a name" if name == _NAMELESS else f"{namespace.rstrip('/')}/{name}"[:_LENGTH]
