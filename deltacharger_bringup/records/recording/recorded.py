# SPDX-License-Identifier: Apache-2.0
"""Read one charger's topics from an MCAP file: a record, or what `ros2 bag record` wrote."""

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from deltacharger_bringup.records.recording import folder, mcap_recording
from deltacharger_core.mcap_file import DamagedRecording, McapFile, RecordingError

_PART = re.compile(r"\n=+\nMSG: ")


class Recording:
    """One charger's topics in a file: a record of docking_recorder_node, or MCAP of `ros2 bag record`.

    Args:
        path: of the file, or of a folder with one.
        namespace: of the charger; '' = the only one in the file.
        topics: to read.
        states: whether docking_state must be among them.

    Attributes:
        path, file: the file.
        namespace: of the charger, '/' = none.
        counts: messages of each topic, by relative name.
        damage: why reading stopped before the end; '' = the file is complete, as far as it was read.

    Raises:
        RecordingError: mcap is not installed, the file holds no such charger or several, or messages with other fields
            than the installed ones.
        OSError: it cannot be read.
    """

    def __init__(
        self,
        path: Path,
        namespace: str = "",
        topics: Sequence[mcap_recording.Topic] = mcap_recording.TOPICS,
        states: bool = True,
    ) -> None:
        self.file = McapFile(path)
        self.path, self.damage = self.file.path, self.file.damage
        chargers = _chargers(self.file, topics, states)
        wanted = f"/{namespace.strip('/')}" if namespace else ""
        if not chargers or (wanted and wanted not in chargers):
            what = f"{mcap_recording.STATE if states else 'topic of a charger'}{f' of {wanted}' if wanted else ''}"
            held = ", ".join(chargers or sorted(self.file.types)) or "nothing"
            why = f" ({self.damage})" if self.damage else ""
            raise RecordingError(f"{self.path} holds no {what}; it holds {held}{why}")
        if not wanted and len(chargers) > 1:
            names = ", ".join(sorted(chargers))
            raise RecordingError(f"{self.path} holds several chargers, {names}: name one with --namespace")
        self.namespace = wanted or next(iter(chargers))
        self._topics = chargers[self.namespace]
        self.counts = {topic.name: self.file.counts[full] for full, topic in self._topics.items()}
        for full, topic in self._topics.items():
            _check_fields(self.file, full, topic.kind)
        if states and not self.counts[mcap_recording.STATE]:
            raise RecordingError(f"{self.path} has no readable docking_state: {self.damage or 'no messages'}")

    def messages(self) -> Iterator[tuple[mcap_recording.Topic, int, bytes]]:
        """Yield each message, undecoded, in the order of the file, up to its damage: topic, ns since 1970, CDR."""
        try:
            for message in self.file.messages(*self._topics):
                yield self._topics[message.topic], message.received, message.data
        except DamagedRecording as error:
            self.damage = error.reason

    def read(self, take: Callable[[str, int, Any], None]) -> None:
        """Pass each message to `take` in the order of the file, up to its damage: relative topic, ns, message."""
        try:
            for topic, received, data in self.messages():
                take(topic.name, received, decode(data, topic.kind))
        except RecordingError as error:
            self.damage = str(error)


def _chargers(
    file: McapFile, topics: Sequence[mcap_recording.Topic], states: bool
) -> dict[str, dict[str, mcap_recording.Topic]]:
    """Return each charger's topics by full name, by its namespace: with docking_state only, if any or `states`."""
    found: dict[str, dict[str, mcap_recording.Topic]] = {}
    for full, kind in file.types.items():
        for topic in topics:
            if full.endswith(f"/{topic.name}") and kind == mcap_recording.type_name(topic.kind):
                found.setdefault(full.removesuffix(topic.name).rstrip("/") or "/", {})[full] = topic
    docking = {
        name: own for name, own in found.items() if any(topic.name == mcap_recording.STATE for topic in own.values())
    }
    return docking if docking or states else found


def _check_fields(file: McapFile, topic: str, kind: Any) -> None:
    """Refuse messages with other fields than the installed ones, whose bytes would be misread.

    `ros2 bag record` stores no definition that it does not find, and none of an action in a form of its own.
    """
    about = file.metadata_named(folder.ABOUT)
    definition = file.definitions[topic] if about or "/action/" not in mcap_recording.type_name(kind) else ""
    if definition and _fields(definition) != _fields(mcap_recording.schema_text(kind)):
        writer = f"deltacharger {about[0].get('version', '')}" if about else "the version that published them"
        raise RecordingError(
            f"{file.path}: {topic} has other fields than the installed {mcap_recording.type_name(kind)}: use {writer}"
        )


def _fields(text: str) -> dict[str, list[str]]:
    """Return the fields (type and name) of each message in a schema, without comments and constants; '' = the first."""
    first, *parts = _PART.split(text)
    named = {name: own for name, _, own in (part.partition("\n") for part in parts)} | {"": first}
    lines = {name: [line.partition("#")[0].split() for line in own.splitlines()] for name, own in named.items()}
    return {
        name: [" ".join(words[:2]) for words in own if words and "=" not in " ".join(words)]
        for name, own in lines.items()
    }


def decode(data: bytes, kind: Any) -> Any:
    """Return a recorded message.

    Raises:
        RecordingError: the bytes are not of this class; live files have no checksums that would detect this earlier.
    """
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # rclpy raises private error classes
        raise RecordingError(f"the file is damaged from here on: no {kind.__name__}: {error}") from error
