# SPDX-License-Identifier: Apache-2.0
"""Write one record per docking, from shortly before its goal until the arm is home. Uses ROS messages only.

docking_state decides when a record begins, is quiet and ends; `Gate` selects the messages to keep: all around events,
few during hours of charging. The caller passes the time (s, monotonic), so that tests cover hours in a moment; written
messages keep their own times.
"""

import contextlib
import json
import math
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from deltacharger_bringup.records.node_parameters import with_geometry
from deltacharger_bringup.records.recording.folder import ABOUT, END, PARAMETERS, RESULT, RecordFolder
from deltacharger_bringup.records.recording.mcap_recording import ALWAYS, DECISION, STATE, McapWriter, Topic
from deltacharger_core import mcap_file, texts
from deltacharger_core.files import flush
from deltacharger_core.ros.outcomes import Outcome
from deltacharger_docking.codes import Code, State

BEFORE = 2.0  # s kept before the goal and before each event
PERIOD = 1.0  # s between the kept messages of a topic while charging
_STRETCH = 3600  # messages of a topic after which a quiet stretch is thinned more and more
_FLUSH = 1.0  # s of messages that a killed recorder loses at most
_PRUNE = 10.0  # s between checks of the folder's size while recording
TAIL = 1.0  # s after the arm is home: result and last frames still belong to the docking
LOST_AFTER = 5.0  # s without a publisher of docking_state


class Gate:
    """Takes every message and returns those to write, in order.

    Closed, it holds the last seconds. Open, it passes all messages. In a quiet stretch it holds the last seconds and
    passes few older messages: one of each topic per `PERIOD`, and after an hour's worth fewer and fewer, so that their
    number grows with the logarithm of time. At an event it passes everything that it holds.

    Args:
        always: topics of which every message passes.
    """

    def __init__(self, always: Collection[str]) -> None:
        self._always = frozenset(always)
        self._held: deque[tuple[float, mcap_file.Raw]] = deque()
        self._open = False
        self._quiet_since: float | None = None
        self._all_until = 0.0
        self._last: dict[str, float] = {}

    def open(self) -> list[mcap_file.Raw]:
        """Begin a record; return the held messages."""
        self._open, self._quiet_since = True, None
        return self._all()

    def close(self) -> list[mcap_file.Raw]:
        """End the record; return the held messages."""
        self._open = False
        return self._all()

    def rest(self, now: float) -> None:
        """Begin a quiet stretch: no event has occurred for the held seconds. No effect during one."""
        if self._quiet_since is None:
            self._quiet_since, self._all_until = now, now + BEFORE
            self._last = {}

    def wake(self) -> None:
        """End the quiet stretch."""
        self._quiet_since = None

    def stir(self, now: float) -> None:
        """Report an event: everything held and what follows is kept."""
        self._all_until = now + BEFORE

    def offer(self, now: float, message: mcap_file.Raw) -> list[mcap_file.Raw]:
        """Take a message received at `now`; return the messages to write."""
        self._held.append((now, message))
        if self._open and (self._quiet_since is None or now < self._all_until):
            return self._all()
        written = []
        while self._held[0][0] <= now - BEFORE:
            time, old = self._held.popleft()
            if self._open and self._is_due(time, old.topic):
                written.append(old)
        return written

    def _all(self) -> list[mcap_file.Raw]:
        messages = [message for _, message in self._held]
        self._held.clear()
        return messages

    def _is_due(self, time: float, topic: str) -> bool:
        since = time if self._quiet_since is None else self._quiet_since
        period = max(PERIOD, (time - since) / _STRETCH)
        if topic not in self._always and time - self._last.get(topic, -math.inf) < period:
            return False
        self._last[topic] = time
        return True


