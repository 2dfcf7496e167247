# SPDX-License-Identifier: Apache-2.0
"""A running charger's topics, looked into now and then.

No executor: at 300 messages a second it costs more than showing what came, and nothing here is in a hurry.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from rclpy.context import Context
from rclpy.serialization import deserialize_message

from deltacharger_records.view.feed import ViewFeed
from deltacharger_ros.guest import Guest
from deltacharger_ros.raw_topics import PolledTopics, Topic


class Listener(Guest):
    """Subscribes, and hands a feed what came; what is not shown is not even decoded.

    Args:
        context: a running rclpy context.
        namespace: of the charger.
        topics: relative names; their queues must hold what comes between two looks.
    """

    def __init__(self, context: Context, namespace: str, topics: Sequence[Topic]) -> None:
        super().__init__("charger_view", context, namespace)
        self._topics = PolledTopics(self.node, topics)
        self._by_name = {self.node.resolve_topic_name(topic.name): topic for topic in topics}

    def hand(self, feed: ViewFeed) -> None:
        """Give `feed` all messages since the last time, in the order in which they came."""
        for message in self._topics.take():
            topic = self._by_name[message.topic]
            feed.take(topic.name, message.received, partial(deserialize_message, message.data, topic.kind))
