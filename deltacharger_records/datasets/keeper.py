# SPDX-License-Identifier: Apache-2.0
"""Make dockings in a journal from the topics of a running charger while its arm moves."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from deltacharger.msg import TactileFrame
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from deltacharger_core.mcap_file import Raw, RecordingError
from deltacharger_docking.codes import TactileStale
from deltacharger_records.datasets.dataset import Docking, Settings
from deltacharger_records.datasets.journal import Journal
from deltacharger_records.datasets.plan import Part
from deltacharger_records.datasets.session import NotKept, Rested
from deltacharger_records.recording import docking_topics
from deltacharger_records.recording.docking_topics import STATE

_RECORDED = ("tactile_frame", "servo_state", "charger_power", STATE)
TOPICS = tuple(topic for topic in docking_topics.TOPICS if topic.name in _RECORDED)
"""Topics recorded of each docking, as received."""
_SIDE = 10  # taxels


class Tape:
    """Collects the messages of one docking at a time. `take` may be called from any thread.

    Args:
        latched: topic that publishes changes only; its last message before a docking belongs to it.
    """

    def __init__(self, latched: str) -> None:
        self.messages: list[Raw] = []
        self._latched = latched
        self._last: Raw | None = None
        self._rolling = False
        self._lock = threading.Lock()

    def take(self, message: Raw) -> None:
        """Append a message during a docking."""
        with self._lock:
            if message.topic == self._latched:
                self._last = message
            if self._rolling:
                self.messages.append(message)

    def start(self) -> None:
        """Begin a docking."""
        with self._lock:
            self.messages = [] if self._last is None else [self._last]
            self._rolling = True

    def stop(self) -> list[Raw]:
        """Return the messages since `start`."""
        with self._lock:
            self._rolling = False
            return self.messages


class SessionKeeper:
    """A `Keeper` that writes the dockings of one session into a journal.

    Args:
        journal: to write into.
        part: of the recording.
        settings: as passed to the journal's `check`.
        numbers: of the part's poses, in the session's order.
        tape: that receives the topics.
        names: full name of each topic by its relative one.
        now: the ROS clock, ns.
        report: called with each docking after it is on the disk.

    Attributes:
        count: dockings on the disk.
    """

    def __init__(
        self,
        journal: Journal,
        part: Part,
        settings: Settings,
        numbers: Sequence[int],
        tape: Tape,
        names: dict[str, str],
        now: Callable[[], int],
        report: Callable[[Docking], None],
    ) -> None:
        self.count = 0
        self._journal, self._part, self._settings = journal, part, settings
        self._numbers, self._poses = numbers, part.poses()
        self._tape, self._now, self._report = tape, now, report
        self._tactile = names["tactile_frame"]
        self._topics = {names[topic.name]: topic for topic in TOPICS}
        self._session = journal.next_session
        self._number = 0
        self._since = 0
        self._looked = 0
        self._frames: list[NDArray[np.float32]] = []
        self._writer = ThreadPoolExecutor(1, "writer")
        self._writing: Future[Docking] | None = None

    def begin(self, number: int) -> None:
        """Start the tape."""
        self._number = self._numbers[number]
        self._tape.start()

    def start_frames(self) -> None:
        """Count only frames sampled from now on."""
        self._since, self._looked, self._frames = self._now(), len(self._tape.messages), []

    def has_frames(self) -> bool:
        """Take the new frames; TactileStale if they are unusable."""
        messages, wanted = self._tape.messages, self._settings.frames * self._settings.rows
        while self._looked < len(messages) and len(self._frames) < wanted:
            message = messages[self._looked]
            self._looked += 1
            if message.topic == self._tactile:
                frame = deserialize_message(message.data, TactileFrame)
                stamp = frame.header.stamp
                if stamp.sec * 1_000_000_000 + stamp.nanosec > self._since:
                    self._frames.append(_pads(frame))
        return len(self._frames) >= wanted

    def keep(self, touch: Rested) -> None:
        """Write the docking in a separate thread."""
        pose, target = self._poses[self._number], self._part.target
        shape = (self._settings.rows, self._settings.frames, 2, _SIDE, _SIDE)
        docking = Docking(
            attempt=self._journal.next_attempt,
            session=self._session,
            part=self._part.name,
            number=self._number,
            horizontal=pose.horizontal,
            vertical=pose.vertical,
            angle=pose.angle,
            x=target[0] - touch.position[0],
            y=target[1] - touch.position[1],
            current=touch.current,
            time=time.time(),
            frames=np.stack(self._frames).reshape(shape).mean(axis=1),
        )
        self._writing = self._writer.submit(self._write, docking, self._tape.stop())

    def kept(self) -> bool:
        """Whether it is on the disk; NotKept if it cannot be written."""
        if self._writing is None:
            return True
        if not self._writing.done():
            return False
        writing, self._writing = self._writing, None
        try:
            docking = writing.result()
        except (OSError, RecordingError) as error:
            raise NotKept(f"the docking cannot be written: {error}") from error
        self.count += 1
        self._report(docking)
        return True

    def close(self) -> None:
        """Wait for the writing thread; NotKept as in `kept`."""
        self._writer.shutdown()
        self.kept()

    def _write(self, docking: Docking, messages: Sequence[Raw]) -> Docking:
        self._journal.store(docking, self._part, self._settings, self._topics, messages)
        return docking


def _pads(frame: TactileFrame) -> NDArray[np.float32]:
    """Return both pads (2, 10, 10), N.

    Raises:
        TactileStale: they have another shape, or are no longer tared.
    """
    pads = (frame.left, frame.right)
    if (frame.rows, frame.columns) != (_SIDE, _SIDE) or {len(pad) for pad in pads} != {_SIDE * _SIDE}:
        raise TactileStale(f"tactile_frame is {frame.rows} × {frame.columns}; data sets hold {_SIDE} × {_SIDE}")
    if not frame.tared:
        raise TactileStale("the frames are no longer tared because the board has restarted: check its supply")
    return np.array(pads, dtype=np.float32).reshape(2, _SIDE, _SIDE)
