# SPDX-License-Identifier: Apache-2.0
"""One docking as plain data, built from a charger's messages, live or recorded."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from deltacharger.msg import ChargerPower, DockingDecision, DockingState, ServoState, TactileFrame
from numpy.typing import NDArray

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_core.ros import messages, outcomes
from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta

_CAPACITY = 24_000  # samples of a series; then every second one is dropped
_MEASURED = {"horizontal": "m", "vertical": "m", "angle": "rad", "across": "m"}
"""Values of a measurement, each with a standard deviation, and the unit that ends their names in its decision."""
_FIRST_TOUCH = "the first touch gives an estimate"
"""Text of the decision with a measurement before the arm rests, which comes before its contact."""


@dataclass(frozen=True)
class Phase:
    """A state, in lower case, with its start and end (s)."""

    state: str
    start: float
    end: float


class Series:
    """Samples over time, bounded in number: when full, every second one is dropped and the sampling rate halves.

    Args:
        columns: names of the values of one sample.
    """

    def __init__(self, *columns: str) -> None:
        self.columns = columns
        self._rows: list[tuple[float, ...]] = []
        self._stride = 1
        self._offered = 0

    def add(self, time: float, *values: float) -> None:
        """Take one sample at `time` (s); `values` in the order of the columns, NaN = not measured."""
        self._offered += 1
        if self._offered % self._stride:
            return
        self._rows.append((time, *values))
        if len(self._rows) >= _CAPACITY:
            del self._rows[::2]
            self._stride *= 2

    def last(self, column: str) -> float:
        """Return the newest value of a column; NaN if empty."""
        return self._rows[-1][1 + self.columns.index(column)] if self._rows else math.nan

    def shift(self, seconds: float) -> None:
        """Set time 0 later by `seconds`."""
        self._rows = [(time - seconds, *values) for time, *values in self._rows]

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """Return `time` and every column as arrays (n,)."""
        rows = list(self._rows)
        table = np.array(rows, dtype=np.float64).reshape(len(rows), 1 + len(self.columns))
        return {name: table[:, index] for index, name in enumerate(("time", *self.columns))}


@dataclass
class Touch:
    """One measurement by touch that docking used.

    Attributes:
        time: s.
        estimate: the target's pose in end_effector; `sure` only if it is in range, too.
        contact: number of its contact, from 1; 0 = not recorded.
        frames: forces of the pads, (left, right), each (rows, columns) N; None = not recorded.
        verdict: on clearance, as text; '' = not judged.
        clearance: m, of the estimate itself; NaN = not judged.
    """

    time: float
    estimate: MisalignmentEstimate
    contact: int = 0
    frames: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    verdict: str = ""
    clearance: float = math.nan

    def as_dict(self) -> dict[str, Any]:
        """Return everything except the frames as one JSON object."""
        names = [each for name in _MEASURED for each in (name, f"{name}_stddev")]
        pose = {name: getattr(self.estimate, name) for name in (*names, "sure")}
        judged = {"verdict": self.verdict, "clearance": self.clearance}
        return {"time": self.time, **pose, "contact": self.contact, **judged}


@dataclass(frozen=True)
class Decided:
    """One decision of docking: time (s), phase, kind, text and numbers (SI, by name)."""

    time: float
    phase: str
    kind: str
    text: str
    values: dict[str, float]


@dataclass
class Run:
    """One docking. Times are s since the docking began; until it is completed, since the zero of its builder's caller.

    Attributes:
        parameters: of docking_node.
        motion: measured z (m), contact force along z on the target (N), and that force as contact current (A).
        contact: contact current (A) as the charger reports it, without free-motion friction.
        power: charge current (A) and whether the contactor is closed (0 or 1).
        phases: in order.
        touches: the measurements that docking used.
        decisions: what docking decided.
        results: outcomes as sent to the clients.
        damage: why the data stop early; '' = they do not.
        code, message: docking_state's last error; 0 = none.
        failed_at: time of that error; NaN = never.
        charged: s of charging; NaN = never.
        request_id: of the goal.
        began: time of its beginning from the caller's zero.
        end: time of the last message.
    """

    parameters: DockingParameters = field(default_factory=DockingParameters)
    motion: Series = field(default_factory=lambda: Series("z", "force", "current"))
    contact: Series = field(default_factory=lambda: Series("current"))
    power: Series = field(default_factory=lambda: Series("current", "closed"))
    phases: list[Phase] = field(default_factory=list)
    touches: list[Touch] = field(default_factory=list)
    decisions: list[Decided] = field(default_factory=list)
    results: list[outcomes.Outcome] = field(default_factory=list)
    damage: str = ""
    code: int = 0
    message: str = ""
    failed_at: float = math.nan
    charged: float = math.nan
    request_id: str = ""
    began: float = 0.0
    end: float = 0.0

    @property
    def last_phase(self) -> str:
        """Phase at the end."""
        return self.phases[-1].state if self.phases else ""

    def result_of(self, action: str) -> outcomes.Outcome | None:
        """Return the first outcome of "dock" or "undock" as sent to its client; None if unknown."""
        return next((each for each in self.results if each.action == action), None)

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


class RunBuilder:
    """Fills a `Run` from messages, whose times (s) the caller counts from its own zero.

    Contact force is computed from servo_state (without the arm's weight), so kinematics_node is not needed.

    Args:
        run: to fill.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self._delta: ScalarDelta | None = None
        self._frames: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._contacts = 0
        self._last = 0.0
        self._states: list[tuple[float, DockingState]] = []
        self.takers: dict[str, Callable[[float, Any], None]] = {
            "docking_state": lambda time, message: self._states.append((time, message)),
            "docking_decision": self._decision,
            "servo_state": self._servo_state,
            "tactile_frame": self._tactile_frame,
            "charger_power": self._power,
            "dock/_action/feedback": self._feedback,
        }

    def use(self, parameters: DockingParameters, geometry: DeltaGeometry) -> None:
        """Set docking_node's settings; earlier servo_state is skipped."""
        self.run.parameters, self._delta = parameters, ScalarDelta(geometry)

    def take_message(self, topic: str, time: float, message: Any) -> None:
        """Take a message of a topic, given by its relative name; topics that a run does not hold are ignored."""
        self._last = max(self._last, time)
        if topic in self.takers:
            self.takers[topic](time, message)

    @property
    def is_at_rest(self) -> bool:
        """Whether the last state is idle, or none was taken."""
        return not self._states or not self._states[-1][1].state

    def complete(self, earliest: float = 0.0) -> None:
        """Shift all times so that the docking begins at 0, and derive values from the states.

        Args:
            earliest: time before which the end of the previous docking could look like the beginning.
        """
        run, states = self.run, self._states or [(self._last, DockingState())]
        active = [time for time, state in states if time >= earliest and (state.state or state.docked)]
        run.began = active[0] if active else states[0][0]
        self._shift(run.began)
        while len(states) > 1 and states[1][0] < run.began:  # of the previous docking
            del states[0]
        run.end = self._last - run.began
        for (start, state), (end, _) in itertools.pairwise([*states, (self._last, None)]):
            name = messages.PHASES.get(state.state, f"state {state.state}")
            begin, until = start - run.began, end - run.began
            if state.charging:
                run.charged = until - begin + (0.0 if math.isnan(run.charged) else run.charged)
            if run.phases and run.phases[-1].state == name:
                begin = run.phases.pop().start
            run.phases.append(Phase(name, begin, until))
            if state.error_code and start >= run.began:
                if not run.code:
                    run.failed_at = start - run.began
                run.code, run.message = state.error_code, state.error_message
            if start >= run.began:
                run.request_id = run.request_id or state.request_id

    def _shift(self, began: float) -> None:
        """Set time 0; remove decisions and measurements of the previous docking, which end before the goal."""
        run = self.run
        for series in (run.motion, run.contact, run.power):
            series.shift(began)
        touches = [replace(touch, time=touch.time - began) for touch in run.touches]
        decisions = [replace(each, time=each.time - began) for each in run.decisions]
        first = max((each.time for each in decisions if each.kind == "accepted" and each.time <= 0.0), default=0.0)
        run.decisions = [each for each in decisions if each.time >= first]
        run.touches = [touch for touch in touches if touch.time >= first]

    def _servo_state(self, time: float, message: ServoState) -> None:
        """Take position and load of the arm."""
        delta, parameters = self._delta, self.run.parameters
        if len(message.position) != 3 or delta is None:
            return
        position = delta.forward(*message.position)
        force = current = math.nan
        if math.isfinite(position[2]) and len(message.current) == 3:
            constant = parameters.torque_constant
            held = delta.holding_torque(*position, parameters.gravity)
            spare = [constant * current - hold for current, hold in zip(message.current, held, strict=True)]
            force = delta.force(*position, (spare[0], spare[1], spare[2]))[2]
            lever = delta.jacobian(*position)[6:9]  # dz/dangle of each servo
            current = force * sum(lever) / 3.0 / constant
        self.run.motion.add(time, position[2], force, current)

    def _tactile_frame(self, time: float, message: TactileFrame) -> None:
        """Keep the pads' forces if they are tared and in contact."""
        if not message.tared or message.rows * message.columns != len(message.left):
            return
        shape = (message.rows, message.columns)
        left = np.array(message.left, dtype=np.float64).reshape(shape)
        right = np.array(message.right, dtype=np.float64).reshape(shape)
        if np.isnan(left).all() or np.isnan(right).all() or max(np.nanmax(left), np.nanmax(right)) < CONTACT_FORCE:
            return
        self._frames = (left, right)

    def _power(self, time: float, message: ChargerPower) -> None:
        self.run.power.add(time, message.charge_current, float(message.contactor_closed))

    def _feedback(self, time: float, message: Any) -> None:
        self.run.contact.add(time, message.feedback.contact_current)

    def _decision(self, time: float, message: DockingDecision) -> None:
        """Take a decision; measurements and verdicts are decisions, too."""
        values = dict(zip(message.names, message.values, strict=False))
        state = messages.PHASES.get(message.state, f"state {message.state}")
        self.run.decisions.append(Decided(time, state, message.kind, message.text, values))
        self._contacts += message.kind == "contact"
        if message.kind == "measured" or message.text == _FIRST_TOUCH:
            names = [(each, unit) for name, unit in _MEASURED.items() for each in (name, f"{name}_stddev")]
            pose = {name: values.get(f"{name}_{unit}", math.nan) for name, unit in names}
            estimate = MisalignmentEstimate(**pose, sure=message.text in ("sure", _FIRST_TOUCH))
            contact = self._contacts + (message.text == _FIRST_TOUCH)
            self.run.touches.append(Touch(time, estimate, contact, self._frames))
        elif message.kind == "verdict" and self.run.touches:
            self.run.touches[-1].verdict = message.text
            self.run.touches[-1].clearance = values.get("clearance_m", math.nan)


def _named(success: bool, code: int, message: str) -> dict[str, Any]:
    return {"success": success, "code": code, "name": messages.CODES.get(code, f"CODE_{code}"), "message": message}
