# SPDX-License-Identifier: Apache-2.0
"""Write one record per docking, from shortly before its goal until the arm is home. Uses ROS messages only.

`Session` decides from docking_state when a record begins, is quiet and ends; `Gate` selects the messages to keep: all
around events, few during hours of charging. The caller passes the time (s, monotonic), so that tests cover hours in a
moment; written messages keep their own times.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from rclpy.serialization import deserialize_message

from deltacharger_core.files import flush
from deltacharger_core.mcap_file import Raw, RecordingError
from deltacharger_core.texts import REQUEST_ID_MAX, cut
from deltacharger_docking.codes import Code, State
from deltacharger_records.node_parameters import with_geometry
from deltacharger_records.raw_topics import Topic
from deltacharger_records.recording.folder import ABOUT, END, PARAMETERS, RESULT, RecordFolder, head
from deltacharger_records.recording.mcap_recording import ALWAYS, DECISION, STATE, McapStream, pack
from deltacharger_ros.outcomes import Outcome

_FLUSH = 1.0  # s of messages that a killed recorder loses at most
_PRUNE = 10.0  # s between checks of the folder's size while recording
TAIL = 1.0  # s after the arm is home: result, status and last frames still belong to the docking
LOST_AFTER = 5.0  # s without a publisher of docking_state
_HELD_MAX = 16 * 2**20  # bytes kept in memory, at any rates
_STRETCH = 3600  # messages of a topic after which a quiet stretch is thinned more and more


@dataclass(frozen=True)
class Seen:
    """Content of docking_state."""

    state: int
    docked: bool
    charging: bool
    code: int
    message: str
    request_id: str

    @property
    def at_home(self) -> bool:
        """Whether nothing is in progress."""
        return self.state == State.IDLE and not self.docked

    @property
    def quiet(self) -> bool:
        """Whether this state may last for hours."""
        return self.docked and self.state in (State.CHARGING, State.IDLE)


class Session:
    """Consecutive dockings, as docking_state reports them.

    Attributes:
        last: newest docking_state.
        under_way: whether a docking is being recorded.
        went_out: whether the arm did more than return home.
        arrived: whether it docked.
    """

    def __init__(self) -> None:
        self.last: Seen | None = None
        self.under_way = self.went_out = self.arrived = False
        self._home_since = math.inf
        self._lost_since = math.inf
        self._kinds: set[str] = set()

    def begins(self, seen: Seen) -> bool:
        """Whether docking_state belongs to a docking that is not recorded yet."""
        return not seen.at_home and (not self.under_way or self._home_since < math.inf)

    def begin(self) -> None:
        """Note that a record has begun."""
        self.under_way, self.went_out, self.arrived = True, False, False
        self._home_since = self._lost_since = math.inf

    def end(self) -> None:
        """Note that the record has ended."""
        self.under_way = False
        self._home_since = math.inf

    def see(self, now: float, seen: Seen) -> None:
        """Take docking_state."""
        if self.last is None or (seen.state, seen.docked) != (self.last.state, self.last.docked):
            self._kinds = set()
        self.last = seen
        self.went_out |= seen.docked or seen.state not in (State.IDLE, State.RETRACT)
        self.arrived |= seen.docked
        self._home_since = min(self._home_since, now) if seen.at_home else math.inf

    def is_news(self, kind: str) -> bool:
        """Whether a decision is the first of its kind in the present state; routine decisions are not events."""
        known = kind in self._kinds
        self._kinds.add(kind)
        return not known

    def note_publisher(self, now: float, alive: bool) -> None:
        """Note whether docking_state has a publisher."""
        self._lost_since = math.inf if alive else min(self._lost_since, now)

    def is_over(self, now: float) -> bool:
        """Whether the record is complete."""
        return self.under_way and (now - self._home_since >= TAIL or now - self._lost_since >= LOST_AFTER)


class Gate:
    """Takes every message and returns those to write, in order.

    Closed, it holds the last seconds. Open, it passes all messages. In a quiet stretch it holds the last seconds and
    passes few older messages: `rate` a second of each topic, and after an hour's worth fewer and fewer, so that their
    number grows with the logarithm of time. At an event it passes everything that it holds.

    Args:
        before: s to hold.
        rate: messages of each topic per second in a quiet stretch.
        budget: bytes of one record; beyond it only the topics in `always` pass.
        always: topics of which every message passes.

    Attributes:
        dropped: messages of each topic dropped since `open`.
    """

    def __init__(self, before: float, rate: float, budget: int, always: Collection[str]) -> None:
        self._before = before
        self._period = 1.0 / rate
        self._budget = budget
        self._always = frozenset(always)
        self._held: deque[tuple[float, Raw]] = deque()
        self._bytes = 0
        self._waiting = 0  # number of the newest held messages, neither passed nor dropped yet
        self._open = False
        self._quiet_since: float | None = None
        self._all_until = 0.0
        self._last: dict[str, float] = {}
        self._passed = 0
        self.dropped: Counter[str] = Counter()

    def open(self) -> list[Raw]:
        """Begin a record; return the held messages."""
        self._open, self._quiet_since, self._passed = True, None, 0
        self.dropped = Counter()
        self._waiting = len(self._held)
        return self._all()

    def close(self) -> list[Raw]:
        """End the record; return the waiting messages. The last seconds stay held for the next record."""
        rest = self._all() if self._open else []
        self._open = False
        return rest

    def rest(self, now: float) -> None:
        """Begin a quiet stretch: no event has occurred for the held seconds. No effect during one."""
        if self._quiet_since is None:
            self._quiet_since, self._all_until = now, now + self._before
            self._last = {}

    def wake(self) -> None:
        """End the quiet stretch."""
        self._quiet_since = None

    def stir(self, now: float) -> None:
        """Report an event: everything held and what follows is kept."""
        self._all_until = now + self._before

    def offer(self, now: float, message: Raw) -> list[Raw]:
        """Take a message received at `now`; return the messages to write."""
        self._held.append((now, message))
        self._bytes += len(message.data)
        self._waiting += 1
        if not self._open:
            self._waiting = 0
            written: list[Raw] = []
        elif self._quiet_since is None or now < self._all_until:
            written = self._all()
        else:
            written = self._few(now, self._quiet_since)
        self._forget(now)
        return written

    def _all(self) -> list[Raw]:
        start = len(self._held) - self._waiting
        self._waiting = 0
        return [message for _, message in list(self._held)[start:] if self._affords(message)]

    def _few(self, now: float, since: float) -> list[Raw]:
        written = []
        while self._waiting and self._held[-self._waiting][0] <= now - self._before:
            time, message = self._held[-self._waiting]
            self._waiting -= 1
            period = max(self._period, (time - since) / _STRETCH)
            if message.topic in self._always or time - self._last.get(message.topic, -float("inf")) >= period:
                self._last[message.topic] = time
                if self._affords(message):
                    written.append(message)
            else:
                self.dropped[message.topic] += 1
        return written

    def _affords(self, message: Raw) -> bool:
        if self._passed > self._budget and message.topic not in self._always:
            self.dropped[message.topic] += 1
            return False
        self._passed += len(message.data)
        return True

    def _forget(self, now: float) -> None:
        while self._held:
            old = self._held[0][0] < now - self._before and len(self._held) > self._waiting
            if not old and self._bytes <= _HELD_MAX:
                return
            _, message = self._held.popleft()
            self._bytes -= len(message.data)
            if self._waiting > len(self._held):
                self._waiting = len(self._held)
                self.dropped[message.topic] += 1


@dataclass
class _File:
    """A record being written."""

    path: Path
    stream: BinaryIO
    mcap: McapStream


class DockingRecorder:
    """Takes every message of the recorded topics and writes each docking to a separate file.

    Args:
        folder: of the records; one record takes at most half of its bytes.
        topics: by their full names.
        about: metadata of every record: version, scene, namespace.
        before: s kept before an event.
        rate: messages of each topic per second, kept while charging.

    Attributes:
        problem: why the current docking is not recorded, or no longer; '' = it is.
    """

    def __init__(
        self,
        folder: RecordFolder,
        topics: Mapping[str, Topic],
        about: Mapping[str, str],
        before: float,
        rate: float,
    ) -> None:
        names = {topic.name: full for full, topic in topics.items()}
        self.problem = ""
        self._folder = folder
        self._gate = Gate(before, rate, folder.max_bytes // 2, [names[name] for name in ALWAYS])
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
                    self._folder.finish(file.path, file.stream, ending, lambda new: pack(file.path, new, self._topics))
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
