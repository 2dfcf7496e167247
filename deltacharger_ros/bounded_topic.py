# SPDX-License-Identifier: Apache-2.0
"""Reads a topic with untrusted publishers: bounded in number and size, and tolerant of invalid messages.

Messages are received as bytes and deserialised one by one by the caller. An oversized message costs only its bytes,
and an unreadable one ends no thread.
"""

from __future__ import annotations

import itertools
import struct
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from deltacharger_ros.on_demand import PolledTopic

_FRAME_ID = 12  # byte offset of its length in the CDR of a message with a header: 4 head, 8 stamp


class Received(NamedTuple):
    """A message as received.

    Attributes:
        data: CDR bytes.
        publisher: id of its publisher; empty if the middleware or rclpy does not provide it.
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
    """The newest messages of a topic, for a thread that polls it.

    Args:
        node: subscriber.
        kind: message class.
        name: topic, relative to the node's namespace.
        qos: quality of service; its depth bounds how many messages are kept and taken at once.
    """

    def __init__(self, node: Node, kind: type[Any], name: str, qos: QoSProfile) -> None:
        self._kind = kind
        self._depth = qos.depth
        self._topic = PolledTopic(node, kind, name, qos, raw=True)
        self.name = self._topic.name

    def take(self) -> list[Received]:
        """Return the messages received since the last call, oldest first."""
        return [
            Received(data, _publisher(info), self._kind)
            for data, info in itertools.islice(self._topic.take(), self._depth)
        ]


def _publisher(info: Any) -> bytes:
    """Return the publisher's id from rclpy's message info; empty before ROS 2 Kilted."""
    gid = info.get("publisher_gid") if isinstance(info, dict) else None
    return bytes(gid["data"]) if isinstance(gid, dict) and "data" in gid else b""
