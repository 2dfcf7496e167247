# SPDX-License-Identifier: Apache-2.0
"""A running charger's topics, looked into now and then.

No executor: at 300 messages a second its wait sets cost more than showing what came, and nothing here is in a hurry.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any

from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from deltacharger_records.view.feed import ViewFeed
from deltacharger_ros.raw_topics import Topic


class Listener:
    """Subscribes, and hands a feed what came; what is not shown is not even decoded.

    Args:
        context: a running rclpy context.
        namespace: of the charger.
        topics: relative names; their queues must hold what comes between two looks.
    """

    def __init__(self, context: Context, namespace: str, topics: Sequence[Topic]) -> None:
        self._node = Node(
            f"charger_view_{os.getpid()}",
            context=context,
            namespace=namespace,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._subscriptions = [
            (topic, self._node.create_subscription(topic.kind, topic.name, _ignore, topic.qos, raw=True))
            for topic in topics
        ]

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()

    def hand(self, feed: ViewFeed) -> None:
        """Give `feed` all messages since the last time, in the order in which they came."""
        came = []
        for topic, subscription in self._subscriptions:
            with subscription.handle:
                while (taken := subscription.handle.take_message(topic.kind, True)) is not None:
                    data, info = taken
                    came.append((int(info["received_timestamp"]) or time.time_ns(), topic, data))
        for received, topic, data in sorted(came, key=lambda each: each[0]):
            self._decode(feed, received, topic, data)

    @staticmethod
    def _decode(feed: ViewFeed, received: int, topic: Topic, data: bytes) -> None:
        feed.take(topic.name, received, lambda: deserialize_message(data, topic.kind))


def _ignore(message: Any) -> None:
    """Never called: nobody spins this node."""
