# SPDX-License-Identifier: Apache-2.0
"""A topic of which nobody knows who publishes it: bounded in number and size, and read without an error.

Messages come as bytes and are understood one by one, by whoever takes them: what is too large costs no more than its
bytes, and what cannot be read ends no thread.
"""

from __future__ import annotations

import itertools
import struct
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from deltacharger_ros.on_demand import PolledTopic

_FRAME_ID = 12  # offset of its length in the CDR of a message that begins with a header: 4 of head, 8 of stamp


class Received(NamedTuple):
    """A message as it came.

    Attributes:
        data: its bytes.
        publisher: id of its publisher; empty where the middleware or rclpy does not tell.
        kind: message class.
    """

    data: bytes
    publisher: bytes
    kind: type[Any]

    def read(self) -> Any:
        """Return the message; None where the bytes are none."""
        try:
            return deserialize_message(self.data, self.kind)
        except Exception:  # each middleware has its own
            return None

    def frame_id(self, longest: int) -> str | None:
        """Return the header's frame_id without reading the rest; None where it is none, or longer than `longest`."""
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
        node: subscribes.
        kind: message class.
        name: of the topic, relative to the node's namespace.
        qos: of the subscription; its depth bounds how many messages are kept, and taken at once.
    """

    def __init__(self, node: Node, kind: type[Any], name: str, qos: QoSProfile) -> None:
        self._kind = kind
        self._depth = qos.depth
        self._topic = PolledTopic(node, kind, name, qos, raw=True)
        self.name = self._topic.name

    def take(self) -> list[Received]:
        """Return what has come since the last call, the oldest first."""
        return [
            Received(data, _publisher(info), self._kind)
            for data, info in itertools.islice(self._topic.take(), self._depth)
        ]


def _publisher(info: Any) -> bytes:
    """Return the publisher's id from what rclpy tells about a message; empty before ROS 2 Kilted."""
    told = info.get("publisher_gid") if isinstance(info, dict) else None
    return bytes(told["data"]) if isinstance(told, dict) and "data" in told else b""