class DockingRecorder:
    """Takes every message of the recorded topics and writes each docking to a separate file.

    Args:
        folder: of the records; one record takes at most half of its bytes.
        topics: by their full names.
        about: metadata of every record: version, scene, namespace.

    Attributes:
        path: the file being written, or None.
        problem: why the current docking is not recorded, or no longer; '' = it is.
    """

    def __init__(self, folder: RecordFolder, topics: Mapping[str, Topic], about: Mapping[str, str]) -> None:
        names = {topic.name: full for full, topic in topics.items()}
        self.path: Path | None = None
        self.problem = ""
        self._folder = folder
        self._gate = Gate([names[name] for name in ALWAYS])
        self._state, self._decision = names[STATE], names[DECISION]
        self._topics = topics
        self._about = about
        self._mcap: McapWriter | None = None
        self._last: Any = None  # newest docking_state
        self._kinds: set[str] = set()  # of decisions in the present state
        self._under_way = self._went_out = self._arrived = False
        self._home_since = self._lost_since = math.inf
        self._code = 0  # last error code of docking_state in this record
        self._flushed = self._pruned = 0.0

    def take_message(self, now: float, message: mcap_file.Raw) -> None:
        """Take one message; an unreadable one, as a foreign node may send it, is left out."""
        body: Any = None
        if message.topic in (self._state, self._decision):
            try:
                body = deserialize_message(message.data, self._topics[message.topic].kind)
            except RuntimeError:  # raised by the middleware
                return
        if message.topic == self._state:
            self._take_state(now, message, body)
        elif body is not None and body.kind not in self._kinds:  # routine decisions are no events
            self._kinds.add(body.kind)
            self._gate.stir(now)
        self._write(self._gate.offer(now, message))

    def take_result(self, outcome: Outcome) -> None:
        """Take the outcome of a goal of this docking."""
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
        self._lost_since = math.inf if alive else min(self._lost_since, now)
        if now - self._home_since >= TAIL or now - self._lost_since >= LOST_AFTER:
            self.close()
        if self._mcap is None:
            return
        with self._failing():
            if now - self._flushed >= _FLUSH:
                self._flushed = now
                self._mcap.stream.flush()
            if now - self._pruned >= _PRUNE:
                self._pruned = now
                self._folder.prune()
            if self._mcap.stream.tell() > self._folder.max_bytes // 2:
                raise mcap_file.RecordingError("this record has half of max_megabytes")

    def close(self) -> None:
        """End the current record, if there is one."""
        if not self._under_way:
            return
        self._write(self._gate.close())
        if self._mcap is not None and self.path is not None:
            ending = self._ending()
            self._note(
                END, {"ending": ending, "state": str(self._last.state), "message": texts.cut(self._last.error_message)}
            )
            with self._failing():
                self._mcap.close()
                if self._code or self._went_out:
                    self._folder.finish(self.path, ending)
                else:  # an undock without a docking
                    self.path.unlink()
                self._folder.prune()
        self._mcap = self.path = None
        self._under_way = False
        self._home_since = math.inf

    def _take_state(self, now: float, message: mcap_file.Raw, body: Any) -> None:
        at_home = body.state == State.IDLE and not body.docked
        if not at_home and (not self._under_way or self._home_since < math.inf):  # the next docking waits for no tail
            self.close()
            self._begin(now, message, body.request_id[: texts.REQUEST_ID_MAX])
        if self._last is None or (body.state, body.docked) != (self._last.state, self._last.docked):
            self._kinds = set()
        self._last = body
        self._went_out |= body.docked or body.state not in (State.IDLE, State.RETRACT)
        self._arrived |= body.docked
        self._home_since = min(self._home_since, now) if at_home and self._under_way else math.inf
        self._code = body.error_code or self._code
        self._gate.stir(now)
        if body.docked and body.state in (State.CHARGING, State.IDLE):  # may last for hours
            self._gate.rest(now)
        else:
            self._gate.wake()

    def _begin(self, now: float, message: mcap_file.Raw, request_id: str) -> None:
        self._under_way, self._went_out, self._arrived = True, False, False
        self._lost_since = math.inf
        self._code, self.problem = 0, ""
        self._flushed = self._pruned = now
        held = self._gate.open()
        with self._failing():
            self.path, stream = self._folder.create(message.received, request_id)
            about = {**self._about, "request_id": request_id, "began": str(message.received)}
            try:
                self._mcap = McapWriter(stream, self._topics, [(ABOUT, about)])
                flush(stream)  # from now on the head shows that the file is ours, even after a crash
            except (OSError, mcap_file.RecordingError):
                stream.close()
                self.path.unlink()
                raise
        self._write(held)

    def _ending(self) -> str:
        """Return the ending in the record's name: a code's name, OK, or UNFINISHED without an outcome."""
        if self._code:
            return Code(self._code).name if self._code in list(Code) else str(self._code)
        return "OK" if self._arrived else "UNFINISHED"

    def _write(self, messages: Iterable[mcap_file.Raw]) -> None:
        with self._failing():
            for message in messages:
                if self._mcap is not None:
                    self._mcap.add(message)

    def _note(self, name: str, values: Mapping[str, str]) -> None:
        with self._failing():
            if self._mcap is not None:
                self._mcap.add_metadata(name, values)

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        """End the recording of this docking if the disk does not accept it, or a library is missing."""
        try:
            yield
        except (OSError, mcap_file.RecordingError) as error:
            self.fail(error)

    def fail(self, error: Exception) -> None:
        """Stop recording this docking; data on the disk stay, and the next docking is recorded again."""
        self.problem = f"{'nothing is recorded' if self._mcap is None else 'recording ended'}: {error}"
        mcap, self._mcap, self.path = self._mcap, None, None
        if mcap is not None:
            with contextlib.suppress(OSError):
                mcap.stream.close()
