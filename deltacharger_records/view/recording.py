# SPDX-License-Identifier: Apache-2.0
"""A recording as the messages that the live view shows: whose they are, and one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from deltacharger_records.recording.mcap_recording import McapFile, RecordingError, type_name
from deltacharger_records.view.feed import TOPICS, ViewFeed
from deltacharger_ros.raw_topics import Raw, Topic


class OtherRecording(ValueError):
    """A recording holds nothing that can be shown, or more than one charger; the message says what to do."""


class Recorded:
    """What of an MCAP file is shown.

    Args:
        path: of the file.
        namespace: of the charger; '' = the only one in it.

    Attributes:
        topics: what it holds of one charger, by full name.

    Raises:
        RecordingError: it is no MCAP file, damaged or not ended, or mcap is not installed.
        OtherRecording: it holds nothing to show, or several chargers.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, namespace: str = "") -> None:
        self._file = McapFile(path)
        chargers: dict[str, dict[str, Topic]] = {}
        there = _channels(path)
        for full, kind in there.items():
            for topic in TOPICS:
                prefix = full.removesuffix(f"/{topic.name}")
                if prefix != full and kind == type_name(topic.kind):
                    chargers.setdefault(prefix.strip("/"), {})[full] = topic
        if namespace:
            chargers = {name: topics for name, topics in chargers.items() if name == namespace}
        if not chargers:
            held = ", ".join(sorted(there)) or "nothing"
            whose = f" of /{namespace}" if namespace else ""
            raise OtherRecording(f"{path}: no topic of a charger{whose} that can be shown; it holds {held}")
        if len(chargers) > 1:
            names = ", ".join(f"/{name}" for name in sorted(chargers))
            raise OtherRecording(f"{path} holds several chargers, {names}: choose one with --namespace")
        self.topics: Mapping[str, Topic] = next(iter(chargers.values()))

    def play(self, feed: ViewFeed, stop: Callable[[], bool]) -> None:
        """Hand every message to `feed` as fast as it takes them, until `stop`.

        Raises:
            RecordingError: the file is damaged.
        """
        kinds = {type_name(topic.kind): topic.kind for topic in self.topics.values()}
        for raw, message in self._file.messages(kinds, *self.topics):
            if stop():
                return
            self._hand(feed, raw, message)

    def _hand(self, feed: ViewFeed, raw: Raw, message: Any) -> None:
        feed.take(self.topics[raw.topic].name, raw.received, lambda: message)


def _channels(path: Path) -> dict[str, str]:
    """Return the type of every topic in a file."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        try:
            summary = make_reader(stream).get_summary()
        except McapError as error:
            raise RecordingError(f"{path} is damaged: {error}") from error
    if summary is None:
        raise RecordingError(f"{path} has no index: it was not ended")
    return {each.topic: summary.schemas[each.schema_id].name for each in summary.channels.values() if each.schema_id}
