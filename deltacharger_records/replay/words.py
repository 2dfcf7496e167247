# SPDX-License-Identifier: Apache-2.0
"""Text of a recorded docking: its events in order, and the reason for its outcome."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from deltacharger_docking.clearance import CLEARANCE_SIGMAS, MisalignmentEstimate, clearance, clearance_stddev
from deltacharger_docking.codes import REMEDIES, Code
from deltacharger_records.quantities import in_unit, numbers
from deltacharger_records.replay.record import Replay
from deltacharger_records.replay.run_record import Decided, Touch

_LATE = 0.2  # s by which a decision's message may follow its phase
_WORDS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}


def story(replay: Replay) -> list[str]:
    """Return one line for each phase and for each decision in it, in order."""
    events: list[tuple[float, int, str]] = []
    for phase in replay.phases:
        length = f"for {in_unit(phase.end - phase.start, 's', 1)}"
        events.append((phase.start, 1, f"{in_unit(phase.start, 's', 2):>9}  {phase.state.replace('_', ' ')}, {length}"))
    for decision in replay.run.decisions:
        time = _time_of(replay, decision)
        events.append((time, 0, f"{in_unit(time, 's', 2):>9}    {_described(decision)}"))
    return [line for _, _, line in sorted(events, key=lambda event: event[:2])]


def _time_of(replay: Replay, decision: Decided) -> float:
    """Return the time of a decision, limited to its phase's end: its message may arrive after the next state's."""
    ends = [phase.end for phase in replay.phases if phase.state == decision.phase and phase.start <= decision.time]
    return min(decision.time, ends[-1]) if ends and decision.time - ends[-1] < _LATE else decision.time


def _described(decision: Decided) -> str:
    shown = {name: value for name, value in decision.values.items() if name != "code" and not math.isnan(value)}
    text = f"{decision.kind}: {decision.text}"
    return f"{text} ({numbers(shown)})" if shown else text


def why(replay: Replay) -> str:
    """Return one paragraph: the reason for the end, its numbers, and what to do."""
    outcome, after = replay.outcome(), replay.afterwards()
    if outcome["success"] is None:
        return _unfinished_text(replay)
    if outcome["success"]:
        return (
            _docked(replay) + (f" {_because(replay, after)}" if after is not None else f" {_charged(replay)}").rstrip()
        )
    return _because(replay, outcome)


def _unfinished_text(replay: Replay) -> str:
    damage = replay.recording.damage or "no outcome was recorded"
    motion, power = replay.run.motion, replay.run.power
    closed = power.last("closed")
    contactor = "" if math.isnan(closed) else f", the contactor {'closed' if closed else 'open'}"
    where = in_unit(motion.last("z"), "m")
    return (
        f"The recording ends in {replay.last_phase.upper()} after {in_unit(replay.end, 's', 1)} without an outcome: "
        f"{damage}. The arm was last seen at z {where}{contactor}. Check docking_node's log and the next record."
    )


def _docked(replay: Replay) -> str:
    result, touches = replay.result_of("dock"), replay.run.touches
    details = result.details if result is not None else {}
    took = f" in {in_unit(result.elapsed, 's', 1)}" if result is not None else ""
    charging = not math.isnan(replay.charged)
    parts = [f"{'Docked and charging' if charging else 'Docked'}{took}"]
    if details.get("contact_current") is not None:
        force = in_unit(details["contact_force"], "N") if details.get("contact_force") is not None else "unknown"
        parts.append(f"the electrodes rest with {in_unit(details['contact_current'], 'A')} of contact current, {force}")
    judged = [touch for touch in touches if not math.isnan(touch.clearance)]
    if judged:
        last = judged[-1]
        parts.append(
            f"the target lies {in_unit(last.horizontal, 'm')}, {in_unit(last.vertical, 'm')} and "
            f"{in_unit(last.angle, 'rad')} off, which leaves {in_unit(last.clearance, 'm')} of clearance"
        )
    return "; ".join(parts) + "."


def _charged(replay: Replay) -> str:
    if math.isnan(replay.charged):
        return ""
    current = replay.run.power.arrays()["current"]
    highest = (
        f" at up to {in_unit(float(current[current == current].max()), 'A')}" if (current == current).any() else ""
    )
    end = "The recording ends while it still charges." if replay.last_phase == "charging" else "Then it was undocked."
    return f"It charged for {_duration(replay.charged)}{highest}. {end}"


def _because(replay: Replay, ended: Mapping[str, Any]) -> str:
    """Return why it ended with an error, with that error's numbers and the remedy."""
    code, message = int(ended["code"]), str(ended["message"])
    when = replay.failed_at if not math.isnan(replay.failed_at) else replay.end
    phase = _phase_before(replay, when).upper().replace("_", " ")
    charging = not math.isnan(replay.charged)
    if code == Code.CANCELED:
        text = f"The client canceled the goal in {phase} after {in_unit(when, 's', 1)}."
    elif code in _REASONS and not charging:
        text = f"Charging was refused: {_REASONS[Code(code)](replay, message)}."
    else:
        what = f"Charging was ended after {_duration(replay.charged)}" if charging else f"Docking ended in {phase}"
        text = f"{what} by {_name(code)}: {message}."
    remedy = REMEDIES.get(Code(code), "") if code in list(Code) else ""
    if remedy and remedy.lower() not in text.lower():
        text += f" {remedy[0].upper()}{remedy[1:]}."
    return f"{text} {_way_back(replay)}".rstrip()


