# SPDX-License-Identifier: Apache-2.0
"""Text of a docking: its events in order, the reason for its outcome, and numbers with units for people."""

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from deltacharger_bringup.records.replay.run import Decided, Run
from deltacharger_docking import clearance, codes

_UNITS: dict[str, tuple[float, str, int]] = {
    "Nms_per_rad": (1.0, "N·m·s/rad", 2),
    "Nm_per_rad": (1.0, "N·m/rad", 1),
    "Nm": (1.0, "N·m", 2),
    "m": (1e3, "mm", 1),
    "rad": (180.0 / math.pi, "°", 1),
    "A": (1.0, "A", 2),
    "N": (1.0, "N", 1),
    "s": (1.0, "s", 2),
    "V": (1.0, "V", 1),
    "J": (1.0, "J", 0),
    "ohm": (1.0, "Ω", 0),
}
_STDDEV = "_stddev"
_MOMENT = 0.5  # s of charging at the end that are not worth a sentence
_LATE = 0.2  # s by which a decision's message may follow its phase
_WORDS = {2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}


def story(run: Run) -> list[str]:
    """Return one line for each phase and for each decision in it, in order."""
    events: list[tuple[float, int, str]] = []
    for phase in run.phases:
        length = f"for {in_unit(phase.end - phase.start, 's', 1)}"
        events.append((phase.start, 1, f"{in_unit(phase.start, 's', 2):>9}  {phase.state.replace('_', ' ')}, {length}"))
    for decision in run.decisions:
        time = _time_of(run, decision)
        events.append((time, 0, f"{in_unit(time, 's', 2):>9}    {_described(decision)}"))
    return [line for _, _, line in sorted(events, key=lambda event: event[:2])]


def _time_of(run: Run, decision: Decided) -> float:
    """Return the time of a decision, limited to its phase's end: its message may arrive after the next state's."""
    ends = [phase.end for phase in run.phases if phase.state == decision.phase and phase.start <= decision.time]
    return min(decision.time, ends[-1]) if ends and decision.time - ends[-1] < _LATE else decision.time


def _described(decision: Decided) -> str:
    shown = {name: value for name, value in decision.values.items() if name != "code" and not math.isnan(value)}
    text = f"{decision.kind}: {decision.text}"
    return f"{text} ({numbers(shown)})" if shown else text


def why(run: Run) -> str:
    """Return one paragraph: the reason for the end, its numbers, and what to do."""
    outcome, after = run.outcome(), run.afterwards()
    if outcome["success"] is None:
        return _unfinished_text(run)
    if outcome["success"]:
        return _docked(run) + (f" {_because(run, after)}" if after is not None else f" {_charged(run)}").rstrip()
    return _because(run, outcome)


def _unfinished_text(run: Run) -> str:
    damage = run.damage or "no outcome was recorded"
    motion, power = run.motion, run.power
    closed = power.last("closed")
    contactor = "" if math.isnan(closed) else f", the contactor {'closed' if closed else 'open'}"
    where = in_unit(motion.last("z"), "m")
    return (
        f"The recording ends in {run.last_phase.upper()} after {in_unit(run.end, 's', 1)} without an outcome: "
        f"{damage}. The arm was last seen at z {where}{contactor}. Check docking_node's log and the next record."
    )


def _docked(run: Run) -> str:
    result, touches = run.result_of("dock"), run.touches
    details = result.details if result is not None else {}
    took = f" in {in_unit(result.elapsed, 's', 1)}" if result is not None else ""
    charging = not math.isnan(run.charged)
    parts = [f"{'Docked and charging' if charging else 'Docked'}{took}"]
    if details.get("contact_current") is not None:
        force = in_unit(details["contact_force"], "N") if details.get("contact_force") is not None else "unknown"
        parts.append(f"the electrodes rest with {in_unit(details['contact_current'], 'A')} of contact current, {force}")
    judged = [touch for touch in touches if not math.isnan(touch.clearance)]
    if judged:
        last = judged[-1].estimate
        parts.append(
            f"the target lies {in_unit(last.horizontal, 'm')}, {in_unit(last.vertical, 'm')} and "
            f"{in_unit(last.angle, 'rad')} off, which leaves {in_unit(judged[-1].clearance, 'm')} of clearance"
        )
    return "; ".join(parts) + "."


def _charged(run: Run) -> str:
    if math.isnan(run.charged) or (run.charged < _MOMENT and run.last_phase == "charging"):
        return ""
    current = run.power.arrays()["current"]
    highest = (
        f" at up to {in_unit(float(current[current == current].max()), 'A')}" if (current == current).any() else ""
    )
    end = "The recording ends while it still charges." if run.last_phase == "charging" else "Then it was undocked."
    return f"It charged for {_duration(run.charged)}{highest}. {end}"


def _because(run: Run, ended: Mapping[str, Any]) -> str:
    """Return why it ended with an error, with that error's numbers and the remedy."""
    code, message = int(ended["code"]), str(ended["message"])
    when = run.failed_at if not math.isnan(run.failed_at) else run.end
    phase = _phase_before(run, when).upper().replace("_", " ")
    charging = not math.isnan(run.charged)
    if code == codes.Code.CANCELED:
        text = f"The client canceled the goal in {phase} after {in_unit(when, 's', 1)}."
    elif code in _REASONS and not charging:
        text = f"Charging was refused: {_REASONS[codes.Code(code)](run, message)}."
    else:
        what = f"Charging was ended after {_duration(run.charged)}" if charging else f"Docking ended in {phase}"
        text = f"{what} by {_name(code)}: {message}."
    remedy = codes.REMEDIES.get(codes.Code(code), "") if code in list(codes.Code) else ""
    if remedy and remedy.lower() not in text.lower():
        text += f" {remedy[0].upper()}{remedy[1:]}."
    return f"{text} {_way_back(run)}".rstrip()


