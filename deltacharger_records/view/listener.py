# SPDX-License-Identifier: Apache-2.0
"""A running charger's topics, looked into now and then.

No executor: at 300 messages a second it costs more than showing what came, and nothing here is in a hurry.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from deltacharger_records.view.feed import ViewFeed
from deltacharger_ros.raw_topics import PolledTopics, Topic


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
        self._topics = PolledTopics(self._node, topics)
        self._by_name = {self._node.resolve_topic_name(topic.name): topic for topic in topics}

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()

    def hand(self, feed: ViewFeed) -> None:
        """Give `feed` all messages since the last time, in the order in which they came."""
        for message in self._topics.take():
            self._decode(feed, message.received, self._by_name[message.topic], message.data)

    @staticmethod
    def _decode(feed: ViewFeed, received: int, topic: Topic, data: bytes) -> None:
        feed.take(topic.name, received, lambda: deserialize_message(data, topic.kind))
