# SPDX-License-Identifier: Apache-2.0
"""A docking as a `Run`: from a record (complete, truncated by a kill, or without some topics), or from live topics."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.context import Context

from deltacharger_bringup.records.node_parameters import ParameterReader, known_settings, recorded_settings
from deltacharger_bringup.records.recording import folder, mcap_recording, recorded
from deltacharger_bringup.records.replay.run import Run, RunBuilder
from deltacharger_core import files, mcap_file
from deltacharger_core.ros import client, clock, outcomes

_LONGEST = 200  # characters of a reason
_ASK = 0.1  # s between attempts to read docking_node's parameters
_PATIENCE = 3.0  # s to wait for them
_AT_REST = 1.0  # s for docking_state to follow the result


@dataclass(kw_only=True)
class Replay(Run):
    """A docking from a recording; `began` counts from the file's first message.

    Attributes:
        recording: the file, its metadata and its damage.
    """

    recording: recorded.Recording = field(repr=False)

    @property
    def about(self) -> dict[str, str]:
        """Metadata: version, scene, namespace, request_id, began (ns since 1970)."""
        return (self.recording.file.metadata_named(folder.ABOUT) or [{}])[0]

    @property
    def began_ns(self) -> int:
        """Time of the docking's beginning, ns since 1970."""
        return self.recording.file.first + round(self.began * 1e9)

    @property
    def is_complete(self) -> bool:
        """Whether the file reaches the end of the docking."""
        return not self.damage and (bool(self.recording.file.metadata_named(folder.END)) or self.last_phase == "idle")

    def as_dict(self) -> dict[str, Any]:
        """Return everything except the story as one JSON object."""
        counts = self.recording.counts
        return {
            "file": str(self.recording.path),
            "request_id": self.request_id,
            "outcome": self.outcome(),
            "afterwards": self.afterwards(),
            "duration": self.end,
            "complete": self.is_complete,
            "about": self.about,
            "phases": [vars(phase) for phase in self.phases],
            "decisions": [vars(each) for each in self.decisions],
            "measurements": [touch.as_dict() for touch in self.touches],
            "dropped": {
                "damage": self.damage,
                "missing": {
                    topic.name: "not in the recording" for topic in mcap_recording.TOPICS if not counts.get(topic.name)
                },
            },
        }


def replay(path: Path, namespace: str = "") -> Replay:
    """Read a recording.

    Args:
        path: of the file, or of a folder with one.
        namespace: of the charger; '' = the only one in the file.

    Raises:
        RecordingError: it is not a recording of a docking.
        OSError: it cannot be read.
    """
    recording = recorded.Recording(path, namespace)
    settings = recorded_settings(recording.file) or known_settings({})
    try:
        found, first = Replay(recording=recording), recording.file.first
        build = RunBuilder(found)
        build.use(*settings)
        recording.read(lambda topic, time, message: build.take_message(topic, (time - first) * 1e-9, message))
        found.damage = recording.damage
        found.results = [
            _outcome(files.parse_json(each["json"])) for each in recording.file.metadata_named(folder.RESULT)
        ]
        build.complete((int(found.about.get("began", first)) - first) * 1e-9)
        if any(phase.end < phase.start for phase in found.phases):
            raise mcap_file.RecordingError(f"{path} goes back in time, which no recorder does: record again")
        found.as_dict()  # checks the other values while the file can still be refused
    except (mcap_file.RecordingError, OSError):
        raise
    except Exception as error:  # foreign messages and metadata may hold anything
        problem = f"{type(error).__name__}: {error}"[:_LONGEST]
        raise mcap_file.RecordingError(f"{path} holds invalid values ({problem}): record again") from error
    return found


def _outcome(plain: dict[str, Any]) -> outcomes.Outcome:
    names = [name for name in outcomes.Outcome.__dataclass_fields__ if name != "details"]
    details = {name: value for name, value in plain.items() if name not in names}
    return outcomes.Outcome(**{name: plain[name] for name in names}, details=details)


class Recorder(client.Guest):
    """Fill a `Run` from a running charger's topics.

    Positions and forces use docking_node's own geometry and gravity, read at the beginning.

    Args:
        context: a running rclpy context.
        namespace: of the charger.

    Attributes:
        run: recorded so far; time 0 is the recorder's start until `finish`.
    """

    def __init__(self, context: Context, namespace: str = "") -> None:
        super().__init__("charger_recorder", context, namespace)
        self.run = Run()
        self._build = RunBuilder(self.run)
        self._lock = threading.Lock()
        self._began = time.monotonic()
        self._asked = self._done = False
        for topic in mcap_recording.TOPICS:
            if topic.name in self._build.takers:
                self.node.create_subscription(topic.kind, topic.name, self._taker(topic.name), topic.qos)
        self._parameters = ParameterReader(self.node, "docking_node")
        self._asking = clock.steady_timer(self.node, _ASK, self._ask)
        self.serve()

    def force(self) -> float:
        """Return the newest contact force along z on the target (N); NaN = not measured."""
        with self._lock:
            return self.run.motion.last("force")

    def finish(self, outcome: outcomes.Outcome) -> None:
        """Store the outcome and stop recording, once docking_state tells that the docking is over."""
        self.wait(lambda: outcome.success or self._build.is_at_rest, _AT_REST)
        with self._lock:
            self._done = True
            self.run.results.append(outcome)
            self._build.complete()

    def _ask(self) -> None:
        """Read docking_node's parameters once available; without an answer, use the defaults."""
        if self._now() > _PATIENCE:
            self._asking.cancel()
            self._on_parameters({})
        elif self._parameters.is_ready():
            self._parameters.ask(self._on_parameters)

    def _on_parameters(self, values: dict[str, Any]) -> None:
        self._asking.cancel()
        try:
            settings = known_settings(values)
        except ValueError:  # of another version
            settings = known_settings({})
        with self._lock:
            if not self._asked:
                self._build.use(*settings)
            self._asked = True

    def _now(self) -> float:
        return time.monotonic() - self._began

    def _taker(self, topic: str) -> Callable[[Any], None]:
        """Return a callback that records the messages of a topic until the end."""

        def on_message(message: Any) -> None:
            now = self._now()
            with self._lock:
                if not self._done:
                    self._build.take_message(topic, now, message)

        return on_message