def _tilted(replay: Replay, message: str) -> str:
    known = [touch for touch in replay.run.touches if math.isfinite(touch.angle)]
    touches = [touch for touch in known if touch.sure] or known
    if not touches:
        return f"before anything was touched, {message}"
    estimate, parameters = _mean(touches), replay.parameters
    gap, length = parameters.electrode_half_gap, parameters.electrode_half_length
    left = clearance(estimate.angle, 0.0, gap, length)
    sigmas = CLEARANCE_SIGMAS
    worst = left - sigmas * clearance_stddev(estimate, gap, length)
    needed = in_unit(parameters.clearance_min, "m")
    times = f" in {_WORDS.get(len(touches), len(touches))} contacts" if len(touches) > 1 else ""
    found = f"{in_unit(estimate.angle, 'rad')} ± {in_unit(estimate.angle_stddev, 'rad')}"
    text = f"the angle was measured as {found}{times}; even without an offset across the bars the clearance would be "
    if left < parameters.clearance_min:
        return text + f"{in_unit(left, 'm')}, {needed} are needed"
    if worst < parameters.clearance_min:
        less = f"{in_unit(worst, 'm')} after subtracting {sigmas:g} standard deviations"
        return text + f"{in_unit(left, 'm')}, {less}; {needed} are needed"
    return f"the angle was measured as {found}{times}; {message}"


def _off(replay: Replay, message: str) -> str:
    judged = [touch for touch in replay.run.touches if not math.isnan(touch.clearance)]
    if not judged:
        return message
    needed = in_unit(replay.parameters.clearance_min, "m")
    last = judged[-1].estimate
    return (
        f"{message}; the last measurement found {in_unit(last.across, 'm')} ± {in_unit(last.across_stddev, 'm')} "
        f"across the bars and {in_unit(last.angle, 'rad')} ± {in_unit(last.angle_stddev, 'rad')}, which leaves "
        f"{in_unit(judged[-1].clearance, 'm')} of clearance, and {needed} are needed "
        f"at {CLEARANCE_SIGMAS:g} standard deviations"
    )


def _unsure(replay: Replay, message: str) -> str:
    unsure = sum(not touch.sure for touch in replay.run.touches)
    return f"{message}; {unsure} of {len(replay.run.touches)} measurements were unsure"


_REASONS: dict[Code, Callable[[Replay, str], str]] = {
    Code.CRITICAL_ANGLE: _tilted,
    Code.MISALIGNED: _off,
    Code.ESTIMATE_UNSURE: _unsure,
    Code.LEANING: lambda replay, message: message,
}


def _mean(touches: list[Touch]) -> MisalignmentEstimate:
    """Return the mean angle of several contacts without an offset, with the largest of their standard deviations."""
    names = ("angle_stddev", "vertical_stddev", "horizontal_stddev", "across_stddev")
    found = [touch.estimate for touch in touches]
    angle, vertical, horizontal, across = (max(getattr(each, name) for each in found) for name in names)
    mean = sum(each.angle for each in found) / len(found)
    return MisalignmentEstimate(mean, angle, 0.0, vertical, 0.0, horizontal, across=0.0, across_stddev=across)


def _way_back(replay: Replay) -> str:
    if replay.last_phase == "idle":
        home = any(each.kind == "retracted" for each in replay.run.decisions)
        start = in_unit(replay.phases[-1].start, "s", 1)
        return f"The arm was {'home' if home else 'at rest'} again at {start}."
    return f"The recording ends in {replay.last_phase.upper()}: {replay.recording.damage or 'it stopped earlier'}."


def _phase_before(replay: Replay, time: float) -> str:
    """Return the phase in which an error occurred; retraction starts with the error."""
    earlier = [phase.state for phase in replay.phases if phase.start < time and phase.state != "retract"]
    return earlier[-1] if earlier else "idle"


def _name(code: int) -> str:
    return Code(code).name if code in list(Code) else str(code)


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return in_unit(seconds, "s", 1)
    minutes = seconds / 60.0
    return f"{minutes:.0f} min" if minutes < 120.0 else f"{minutes / 60.0:.1f} h"
