# SPDX-License-Identifier: Apache-2.0
"""Write one record per docking, from shortly before its goal until the arm is home. Uses ROS messages only."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from rclpy.serialization import deserialize_message

from deltacharger_core.files import flush
from deltacharger_core.mcap_file import Raw, RecordingError
from deltacharger_core.texts import REQUEST_ID_MAX, cut
from deltacharger_docking.codes import Code
from deltacharger_records.node_parameters import with_geometry
from deltacharger_records.recording.docking_topics import ALWAYS, DECISION, STATE
from deltacharger_records.recording.folder import END, PARAMETERS, RESULT, RecordFolder
from deltacharger_records.recording.gate import Gate
from deltacharger_records.recording.mcap_recording import McapStream, pack
from deltacharger_records.recording.own import ABOUT, head
from deltacharger_records.recording.session import Seen, Session
from deltacharger_ros.outcomes import Outcome
from deltacharger_ros.raw_topics import Topic

_FLUSH = 1.0  # s of messages that a killed recorder loses at most
_PRUNE = 10.0  # s between checks of the folder's size while recording


@dataclass
class _File:
    """A record being written."""

    path: Path
    stream: BinaryIO
    mcap: McapStream


class DockingRecorder:
    """Takes every message of the recorded topics and writes each docking to a separate file.

    Times are s, monotonic; written messages keep their own times.

    Args:
        folder: of the records.
        gate: selects the messages to keep; built by `gate_for`.
        names: full name by relative one.
        topics: by their full names.
        about: metadata of every record: version, scene, namespace.

    Attributes:
        problem: why the current docking is not recorded, or no longer; '' = it is.
    """

    def __init__(
        self,
        folder: RecordFolder,
        gate: Gate,
        names: Mapping[str, str],
        topics: Mapping[str, Topic],
        about: Mapping[str, str],
    ) -> None:
        self.problem = ""
        self._folder = folder
        self._gate = gate
        self._state, self._decision = names[STATE], names[DECISION]
        self._topics = topics
        self._about = about
        self._session = Session()
        self._file: _File | None = None
        self._code = 0  # last error code of docking_state in this record
        self._results: list[Outcome] = []
        self._flushed = self._pruned = 0.0

    @property
    def path(self) -> Path | None:
        """The file being written, or None."""
        return self._file.path if self._file is not None else None

    @property
    def passed_by(self) -> Mapping[str, str]:
        """Files in the folder that are named like records but left alone: the reason by name."""
        return self._folder.passed_by

    def take(self, now: float, message: Raw) -> None:
        """Take one message; an unreadable one, as a foreign node may send it, is left out."""
        body: Any = None
        if message.topic in (self._state, self._decision):
            try:
                body = deserialize_message(message.data, self._topics[message.topic].kind)
            except RuntimeError:  # raised by the middleware
                return
        if message.topic == self._state:
            self._take_state(now, message, body)
        elif body is not None and self._session.is_news(body.kind):
            self._gate.stir(now)
        self._write(self._gate.offer(now, message))

    def take_result(self, outcome: Outcome) -> None:
        """Take the outcome of a goal of this docking."""
        if self._session.under_way:
            self._results.append(outcome)
            self._note(RESULT, {"action": outcome.action, "json": json.dumps(outcome.as_dict())})

    def take_parameters(self, values: Mapping[str, Any]) -> None:
        """Take docking_node's parameters, and keep them with the content of its geometry file."""
        content = with_geometry(values)
        self._note(PARAMETERS, {name: json.dumps(value) for name, value in sorted(content.items())})

    def tick(self, now: float, alive: bool) -> None:
        """Flush, limit the folder's size, and end a complete record.

        Args:
            now: s.
            alive: whether docking_state has a publisher.
        """
        self._session.note_publisher(now, alive)
        if self._session.is_over(now):
            self._end()
        if self._file is None:
            return
        with self._failing():
            if now - self._flushed >= _FLUSH:
                self._flushed = now
                self._file.mcap.flush()
            if now - self._pruned >= _PRUNE:
                self._pruned = now
                self._folder.prune()

    def close(self) -> None:
        """End the current record, if there is one."""
        if self._session.under_way:
            self._end()

    def _take_state(self, now: float, message: Raw, body: Any) -> None:
        request_id = body.request_id[:REQUEST_ID_MAX]
        seen = Seen(body.state, body.docked, body.charging, body.error_code, cut(body.error_message), request_id)
        if self._session.begins(seen):
            self.close()
            self._begin(now, message, seen)
        self._session.see(now, seen)
        self._code = seen.code or self._code
        self._gate.stir(now)
        if seen.quiet:
            self._gate.rest(now)
        else:
            self._gate.wake()

    def _begin(self, now: float, message: Raw, seen: Seen) -> None:
        self._session.begin()
        self._code, self._results, self.problem = 0, [], ""
        self._flushed = self._pruned = now
        held = self._gate.open()
        with self._failing():
            about = head(self._about, message.received, seen.request_id)
            path, stream = self._folder.create(message.received, seen.request_id)
            try:
                mcap = McapStream(stream, self._topics, live=True, metadata=[(ABOUT, about)])
                flush(stream)  # from now on the head shows that the file is ours, even after a crash
            except (OSError, RecordingError):
                self._folder.forget(path, stream)
                raise
            self._file = _File(path, stream, mcap)
        self._write(held)

    def _end(self) -> None:
        """Complete the record and rename it."""
        self._write(self._gate.close())
        file, last = self._file, self._session.last
        if file is not None and last is not None:
            ending = self._ending()
            dropped = json.dumps(dict(self._gate.dropped))
            self._note(END, {"ending": ending, "state": str(last.state), "message": last.message, "dropped": dropped})
            with self._failing():
                file.mcap.finish()
                flush(file.stream)
                if last.at_home and not (self._code or self._session.went_out):  # an undock without a docking
                    self._folder.forget(file.path, file.stream)
                else:
                    path = self._folder.finish(file.path, file.stream, ending)
                    with (
                        contextlib.suppress(OSError, RecordingError),  # then the record stays unpacked
                        self._folder.rewriting(path, file.stream) as packed,
                    ):
                        pack(path, packed, self._topics)
                file.stream.close()
                self._folder.prune()
        self._file = None
        self._session.end()

    def _ending(self) -> str:
        """Return the ending in the record's name: a code's name, OK, or UNFINISHED without an outcome."""
        if self._code:
            return Code(self._code).name if self._code in list(Code) else str(self._code)
        first = next((each for each in self._results if each.action == "dock"), None) or next(iter(self._results), None)
        if first is not None:
            return "OK" if first.success else first.error_name
        return "OK" if self._session.arrived else "UNFINISHED"

    def _write(self, messages: Iterable[Raw]) -> None:
        if self._file is None:
            return
        with self._failing():
            for message in messages:
                self._file.mcap.add(message)

    def _note(self, name: str, values: Mapping[str, str]) -> None:
        if self._file is None:
            return
        with self._failing():
            self._file.mcap.add_metadata(name, values)

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        """End the recording of this docking if the disk does not accept it, or a library is missing."""
        try:
            yield
        except (OSError, RecordingError) as error:
            self.fail(error)

    def fail(self, error: Exception) -> None:
        """Stop recording this docking; data on the disk stay, and the next docking is recorded again."""
        self.problem = f"{'nothing is recorded' if self._file is None else 'recording ended'}: {error}"
        file, self._file = self._file, None
        if file is not None:
            with contextlib.suppress(Exception):
                file.mcap.flush()
            with contextlib.suppress(OSError):
                file.stream.close()


def gate_for(names: Mapping[str, str], before: float, rate: float, folder_bytes: int) -> Gate:
    """Return the gate of a recorder.

    Args:
        names: full name by relative one.
        before: s kept before an event.
        rate: messages of each topic per second, kept while charging.
        folder_bytes: limit of the folder; one record takes at most half of it.
    """
    return Gate(before, rate, folder_bytes // 2, [names[name] for name in ALWAYS])
