# SPDX-License-Identifier: Apache-2.0
"""Topics read in batches by a thread of one's own: at hundreds of messages a second an executor costs far more."""

from __future__ import annotations

import time
from collections.abc import Sequence

from rclpy.node import Node

from deltacharger_records.recording.mcap_recording import Raw, Topic
from deltacharger_ros.on_demand import PolledTopic


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
