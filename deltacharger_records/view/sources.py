# SPDX-License-Identifier: Apache-2.0
"""Sources of a view's messages: a running charger's topics, polled, or a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.context import Context
from rclpy.serialization import deserialize_message

from deltacharger_core.mcap_file import McapFile, RecordingError
from deltacharger_records.node_parameters import recorded_settings
from deltacharger_records.recording.docking_topics import TOPICS as RECORDED
from deltacharger_records.recording.mcap_recording import decode, type_name
from deltacharger_records.replay.file import message_decoder
from deltacharger_records.view.feed import TOPICS, ViewFeed
from deltacharger_ros.guest import Guest
from deltacharger_ros.raw_topics import PolledTopics, Topic


class Listener(Guest):
    """Subscribes, and passes messages to a feed; messages that are not displayed are not even decoded.

    It uses no executor: at 300 messages a second, that costs more than displaying them, and latency does not matter.

    Args:
        context: a running rclpy context.
        namespace: of the charger.
        topics: relative names; their queues must hold the messages between two polls.
    """

    def __init__(self, context: Context, namespace: str, topics: Sequence[Topic]) -> None:
        super().__init__("charger_view", context, namespace)
        self._topics = PolledTopics(self.node, topics)
        self._by_name = {self.node.resolve_topic_name(topic.name): topic for topic in topics}

    def hand(self, feed: ViewFeed) -> None:
        """Pass all messages since the last call to `feed`, in the order of arrival."""
        for message in self._topics.take():
            topic = self._by_name[message.topic]
            feed.take(topic.name, message.received, partial(deserialize_message, message.data, topic.kind))


class ShownRecording:
    """The displayed content of an MCAP file.

    Args:
        path: of the file, or of a folder with one.
        namespace: of the charger; '' = the only one in the file.

    Attributes:
        settings: docking_node's parameters and geometry; None if not recorded.

    Raises:
        RecordingError: mcap is not installed, or the file is not MCAP, has nothing to display, or several chargers.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, namespace: str = "") -> None:
        self._file = McapFile(path)
        path = self._file.path
        self.settings = recorded_settings(self._file)
        chargers: dict[str, dict[str, Topic]] = {}
        for full, kind in self._file.types.items():
            for topic in TOPICS:
                prefix = full.removesuffix(f"/{topic.name}")
                if prefix != full and kind == type_name(topic.kind):
                    chargers.setdefault(prefix.strip("/"), {})[full] = topic
        if namespace:
            chargers = {name: topics for name, topics in chargers.items() if name == namespace}
        if not chargers:
            held = ", ".join(sorted(self._file.types)) or "nothing"
            whose = f" of /{namespace}" if namespace else ""
            raise RecordingError(f"{path}: no topic of a charger{whose} to show; it holds {held}")
        if len(chargers) > 1:
            names = ", ".join(f"/{name}" for name in sorted(chargers))
            raise RecordingError(f"{path} holds several chargers, {names}: name one with --namespace")
        self._topics = next(iter(chargers.values()))
        self._decoders = {full: self._decoder(full, topic) for full, topic in self._topics.items()}

    def play(self, feed: ViewFeed, stop: Callable[[], bool]) -> None:
        """Pass every message to `feed` at full speed, until `stop`.

        Raises:
            RecordingError: the file is damaged or truncated.
        """
        for raw in self._file.messages(*self._topics):
            if stop():
                return
            topic = self._topics[raw.topic]
            feed.take(topic.name, raw.received, partial(self._decoders[raw.topic], raw.data))

    def _decoder(self, full: str, topic: Topic) -> Callable[[bytes], Any]:
        """Return what decodes a topic's messages; it raises ValueError if another version defined them differently."""
        if topic not in RECORDED:  # an image, which no version of this package defines
            return partial(decode, kind=topic.kind)
        try:
            return message_decoder(self._file, full, topic.kind)
        except RecordingError as error:
            problem = str(error)

            def refuse(data: bytes) -> Any:
                raise ValueError(problem)

            return refuse
