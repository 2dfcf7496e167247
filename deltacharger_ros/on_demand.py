# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that wake their node's thread only while their messages are needed, or never.

They stay matched with their publishers, so the first message needs no discovery. Until then the newest messages wait in
the reader's history without any work for the node.

Messages are taken by `Subscription.handle`, as in `rclpy.wait_for_message`. Taking a TactileFrame this way costs 44 µs
of processor time, a callback of rclpy's EventsExecutor 102 µs, an untaken message nothing (docs/benchmarks.md). At
rest a charger's nodes receive 600 messages a second and need few of them.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile


class GatedGroup(CallbackGroup):
    """A callback group whose callbacks run only while it is open.

    Attributes:
        is_open: whether it is open; the node's executor reads it when woken.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_open = False

    def can_execute(self, entity: Any) -> bool:
        """Return whether the gate is open."""
        return self.is_open

    def beginning_execution(self, entity: Any) -> bool:
        """Return whether the gate is open."""
        return self.is_open

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class PolledTopic:
    """A subscription that its owner polls with `take`, outside the node's thread.

    Args:
        node: subscriber.
        kind: message class.
        name: topic, relative to the node's namespace.
        qos: quality of service; its depth bounds how many messages are kept between two calls.
        raw: whether messages stay bytes.
        callback: gets messages that arrive while the topic is open; `take` then returns only earlier ones.

    Attributes:
        name: resolved name of the topic.
    """

    def __init__(
        self,
        node: Node,
        kind: type[Any],
        name: str,
        qos: QoSProfile,
        *,
        raw: bool = False,
        callback: Callable[[Any], None] = lambda message: None,
    ) -> None:
        self.name = node.resolve_topic_name(name)
        self._node = node
        self._gate = GatedGroup()
        self._subscription: Any = node.create_subscription(
            kind, name, callback, qos, callback_group=self._gate, raw=raw
        )

    @property
    def is_open(self) -> bool:
        """Whether the node's thread takes messages and calls the callback."""
        return self._gate.is_open

    def set_open(self, is_open: bool) -> None:
        """Let the node's thread take the messages (True) or leave them to `take` (False)."""
        if is_open != self._gate.is_open:
            self._gate.is_open = is_open
            if self._node.executor is not None:
                self._node.executor.wake()

    def take(self) -> Iterator[tuple[Any, Any]]:
        """Yield the waiting messages, each with rclpy's message info (times in ns)."""
        subscription = self._subscription
        with contextlib.suppress(RuntimeError), subscription.handle:  # ROS was shut down
            while taken := subscription.handle.take_message(subscription.msg_type, subscription.raw):
                yield taken


class OnDemandSubscription:
    """A subscription whose callback runs only inside `listening`.

    Args:
        node: subscriber.
        kind: message class.
        name: topic, relative to the node's namespace.
        callback: gets the newest earlier message first, then every new message.
        qos: quality of service.
    """

    def __init__(
        self, node: Node, kind: type[Any], name: str, callback: Callable[[Any], None], qos: QoSProfile
    ) -> None:
        self._callback = callback
        self._lock = threading.Lock()
        self._listeners = 0
        self._topic = PolledTopic(node, kind, name, qos, callback=callback)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Receive the topic inside the `with` block; several threads may do so at once."""
        self._count(1)
        try:
            yield
        finally:
            self._count(-1)

    def _count(self, step: int) -> None:
        with self._lock:
            self._listeners += step
            if self._listeners and not self._topic.is_open:
                for message, _ in list(self._topic.take())[-1:]:
                    self._callback(message)
            self._topic.set_open(self._listeners > 0)


class LatestMessage:
    """The newest message of a topic, for a thread that polls it or waits for each message.

    Args:
        node: subscriber.
        kind: message class.
        name: topic, relative to the node's namespace.
        qos: quality of service.
    """

    def __init__(self, node: Node, kind: type[Any], name: str, qos: QoSProfile) -> None:
        self._arrived = threading.Event()
        self._received: deque[Any] = deque(maxlen=1)
        self._topic = PolledTopic(node, kind, name, qos, callback=self._on_message)

    def take(self) -> Any:
        """Return the newest message since the last call; None = none."""
        newest = self._received.pop() if self._received else None
        for message, _ in self._topic.take():
            newest = message
        return newest

    def wait(self, timeout: float) -> None:
        """Wait for a message, at most `timeout` s. Until `rest` the node's thread takes all messages."""
        self._topic.set_open(True)
        if self._arrived.wait(timeout):
            self._arrived.clear()

    def rest(self) -> None:
        """Return to polling."""
        self._topic.set_open(False)

    def _on_message(self, message: Any) -> None:
        self._received.append(message)
        self._arrived.set()
