# SPDX-License-Identifier: Apache-2.0
"""Topics read in batches by a thread of one's own: at hundreds of messages a second an executor costs far more."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.waitable import Waitable

from deltacharger_bringup.mcap_recording import Raw, Topic


class _Unserved(CallbackGroup):
    """Callbacks that no executor calls."""

    def can_execute(self, entity: Waitable[Any] | Any) -> bool:
        """Say no."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Say no."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


class PolledTopics:
    """Subscribes to topics, undecoded; whoever calls `take` gets what has come since.

    Args:
        node: subscribes; the depths of the topics bound how long may pass between two calls.
        topics: names relative to its namespace.
    """

    def __init__(self, node: Node, topics: Sequence[Topic]) -> None:
        group = _Unserved()
        self._subscriptions = [
            (
                node.resolve_topic_name(topic.name),
                node.create_subscription(
                    topic.kind, topic.name, lambda message: None, topic.qos, callback_group=group, raw=True
                ),
            )
            for topic in topics
        ]

    def take(self) -> list[Raw]:
        """Return what has come since the last call, in the order of its arrival."""
        found = []
        for topic, subscription in self._subscriptions:
            handle: Any = subscription.handle
            with handle:
                while (taken := handle.take_message(subscription.msg_type, True)) is not None:
                    data, info = taken
                    received = int(info["received_timestamp"]) or time.time_ns()
                    found.append(Raw(topic, received, int(info["source_timestamp"]), bytes(data)))
        return sorted(found, key=lambda message: message.received)