def _tilted(run: Run, message: str) -> str:
    known = [touch.estimate for touch in run.touches if math.isfinite(touch.estimate.angle)]
    estimates = [each for each in known if each.sure] or known
    if not estimates:
        return f"before anything was measured by touch, {message}"
    estimate, parameters = _mean(estimates), run.parameters
    sigmas = clearance.CLEARANCE_SIGMAS
    left, worst = (clearance.least_clearance(estimate, parameters, spread) for spread in (0.0, sigmas))
    needed = in_unit(parameters.clearance_min, "m")
    times = f" in {_WORDS.get(len(estimates), len(estimates))} contacts" if len(estimates) > 1 else ""
    found = f"{in_unit(estimate.angle, 'rad')} ± {in_unit(estimate.angle_stddev, 'rad')}"
    text = f"the angle was measured as {found}{times}; even without an offset across the bars the clearance would be "
    if left < parameters.clearance_min:
        return text + f"{in_unit(left, 'm')}, {needed} are needed"
    if worst < parameters.clearance_min:
        less = f"{in_unit(worst, 'm')} after subtracting {sigmas:g} standard deviations"
        return text + f"{in_unit(left, 'm')}, {less}; {needed} are needed"
    return f"the angle was measured as {found}{times}; {message}"


def _off(run: Run, message: str) -> str:
    judged = [touch for touch in run.touches if not math.isnan(touch.clearance)]
    if not judged:
        return message
    needed = in_unit(run.parameters.clearance_min, "m")
    last = judged[-1].estimate
    return (
        f"{message}; the last measurement found {in_unit(last.across, 'm')} ± {in_unit(last.across_stddev, 'm')} "
        f"across the bars and {in_unit(last.angle, 'rad')} ± {in_unit(last.angle_stddev, 'rad')}, which leaves "
        f"{in_unit(judged[-1].clearance, 'm')} of clearance, and {needed} are needed "
        f"at {clearance.CLEARANCE_SIGMAS:g} standard deviations"
    )


def _unsure(run: Run, message: str) -> str:
    unsure = sum(not touch.estimate.sure for touch in run.touches)
    return f"{message}; {unsure} of {len(run.touches)} measurements were unsure"


_REASONS: dict[codes.Code, Callable[[Run, str], str]] = {
    codes.Code.CRITICAL_ANGLE: _tilted,
    codes.Code.MISALIGNED: _off,
    codes.Code.ESTIMATE_UNSURE: _unsure,
    codes.Code.LEANING: lambda run, message: message,
}


def _mean(found: list[clearance.MisalignmentEstimate]) -> clearance.MisalignmentEstimate:
    """Return the mean angle of several contacts without an offset, with the largest of their standard deviations."""
    names = ("angle_stddev", "vertical_stddev", "horizontal_stddev", "across_stddev")
    angle, vertical, horizontal, across = (max(getattr(each, name) for each in found) for name in names)
    mean = sum(each.angle for each in found) / len(found)
    return clearance.MisalignmentEstimate(mean, angle, 0.0, vertical, 0.0, horizontal, across=0.0, across_stddev=across)


def _way_back(run: Run) -> str:
    if run.last_phase == "idle":
        home = any(each.kind == "retracted" for each in run.decisions)
        start = in_unit(run.phases[-1].start, "s", 1)
        return f"The arm was {'home' if home else 'at rest'} again at {start}."
    return f"The recording ends in {run.last_phase.upper()}: {run.damage or 'it stopped earlier'}."


def _phase_before(run: Run, time: float) -> str:
    """Return the phase in which an error occurred; retraction starts with the error."""
    earlier = [phase.state for phase in run.phases if phase.start < time and phase.state != "retract"]
    return earlier[-1] if earlier else "idle"


def _name(code: int) -> str:
    return codes.Code(code).name if code in list(codes.Code) else str(code)


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return in_unit(seconds, "s", 1)
    minutes = seconds / 60.0
    return f"{minutes:.0f} min" if minutes < 120.0 else f"{minutes / 60.0:.1f} h"


def in_unit(value: float, unit: str, digits: int | None = None) -> str:
    """Return an SI value with its unit for people: 0.0059 m is '5.9 mm'; 'unknown' for NaN."""
    if not math.isfinite(value):
        return "unknown" if math.isnan(value) else "infinite"
    scale, name, usual = _UNITS[unit]
    kept = usual if digits is None else digits
    text = f"{round(scale * value, kept) + 0.0:.{kept}f}".replace("-", "−")  # + 0.0: no minus before a zero
    return f"{text}{'' if name == '°' else ' '}{name}"


def numbers(values: Mapping[str, float]) -> str:
    """Return the numbers of a decision, each with name, unit and, if known, standard deviation."""
    parts = []
    for name, value in values.items():
        unit = next((each for each in _UNITS if name.endswith(f"_{each}")), "")
        base = name.removesuffix(f"_{unit}")
        if base.endswith(_STDDEV):
            continue
        if not unit:
            parts.append(f"{name.replace('_', ' ')} {value:.3g}")
            continue
        text = f"{_label(base)} {in_unit(value, unit)}"
        spread = values.get(f"{base}{_STDDEV}_{unit}")
        parts.append(text if spread is None else f"{text} ± {in_unit(spread, unit)}")
    return ", ".join(parts)


def _label(base: str) -> str:
    return re.sub(r" (\d) sigma$", r" at \1σ", base.replace("_", " "))
