# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that wake their node's thread only while their messages are needed, or never.

They stay matched with their publishers, so the first message needs no discovery. Until then the newest messages wait in
the reader's history without any work for the node.

Messages are taken by `Subscription.handle`, as in `rclpy.wait_for_message`. Taking a TactileFrame this way costs 44 µs
of processor time, a callback of rclpy's EventsExecutor 102 µs, an untaken message nothing (docs/benchmarks.md). At
rest a charger's nodes receive 600 messages a second and need few of them.

A topic with untrusted publishers is received as bytes and read by its owner, one message after another. With an
ordinary subscription the node's thread would read an endless message, end with the first one that is no message, and
not know who sent it (`EventsExecutor` has no message info).
"""

import contextlib
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

_FRAME_ID = 12  # byte offset of its length in the CDR of a message with a header: 4 head, 8 stamp


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
        qos: quality of service; its depth bounds how many messages are kept, and taken at once.
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
        self._depth = qos.depth
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
            for _ in range(self._depth):  # a flood must not hold its reader
                if not (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)):
                    return
                yield taken


class Received(NamedTuple):
    """A message of an untrusted publisher.

    Attributes:
        data: CDR bytes.
        publisher: id of its publisher; empty if the middleware or rclpy does not provide it, as before ROS 2 Kilted.
        kind: message class.
    """

    data: bytes
    publisher: bytes
    kind: type[Any]

    def read(self) -> Any:
        """Return the message; None if the bytes are invalid."""
        try:
            return deserialize_message(self.data, self.kind)
        except Exception:  # each middleware raises its own
            return None

    def frame_id(self, longest: int) -> str | None:
        """Return the header's frame_id without reading the rest; None if invalid or longer than `longest`."""
        try:
            (length,) = struct.unpack_from("<I" if self.data[1] & 1 else ">I", self.data, _FRAME_ID)
            text = self.data[_FRAME_ID + 4 : _FRAME_ID + 4 + length]
            if not 0 < length <= longest + 1 or len(text) < length:
                return None
            return text[:-1].decode()
        except (IndexError, struct.error, UnicodeDecodeError):
            return None


class BoundedTopic:
    """A topic with untrusted publishers; its owner reads the messages that it wants.

    Args:
        node: subscriber.
        kind: message class.
        name: topic, relative to the node's namespace.
        qos: quality of service; its depth bounds how many messages are kept, and taken at once.
    """

    def __init__(self, node: Node, kind: type[Any], name: str, qos: QoSProfile) -> None:
        self._kind = kind
        self._topic = PolledTopic(node, kind, name, qos, raw=True)
        self.name = self._topic.name

    def take(self) -> list[Received]:
        """Return the messages received since the last call, oldest first."""
        return [Received(data, _publisher(info), self._kind) for data, info in self._topic.take()]


def _publisher(info: Any) -> bytes:
    gid = info.get("publisher_gid") if isinstance(info, dict) else None
    return bytes(gid["data"]) if isinstance(gid, dict) and "data" in gid else b""


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
