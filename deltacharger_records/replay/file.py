# SPDX-License-Identifier: Apache-2.0
"""Read a recording of a docking: complete, truncated by a kill, or without some topics.

Accepts records of docking_recorder_node and MCAP files of `ros2 bag record`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from deltacharger_core.mcap_file import DamagedRecording, McapFile, RecordingError
from deltacharger_records.recording.docking_topics import STATE, TOPICS
from deltacharger_records.recording.mcap_recording import decode, schema_text, type_name
from deltacharger_records.replay.older import fields, is_older, older_decoder

_KINDS = {topic.name: topic.kind for topic in TOPICS}
_TYPES = {name: type_name(kind) for name, kind in _KINDS.items()}


class Recording:
    """One charger's dockings in a file.

    Args:
        path: of the file, or of a folder with one.
        namespace: of the charger; None = the only one in the file.

    Attributes:
        path, file: the file.
        namespace: of the charger, '/' = none.
        counts: readable messages of each topic, by relative name.
        damage: why reading stopped before the end; '' = the file is complete, as far as it was read.
        unreadable: topics recorded by another version, with the reason.

    Raises:
        RecordingError: mcap is not installed, or the file is not a recording of a docking.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path, namespace: str | None = None) -> None:
        self.file = McapFile(path)
        self.path = path = self.file.path
        self.namespace = _charger(self.file, namespace)
        self.damage = self.file.damage
        self.counts: dict[str, int] = {}
        self.unreadable: dict[str, str] = {}
        self._names: dict[str, str] = {}
        self._decoders: dict[str, Callable[[bytes], Any]] = {}
        head = self.namespace.rstrip("/") + "/"
        for topic in self.file.types:
            name = topic.removeprefix(head)
            if topic.startswith(head) and name in _TYPES:
                try:
                    self._decoders[name] = message_decoder(self.file, topic, _KINDS[name])
                except RecordingError as error:
                    self.unreadable[name] = str(error)
                    continue
                self._names[topic] = name
                self.counts[name] = self.file.counts[topic]
        if not self.counts.get(STATE):
            why = self.unreadable.get(STATE) or self.damage or "no messages"
            raise RecordingError(f"{path} has no readable docking_state: {why}")

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield each message, undecoded, in the order of the file, up to its damage: relative topic, ns, CDR."""
        try:
            for message in self.file.messages(*self._names):
                yield self._names[message.topic], message.received, message.data
        except DamagedRecording as error:
            self.damage = error.reason

    def read(self, take: Callable[[str, int, Any], None]) -> None:
        """Pass each message to `take` in the order of the file, up to its damage: relative topic, ns, message."""
        try:
            for name, received, data in self.messages():
                take(name, received, self.decoded(name, data))
        except RecordingError as error:
            self.damage = str(error)

    def decoded(self, name: str, data: bytes) -> Any:
        """Return the message of a topic, given by its relative name.

        Raises:
            RecordingError: the bytes are not of its class.
        """
        return self._decoders[name](data)

    def missing(self) -> dict[str, str]:
        """Return the docking topics that the recording lacks, with the reason."""
        return {name: self.unreadable.get(name, "not in the recording") for name in _TYPES if not self.counts.get(name)}


def _charger(file: McapFile, namespace: str | None) -> str:
    """Return the namespace whose docking_state the file holds."""
    found = [
        topic.removesuffix(STATE).rstrip("/") or "/"
        for topic, kind in file.types.items()
        if kind == _TYPES[STATE] and topic.endswith(f"/{STATE}")
    ]
    if namespace is not None:
        wanted = "/" + namespace.strip("/")
        if wanted not in found:
            raise RecordingError(
                f"{file.path} holds no docking_state of {wanted}; it holds {', '.join(found) or 'none'}"
            )
        return wanted
    if len(found) > 1:
        raise RecordingError(f"{file.path} holds several chargers, {', '.join(found)}: name one with --namespace")
    if not found:
        why = f" ({file.damage})" if file.damage else ""
        raise RecordingError(
            f"{file.path} holds no docking_state{why}: record that topic, or use `deltacharger up --record`"
        )
    return found[0]


def message_decoder(file: McapFile, topic: str, kind: Any) -> Callable[[bytes], Any]:
    """Return a decoder for a topic's messages, of this version or an older one.

    Raises:
        RecordingError: the old definition differs by more than missing fields.
    """
    wanted, definition = type_name(kind), file.definitions[topic]
    if file.types[topic] != wanted:
        raise RecordingError(f"is {file.types[topic] or 'untyped'}, not {wanted}")
    then, now = fields(definition), fields(schema_text(kind))
    if then == now or not definition:  # ros2 bag writes none where it does not find the .msg file
        return partial(decode, kind=kind)
    if not is_older(then, now):
        raise RecordingError(f"{wanted} had another definition when this was recorded: replay with that version")
    return older_decoder(definition, wanted, kind)
