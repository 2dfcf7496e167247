# SPDX-License-Identifier: Apache-2.0
"""Topics as the bytes that came over the wire: listened to by the node's thread, or read in batches by another."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from deltacharger_core.mcap_file import Raw
from deltacharger_ros.on_demand import PolledTopic


@dataclass(frozen=True)
class Topic:
    """A topic that is recorded: relative name, message class and quality of service."""

    name: str
    kind: Any
    qos: Any


def listen(node: Node, topics: Sequence[Topic], take: Callable[[Raw], None]) -> None:
    """Call `take` with every message of `topics` from now on, undecoded, from the node's thread.

    Args:
        node: subscribes.
        topics: names relative to the node's namespace.
        take: must be quick.
    """

    def taker(topic: str) -> Callable[[Any], None]:
        def on_message(data: Any) -> None:  # without MessageInfo, which rclpy's EventsExecutor cannot hand over
            now = time.time_ns()
            take(Raw(topic, now, now, bytes(data)))

        return on_message

    for topic in topics:
        full = node.resolve_topic_name(topic.name)
        node.create_subscription(topic.kind, topic.name, taker(full), topic.qos, raw=True)


class PolledTopics:
    """Topics of a recording, undecoded, in the order in which they came.

    Args:
        node: subscribes; the depths of the topics bound how long may pass between two calls.
        topics: names relative to its namespace.
    """

    def __init__(self, node: Node, topics: Sequence[Topic]) -> None:
        self._topics = [PolledTopic(node, topic.kind, topic.name, topic.qos, raw=True) for topic in topics]

    def take(self) -> list[Raw]:
        """Return what has come since the last call, in the order of its arrival."""
        found = []
        for topic in self._topics:
            for data, info in topic.take():
                received = int(info["received_timestamp"]) or time.time_ns()
                found.append(Raw(topic.name, received, int(info["source_timestamp"]), bytes(data)))
        return sorted(found, key=lambda message: message.received)
