# SPDX-License-Identifier: Apache-2.0
"""One recorded docking as plain data: phases, decisions, measurements, curves and outcome."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deltacharger_core.bounded_file import parse_json
from deltacharger_core.mcap_file import RecordingError
from deltacharger_docking.parameters import DockingParameters
from deltacharger_records.node_parameters import known_settings, recorded_settings
from deltacharger_records.recording.folder import END, RESULT
from deltacharger_records.recording.own import ABOUT
from deltacharger_records.replay.file import Recording
from deltacharger_records.replay.run_builder import RunBuilder
from deltacharger_records.replay.run_record import Run
from deltacharger_ros.messages import CODES, PHASES
from deltacharger_ros.outcomes import Outcome

_LONGEST = 200  # characters of a reason


@dataclass(frozen=True)
class Phase:
    """A state, in lower case, with its start and end (s since the goal)."""

    state: str
    start: float
    end: float


@dataclass
class Replay:
    """Content of a recording; times are s since the docking began.

    Attributes:
        recording: the file, its metadata and its damage.
        parameters: of docking_node; the defaults if not recorded.
        run: curves, measurements, decisions.
        phases: in order.
        code: docking_state's last error; 0 = none.
        message: of that error.
        charged: s of charging; NaN = never.
        failed_at: time of that error (s); NaN = never.
        request_id: of the goal.
        began: ns since 1970.
        end: of the recording (s).
    """

    recording: Recording
    parameters: DockingParameters
    run: Run
    phases: list[Phase] = field(default_factory=list)
    code: int = 0
    message: str = ""
    charged: float = math.nan
    failed_at: float = math.nan
    request_id: str = ""
    began: int = 0
    end: float = 0.0

    def result_of(self, action: str) -> Outcome | None:
        """Return the first outcome of "dock" or "undock" as sent to its client; None if not recorded."""
        for values in self.recording.file.metadata_named(RESULT):
            if values.get("action") == action:
                return _outcome(parse_json(values["json"]))
        return None

    @property
    def about(self) -> dict[str, str]:
        """Metadata: version, scene, namespace, request_id, began (ns since 1970)."""
        return (self.recording.file.metadata_named(ABOUT) or [{}])[0]

    @property
    def last_phase(self) -> str:
        """Phase in which the recording ends."""
        return self.phases[-1].state if self.phases else ""

    @property
    def is_complete(self) -> bool:
        """Whether the file reaches the end of the docking."""
        return not self.recording.damage and (
            bool(self.recording.file.metadata_named(END)) or self.last_phase == "idle"
        )

    def outcome(self) -> dict[str, Any]:
        """Return success (None = unknown), code, name and message of the docking."""
        result = self.result_of("dock") or self.result_of("undock")
        if result is not None:
            return _named(result.success, result.error_code, result.error_message)
        if self.code:
            return _named(not math.isnan(self.charged), self.code, self.message)
        if not math.isnan(self.charged):
            return _named(True, 0, "")
        return {"success": None, "code": None, "name": "UNKNOWN", "message": "no outcome was recorded"}

    def afterwards(self) -> dict[str, Any] | None:
        """Return the error that ended charging after a successful docking, or None."""
        if not self.code or not self.outcome()["success"]:
            return None
        return _named(False, self.code, self.message)

    def as_dict(self) -> dict[str, Any]:
        """Return everything except the story as one JSON object."""
        touches = self.run.touches
        return {
            "file": str(self.recording.path),
            "request_id": self.request_id,
            "outcome": self.outcome(),
            "afterwards": self.afterwards(),
            "duration": self.end,
            "complete": self.is_complete,
            "about": self.about,
            "phases": [vars(phase) for phase in self.phases],
            "decisions": [vars(each) for each in self.run.decisions],
            "measurements": [{k: v for k, v in vars(touch).items() if k != "frames"} for touch in touches],
            "dropped": {
                "damage": self.recording.damage,
                "missing": self.recording.missing(),
                "thinned": parse_json((self.recording.file.metadata_named(END) or [{}])[-1].get("dropped", "{}")),
            },
        }


def replay(path: Path, namespace: str | None = None) -> Replay:
    """Read a recording.

    Raises:
        RecordingError: it is not a recording of a docking.
        OSError: it cannot be read.
    """
    recording = Recording(path, namespace)
    settings = recorded_settings(recording.file) or known_settings({})
    reader = _Reader(RunBuilder(Run(), settings))
    try:
        recording.read(reader.take)
        found = Replay(recording, settings[0], reader.build.run)
        reader.complete(found)
        if any(phase.end < phase.start for phase in found.phases):
            raise RecordingError(f"{path} goes back in time, which no recorder does: record again")
        found.as_dict()  # checks the other values while the file can still be refused
    except (RecordingError, OSError):
        raise
    except Exception as error:  # foreign messages and metadata may hold anything
        problem = f"{type(error).__name__}: {error}"[:_LONGEST]
        raise RecordingError(f"{path} holds invalid values ({problem}): record again") from error
    return found


class _Reader:
    """Builds a run from messages; its clock starts at the first state that is not idle."""

    def __init__(self, build: RunBuilder) -> None:
        self.build = build
        self._first = self._last = 0
        self._states: list[tuple[int, Any]] = []
        self._takers: dict[str, Callable[[float, Any], None]] = {
            "servo_state": self.build.servo_state,
            "docking_state": self.build.docking_state,
            "docking_decision": self.build.decision,
            "tactile_frame": self.build.tactile_frame,
            "misalignment": self.build.misalignment,
            "charger_power": self.build.power,
            "dock/_action/feedback": lambda time, message: self.build.dock_feedback(time, message.feedback),
        }

    def take(self, name: str, time: int, message: Any) -> None:
        self._first = self._first or time
        self._last = max(self._last, time)
        if name == "docking_state":
            self._states.append((time, message))
        taker = self._takers.get(name)
        if taker is not None:
            taker((time - self._first) * 1e-9, message)

    def complete(self, found: Replay) -> None:
        """Shift all times so that the docking begins at 0, and derive values from the states."""
        began = int(found.about.get("began", 0))  # else the previous docking's end could look like the beginning
        active = [time for time, state in self._states if time >= began and (state.state or state.docked)]
        found.began = active[0] if active else self._states[0][0]
        found.run.shift((found.began - self._first) * 1e-9)
        _forget_earlier(found.run)
        while len(self._states) > 1 and self._states[1][0] < found.began:  # of the previous docking
            del self._states[0]
        found.end = (self._last - found.began) * 1e-9
        for (start, state), (end, _) in itertools.pairwise([*self._states, (self._last, None)]):
            name = PHASES.get(state.state, f"state {state.state}")
            begin, until = (start - found.began) * 1e-9, (end - found.began) * 1e-9
            if state.charging:
                found.charged = until - begin + (0.0 if math.isnan(found.charged) else found.charged)
            if found.phases and found.phases[-1].state == name:
                begin = found.phases.pop().start
            found.phases.append(Phase(name, begin, until))
            if state.error_code and start >= found.began:
                if not found.code:
                    found.failed_at = (start - found.began) * 1e-9
                found.code, found.message = state.error_code, state.error_message
            if start >= found.began:
                found.request_id = found.request_id or state.request_id


def _forget_earlier(run: Run) -> None:
    """Remove decisions and measurements of the previous docking, whose end is in the seconds before the goal."""
    accepted = [each.time for each in run.decisions if each.kind == "accepted" and each.time <= 0.0]
    begin = max(accepted, default=0.0)
    run.decisions = [each for each in run.decisions if each.time >= begin]
    run.touches = [touch for touch in run.touches if touch.time >= begin]


def _outcome(plain: dict[str, Any]) -> Outcome:
    names = [name for name in Outcome.__dataclass_fields__ if name != "details"]
    details = {name: value for name, value in plain.items() if name not in names}
    return Outcome(**{name: plain[name] for name in names}, details=details)


def _named(success: bool, code: int, message: str) -> dict[str, Any]:
    return {"success": success, "code": code, "name": CODES.get(code, f"CODE_{code}"), "message": message}
