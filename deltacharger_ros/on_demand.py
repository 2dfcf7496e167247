# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that wake their node's executor only while somebody needs what comes, or never.

They are matched with their publishers all the time, so that the first message costs no discovery; unneeded, the
newest messages wait in the reader's history, and nothing of the node runs for them. At a hundred messages a second, an
executor costs more than what most callbacks do.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import QoSProfile


class Gate(MutuallyExclusiveCallbackGroup):
    """Callbacks that no executor calls, nor waits for, until the gate is open.

    Attributes:
        is_open: whether they are; an executor notices at its next look, which `wake` brings about.
    """

    def __init__(self) -> None:
        super().__init__()
        self.is_open = False

    def can_execute(self, entity: Any) -> bool:
        """Return whether the gate is open and nothing of the group runs."""
        return self.is_open and super().can_execute(entity)

    def beginning_execution(self, entity: Any) -> bool:
        """Take the turn, where the gate is open."""
        return self.is_open and super().beginning_execution(entity)


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
        self._node = node
        self._callback = callback
        self._gate = Gate()
        self._lock = threading.Lock()
        self._listeners = 0
        self._subscription: Any = node.create_subscription(kind, name, callback, qos, callback_group=self._gate)

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
            if (self._listeners > 0) == self._gate.is_open:
                return
            if not self._gate.is_open:
                self._catch_up()
            self._gate.is_open = not self._gate.is_open
            if self._node.executor is not None:
                self._node.executor.wake()

    def _catch_up(self) -> None:
        """Hand over the newest of the messages that came while nobody listened, and drop the others."""
        newest, handle = None, self._subscription.handle
        with handle:
            while taken := handle.take_message(self._subscription.msg_type, False):
                newest = taken[0]
        if newest is not None:
            self._callback(newest)


class PolledTopic:
    """A subscription that no executor serves: whoever calls `take` gets what has come since.

    Args:
        node: subscribes; the depth bounds how many messages are kept between two calls.
        kind: message class.
        name: of the topic, relative to the node's namespace.
        qos: of the subscription.
        raw: whether messages are left as they came, in bytes.

    Attributes:
        name: the same, resolved.
    """

    def __init__(self, node: Node, kind: type[Any], name: str, qos: QoSProfile, *, raw: bool = False) -> None:
        self.name = node.resolve_topic_name(name)
        self._context: Any = node.context
        self._subscription: Any = node.create_subscription(
            kind, name, lambda message: None, qos, callback_group=Gate(), raw=raw
        )
        self._set: Any = None

    def take(self) -> Iterator[tuple[Any, Any]]:
        """Yield what has come since the last call, each with its times as rclpy tells them (ns); from one thread."""
        subscription = self._subscription
        with contextlib.suppress(InvalidHandle), subscription.handle:  # ROS was shut down meanwhile
            while taken := subscription.handle.take_message(subscription.msg_type, subscription.raw):
                yield taken

    def wait(self, timeout: float) -> None:
        """Wait until a message is there, at most `timeout` s; from one thread."""
        try:
            if self._set is None:
                self._set = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, self._context.handle)
            with self._subscription.handle:
                self._set.clear_entities()
                self._set.add_subscription(self._subscription.handle)
                self._set.wait(int(timeout * 1e9))
        except InvalidHandle:  # ROS was shut down
            time.sleep(timeout)
