# SPDX-License-Identifier: Apache-2.0
"""Topics as raw bytes: received by the node's thread, or polled in batches by another thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from deltacharger_core.mcap_file import Raw
from deltacharger_ros.on_demand import PolledTopic


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

    @property
    def polled(self) -> QoSProfile:
        """Quality of service of a reader that polls."""
        return QoSProfile(depth=self.queue, reliability=self.qos.reliability, durability=self.qos.durability)


def listen(node: Node, topics: Sequence[Topic], take: Callable[[Raw], None]) -> None:
    """Call `take` with every undecoded message of `topics`, from the node's thread.

    Args:
        node: subscriber.
        topics: names relative to the node's namespace.
        take: must return quickly.
    """

    def taker(topic: str) -> Callable[[Any], None]:
        def on_message(data: Any) -> None:  # rclpy's EventsExecutor cannot pass MessageInfo
            now = time.time_ns()
            take(Raw(topic, now, now, bytes(data)))

        return on_message

    for topic in topics:
        full = node.resolve_topic_name(topic.name)
        node.create_subscription(topic.kind, topic.name, taker(full), topic.qos, raw=True)


class PolledTopics:
    """Undecoded topics of a recording, in order of reception.

    Args:
        node: subscriber.
        topics: names relative to its namespace; their queues bound the time between two calls of `take`.
    """

    def __init__(self, node: Node, topics: Sequence[Topic]) -> None:
        self._topics = [PolledTopic(node, topic.kind, topic.name, topic.polled, raw=True) for topic in topics]

    def take(self) -> list[Raw]:
        """Return the messages since the last call, in order of reception."""
        found = []
        for topic in self._topics:
            for data, info in topic.take():
                received = int(info["received_timestamp"]) or time.time_ns()
                found.append(Raw(topic.name, received, int(info["source_timestamp"]), bytes(data)))
        return sorted(found, key=lambda message: message.received)
