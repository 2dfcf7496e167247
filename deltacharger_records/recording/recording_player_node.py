# SPDX-License-Identifier: Apache-2.0
"""recording_player_node: play a recorded docking on its original topics.

Publishes each recorded topic (mcap_recording.TOPICS) under its relative name, and /diagnostics (1 Hz, and at the end).
Stamps are shifted so that every message is as old as when it was received.
Parameters: file, charger, delay, rate, loop.

A recording includes commands to the arm, so it is never played beside a charger. The node searches for one before it
begins; if another node publishes the same topics, it stops and reports that. At the end it stays, without publishing,
and keeps the last docking_state available.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node

from deltacharger_core import environment
from deltacharger_core.files import given_path
from deltacharger_core.mcap_file import CUT_SHORT, RecordingError
from deltacharger_records.parameters import RecordingPlayerNodeParameters
from deltacharger_records.recording.mcap_recording import STATE, TOPICS, Recording, decode
from deltacharger_ros import node_support
from deltacharger_ros.clock import steady_timer
from deltacharger_ros.diagnostics import ERROR, OK, WARN, Diagnostics
from deltacharger_ros.parameters import declare_all, reject_unknown

_COMMANDS = "joint_trajectory"
_OF_A_CHARGER = ("servo_state", "tactile_frame", "charger_power", STATE)
_LOOK = 0.2  # s between searches for a charger while it plays
_LEAST_GAP = 0.01  # s between two passes
_DIAGNOSTICS = 1.0  # s


class RecordingPlayerNode(Node):
    """Plays a recording; see the module's docstring for its interface.

    Attributes:
        passes: completed plays.
        problem: why it stopped before the end; '' = it did not.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recording_player_node", **kwargs)
        self._given = declare_all(self, RecordingPlayerNodeParameters)
        reject_unknown(self)
        environment.prepare()
        self._recording, self._first, self._last = _survey(self._given.file, self._given.charger)
        self.passes, self.problem = 0, ""
        self._count = 0  # messages played
        self._place = 0  # ns since 1970 of the last message played
        self._others_seen = 0.0
        self._played = {
            topic.name: self.create_publisher(topic.kind, topic.name, topic.qos)
            for topic in TOPICS
            if topic.name in self._recording.counts
        }
        self._diagnostics = Diagnostics(self)
        self._log_content()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recording player", daemon=True)
        steady_timer(self, _DIAGNOSTICS, self._diagnose)
        self._thread.start()

    def close(self) -> None:
        """Stop playing. Safe to call twice."""
        self._stopping.set()
        self._thread.join(5.0)

    def _log_content(self) -> None:
        recording = self._recording
        whose = f" of {recording.namespace}" if recording.namespace != "/" else ""
        self.get_logger().info(f"playing {recording.path}{whose}: {self._length():.1f} s of {', '.join(self._played)}")
        if recording.damage:
            self.get_logger().warning(f"{recording.path}: {recording.damage}; it is played up to there")

    def _length(self) -> float:
        return 1e-9 * (self._last - self._first)

    def _run(self) -> None:
        try:
            while (self.passes or self._wait(time.monotonic() + self._given.delay, True)) and self._play():
                self.passes += 1
                if not self._given.loop:
                    break
                self._stopping.wait(_LEAST_GAP)
        except (OSError, RecordingError) as error:  # the file was changed
            self.problem = str(error)
        if self._stopping.is_set():
            return
        if self.problem:
            self.get_logger().error(self.problem)
        else:
            self.get_logger().info(f"played {self._recording.path} to the end")
        self._diagnose()

    def _play(self) -> bool:
        """Publish the recording once; return whether it reached the end."""
        started = time.monotonic()
        for topic, received, data in self._recording.messages():
            due = started + 1e-9 * (received - self._first) / self._given.rate
            if not self._wait(due, topic.name == _COMMANDS):
                return False
            message = decode(data, topic.kind)
            late = round(1e9 * (time.monotonic() - due))
            shift = self.get_clock().now().nanoseconds - late - received
            for stamp in _stamps(message):
                moved = max(0, stamp.sec * 10**9 + stamp.nanosec + shift)
                stamp.sec, stamp.nanosec = divmod(moved, 10**9)
            if self.context.ok():
                self._played[topic.name].publish(message)
            self._place = received
            self._count += 1
        return True

    def _wait(self, due: float, is_command: bool) -> bool:
        """Wait until `due`; return whether to go on. Before each command, it searches for a charger that would obey."""
        while not self._stopping.is_set():
            now = time.monotonic()
            if now - self._others_seen >= _LOOK or (is_command and now >= due):
                self._others_seen = now
                self.problem = self._charger_here()
            if self.problem:
                return False
            if now >= due:
                return True
            self._stopping.wait(min(due - now, _LOOK))
        return False

    def _charger_here(self) -> str:
        """Return a message if a charger publishes the same topics, or ''."""
        for name in _OF_A_CHARGER:
            if self.count_publishers(name) > (name in self._played):
                return (
                    f"a charger runs here: another node publishes {self.resolve_topic_name(name)}. The recording is "
                    "stopped; play it in another ROS_DOMAIN_ID or namespace"
                )
        return ""

    def _diagnose(self) -> None:
        recording, length = self._recording, self._length()
        place = max(0.0, 1e-9 * (self._place - self._first))
        level, text = OK, f"at {place:.1f} of {length:.1f} s" if self._count else "about to begin"
        if self.problem:
            level, text = ERROR, self.problem
        elif self.passes and not self._given.loop:
            text = f"the recording is over; {length:.1f} s were played"
        if recording.damage and not self.problem:
            level, text = WARN, f"{text}; {recording.damage}"
        values = {"file": recording.path, "passes": self.passes, "rate": self._given.rate, "messages": self._count}
        self._diagnostics.report(level, text, values, "playback", str(recording.path))


def _survey(file: str, charger: str) -> tuple[Recording, int, int]:
    """Read the complete file; return its recording, and the times (ns) of its first and last message.

    Raises:
        StartupError: nothing can be played; the message states what to do.
    """
    who = "recording_player_node: parameter 'file'"
    if not file:
        raise node_support.StartupError(
            f"{who} is empty: name a record, `deltacharger up --scene replay --recording FILE`"
        )
    path = given_path(file)
    try:
        recording = Recording(path, charger)
        times = [received for _, received, _ in recording.messages()]
    except FileNotFoundError as error:
        raise node_support.StartupError(f"{who}: {path}: there is no such file") from error
    except (OSError, RecordingError) as error:
        text = str(error).replace("name one with --namespace", "name one by the parameter 'charger'")
        raise node_support.StartupError(f"{who}: {text}") from error
    if recording.damage not in ("", CUT_SHORT):
        raise node_support.StartupError(
            f"{who}: {path}: {recording.damage}; `deltacharger replay {path}` shows what can still be read"
        )
    return recording, times[0], times[-1]


def _stamps(value: Any) -> Iterator[Time]:
    """Yield the stamps in a message, except unset ones."""
    if isinstance(value, Time):
        if value.sec or value.nanosec:
            yield value
    elif isinstance(value, list):
        if value and hasattr(value[0], "get_fields_and_field_types"):
            for each in value:
                yield from _stamps(each)
    elif hasattr(value, "get_fields_and_field_types"):
        for name in value.get_fields_and_field_types():
            yield from _stamps(getattr(value, name))


def main(args: Sequence[str] | None = None) -> int:
    """Run recording_player_node until SIGINT or SIGTERM; 0 after a signal, 2 if it cannot start as configured."""
    return node_support.run(RecordingPlayerNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
