# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that wake their node's thread only while somebody needs what comes, or never.

They are matched with their publishers all the time, so that the first message costs no discovery; unneeded, the
newest messages wait in the reader's history, and nothing of the node runs for them.

Messages are taken by `Subscription.handle`, as `rclpy.wait_for_message` does: taking a TactileFrame so costs 44 µs of
processor time, a callback of rclpy's EventsExecutor 102 µs, and one that nobody takes nothing (docs/benchmarks.md). At
rest a charger's nodes hear 600 messages a second and need few of them.
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
    """A group whose callbacks nobody calls until it is open.

    Attributes:
        is_open: whether it is; the node's executor notices when it is woken.
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
        """Nothing was begun."""


class PolledTopic:
    """A subscription of which the node's thread knows nothing: whoever calls `take` gets what has come since.

    Args:
        node: subscribes; the depth bounds how many messages are kept between two calls.
        kind: message class.
        name: of the topic, relative to the node's namespace.
        qos: of the subscription.
        raw: whether messages are left as they came, in bytes.
        callback: gets what comes while the topic is open, and `take` then what came before.

    Attributes:
        name: the same, resolved.
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
        """Whether the node's thread takes what comes and calls the callback."""
        return self._gate.is_open

    def set_open(self, is_open: bool) -> None:
        """Let the node's thread take what comes, or leave it to `take` again."""
        if is_open != self._gate.is_open:
            self._gate.is_open = is_open
            if self._node.executor is not None:
                self._node.executor.wake()

    def take(self) -> Iterator[tuple[Any, Any]]:
        """Yield what waits in the reader, each with its times as rclpy tells them (ns)."""
        subscription = self._subscription
        with contextlib.suppress(RuntimeError), subscription.handle:  # ROS was shut down meanwhile
            while taken := subscription.handle.take_message(subscription.msg_type, subscription.raw):
                yield taken


class OnDemandSubscription:
    """A subscription whose callback is called only while somebody listens.

    Args:
        node: subscribes.
        kind: message class.
        name: of the topic, relative to the node's namespace.
        callback: gets every message that comes meanwhile, and at the beginning the newest of those before.
        qos: of the subscription.
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
        """Hear the topic meanwhile; any number of threads at once."""
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
    """The newest message of a topic, for a thread that polls it, or that goes by its pace.

    Args:
        node: subscribes.
        kind: message class.
        name: of the topic, relative to the node's namespace.
        qos: of the subscription.
    """

    def __init__(self, node: Node, kind: type[Any], name: str, qos: QoSProfile) -> None:
        self._came = threading.Event()
        self._heard: deque[Any] = deque(maxlen=1)
        self._topic = PolledTopic(node, kind, name, qos, callback=self._hear)

    def take(self) -> Any:
        """Return the newest message that has come since the last call; None where there is none."""
        newest = self._heard.pop() if self._heard else None
        for message, _ in self._topic.take():
            newest = message
        return newest

    def wait(self, timeout: float) -> None:
        """Wait until one is there, at most `timeout` s; from now on until `rest`, the node's thread takes all."""
        self._topic.set_open(True)
        if self._came.wait(timeout):
            self._came.clear()

    def rest(self) -> None:
        """Go by the topic's pace no longer."""
        self._topic.set_open(False)

    def _hear(self, message: Any) -> None:
        self._heard.append(message)
        self._came.set()
