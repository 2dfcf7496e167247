# SPDX-License-Identifier: Apache-2.0
"""A recorded docking: complete, truncated by a kill, or without some topics."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deltacharger_core.files import parse_json
from deltacharger_core.mcap_file import RecordingError
from deltacharger_records.node_parameters import known_settings, recorded_settings
from deltacharger_records.recording.folder import ABOUT, END, RESULT
from deltacharger_records.recording.mcap_recording import TOPICS, Recording
from deltacharger_records.replay.run import Run, RunBuilder
from deltacharger_ros.outcomes import Outcome

_LONGEST = 200  # characters of a reason


@dataclass(kw_only=True)
class Replay(Run):
    """A docking from a recording; `began` counts from the file's first message.

    Attributes:
        recording: the file, its metadata and its damage.
    """

    recording: Recording = field(repr=False)

    @property
    def about(self) -> dict[str, str]:
        """Metadata: version, scene, namespace, request_id, began (ns since 1970)."""
        return (self.recording.file.metadata_named(ABOUT) or [{}])[0]

    @property
    def began_ns(self) -> int:
        """Time of the docking's beginning, ns since 1970."""
        return self.recording.file.first + round(self.began * 1e9)

    @property
    def is_complete(self) -> bool:
        """Whether the file reaches the end of the docking."""
        return not self.damage and (bool(self.recording.file.metadata_named(END)) or self.last_phase == "idle")

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
                "missing": {topic.name: "not in the recording" for topic in TOPICS if not counts.get(topic.name)},
                "thinned": parse_json((self.recording.file.metadata_named(END) or [{}])[-1].get("dropped", "{}")),
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
    recording = Recording(path, namespace)
    settings = recorded_settings(recording.file) or known_settings({})
    try:
        found, first = Replay(recording=recording), recording.file.first
        build = RunBuilder(found)
        build.use(*settings)
        recording.read(lambda topic, time, message: build.take(topic, (time - first) * 1e-9, message))
        found.damage = recording.damage
        found.results = [_outcome(parse_json(each["json"])) for each in recording.file.metadata_named(RESULT)]
        build.complete((int(found.about.get("began", first)) - first) * 1e-9)
        if any(phase.end < phase.start for phase in found.phases):
            raise RecordingError(f"{path} goes back in time, which no recorder does: record again")
        found.as_dict()  # checks the other values while the file can still be refused
    except (RecordingError, OSError):
        raise
    except Exception as error:  # foreign messages and metadata may hold anything
        problem = f"{type(error).__name__}: {error}"[:_LONGEST]
        raise RecordingError(f"{path} holds invalid values ({problem}): record again") from error
    return found


def _outcome(plain: dict[str, Any]) -> Outcome:
    names = [name for name in Outcome.__dataclass_fields__ if name != "details"]
    details = {name: value for name, value in plain.items() if name not in names}
    return Outcome(**{name: plain[name] for name in names}, details=details)
