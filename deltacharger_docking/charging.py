# SPDX-License-Identifier: Apache-2.0
"""Charging under supervision, until it is no longer wanted, the target is full, or a check fails."""

import math
from dataclasses import dataclass

from deltacharger_core.script import Script
from deltacharger_docking import clearance, codes, energy, observation, touch
from deltacharger_docking.context import SAME_SAMPLE, Context
from deltacharger_docking.parameters import TargetProfile

CLEARANCE_PERIOD = 2.0  # s, period of clearance checks while charging
_CLEARANCE_FRAMES = 12  # tactile frames averaged in one check while charging
UNSAFE_MAX = 2  # successive checks without clearance that end charging
BLIND_MAX = 3  # successive failed or unsure checks that end charging

_FULL = 0.01  # of the profile's full voltage that a full target may lack
_JUMP = 0.3  # V by which a voltage shows that something has changed
_RISES = 10.0  # s below full voltage, by which a dead port shows its battery; a regulated input fills in one
_TAPERS = 1.0  # s of little current before a cut, by which a regulated input shows that its battery is full
_QUIET = 30.0  # s of little current that show that it stays little
_PULSES = 10.0  # s between two gaps of a battery management that pulses
_CONSTANT, _CURRENT_SAME, _VOLTAGE_SAME = 600.0, 0.05, 0.03  # s; share and V by which a steady load changes in it
_SMOOTHED = 30.0  # s, time constant of what is compared over them; a load steps
_LIMITED = 0.95  # share of the limit from which the limit sets the current
_KEEPS, _NOISE = 0.5, 0.1  # share of its mean that an unbroken current keeps, less noise, A
_MEASURABLE = 0.2  # A from which a current shows resistance
_HEAT, _LEAST = 10.0, 1.0  # W in contacts that became dirty; A, below which they are not worth charging through
_CLEAN = 0.5  # Ω, most of a loop that counts as clean if no better one was seen
_DIP, _DIP_LEAST, _DIP_MOST = 0.15, 0.5, 0.6  # share by which the current dips; A at least, but share at most
_PERIOD, _SOON = 10.0, 3.0  # s between dips; s if something changed
_SETTLED, _LONGEST, _MOVED = 0.2, 0.6, 0.5  # s of a dip, as of what follows; s at most; share that the current moves
_CHANGED, _SAME = 0.5, 0.2  # share of a rise by which it changed, so that the next dip comes soon; by which it has not


@dataclass
class Order:
    """The present client's request for the docked target, its start (s), and the limit of the angle (rad)."""

    goal: observation.DockGoal
    critical_angle: float
    since: float

    def is_over(self, context: Context) -> bool:
        """Return whether the electrodes have rested for `hold_max` since the last goal."""
        return context.time - self.since >= context.parameters.hold_max

    def met(self, context: Context) -> tuple[str, str]:
        """Return the name of the stop condition that is met, and a sentence on it; '' = none."""
        goal, passed = self.goal, context.time - self.since
        if goal.stop_energy and context.energy_most >= goal.stop_energy:
            most = "at most " if math.isnan(context.energy) else ""
            return "stop_energy", f"the stop condition was met: {most}{context.energy_most:.0f} J"
        if goal.stop_after and passed >= goal.stop_after:
            return "stop_after", f"the stop condition was met: {passed:.1f} s"
        if self.is_over(context):
            return "hold_max", f"{context.parameters.hold_max:g} s (hold_max) have passed since the last goal"
        return "", ""


class Charged:
    """What current and voltage show about a target: full, cut off, or reached through a contact that became dirty.

    Each charger_power is used once. At the end of the ramp the loop's resistance is (V now − V before) / I; the
    least one of a profile is its clean loop. Later dips of the current limit give ΔV / ΔI. What that is above the
    clean loop is dirt or heat if the limit set the current or a dip half as deep gives the same, else a target that
    takes less. V − I · R, in which what the target itself uses does not count, is its own voltage. A dead port has
    no voltage before: nothing is known about its contacts.

    Attributes:
        rise: of the loop's resistance above the clean one, Ω.
        limit: current that the heat of this rise allows, A.
    """

    def __init__(self, context: Context, profile: TargetProfile) -> None:
        self._context, self._profile = context, profile
        self.rise, self._loop, self.limit = 0.0, 0.0, profile.current
        self._measurable = min(_MEASURABLE, 0.5 * profile.current)
        self._rest = math.nan if context.closing is None else context.closing.rest_voltage
        self._ramps = self._is_live = math.isfinite(self._rest)  # ramps: the loop has not been measured yet
        self._sampled = context.time  # s, of the last charger_power
        self._broken = self._pulses = -math.inf  # s; broken: when last; pulses: since when
        self._gap = math.inf  # s, date of the first sample without current
        self._quiet = self._constant = context.time  # s, since when
        self._was_full = False
        self._own = self._port = math.nan, math.nan  # V of the last two unbroken samples: target's own, behind dirt
        self._told = math.nan  # V, the target's own at most, by the last dip
        self._smooth = self._before = math.nan, math.nan  # A and V: smoothed; at the start of `_constant`
        self._below = 0.0  # s in which current flowed below full voltage
        self._dip: list[tuple[float, float, float]] = []  # under way: s, A and V before it, and at its end
        self._is_shallow = False  # every other one: a resistance shows as the same in both
        self._dipped = -math.inf, context.time  # s, the last two dips
        self._due, self._seen = context.time + _SOON, math.nan  # s, of the next dip; V at the last one, or the ramp

    @property
    def at_full(self) -> bool:
        """Whether the target's own voltage is the profile's full one, twice in a row."""
        return self._is_full(self._own)

    @property
    def _is_shown(self) -> bool:
        """Whether the port's voltage is its battery's."""
        return self._is_live or self._below >= _RISES

    def _is_full(self, volts: tuple[float, float]) -> bool:
        return min(volts) >= (1.0 - _FULL) * self._profile.full_voltage

    def judge(self) -> str:
        """Use the newest charger_power; return why the target is full, '' = it is not.

        Raises:
            NoChargeCurrent: current was cut off or stays below `least_current`, or the contacts became too bad.
        """
        context, profile, seen = self._context, self._profile, self._context.observation
        now, current, volts = context.time - seen.power_age, seen.charge_current, seen.target_voltage
        if not (now > self._sampled + SAME_SAMPLE and math.isfinite(current + volts)):
            return ""  # other checks handle what is not measured
        elapsed, self._sampled = now - self._sampled, now
        whole = current >= energy.NO_CURRENT and seen.least_current >= _KEEPS * current - _NOISE
        unbroken = whole and current >= self._measurable
        self._gap = math.inf if current >= energy.NO_CURRENT else min(self._gap, now)
        if now - self._gap >= profile.gap_time:
            if self.at_full and (self._is_shown or self._gap - self._quiet >= _TAPERS):
                return "cut by the target"
            raise self._not_full("current ended", "the target's battery management, its input or a contact cut it off")
        broken = min(current, seen.least_current if current >= self._measurable else current) < energy.NO_CURRENT
        if broken and self.at_full and self._is_shown:
            self._pulses = self._pulses if now - self._broken <= _PULSES else now
            self._broken = now
            if now - self._pulses >= _QUIET:
                return "cut by the target"
        if unbroken and not self._dip:
            self._add(current, volts)
            self._below += 0.0 if self._is_full(self._port) else elapsed
        if self._is_live:
            self._look(now, current, volts, whole)
        return "" if self._dip else self._ends(now, elapsed, current, volts)

    def _ends(self, now: float, elapsed: float, current: float, volts: float) -> str:
        """Return why the target is full by a current that stays small or does not change."""
        profile, full, at_port = self._profile, self.at_full, self._is_full(self._port)
        little = profile.rest_current if full else profile.least_current
        longest = _QUIET if full else max(_QUIET, profile.gap_time)
        if not at_port or math.isnan(self._smooth[0]):
            self._smooth = self._before = current, volts
        share = -math.expm1(-elapsed / _SMOOTHED)
        amperes, volts = (old + share * (new - old) for old, new in zip(self._smooth, (current, volts), strict=True))
        self._smooth, (before, then) = (amperes, volts), self._before
        same = abs(amperes - before) <= _CURRENT_SAME * before and abs(volts - then) <= _VOLTAGE_SAME
        if not (at_port and same and self._is_shown) or current >= _LIMITED * self.limit:
            self._before, self._constant = self._smooth, now
        if current >= little or full is not self._was_full:
            self._quiet = now
        self._was_full = full
        if now - self._quiet >= longest:
            if not full:
                cause = "the target is too cold or hot, or the electrodes are dirty"
                raise self._not_full(f"only {current:.2f} A flow", cause)
            return f"current below {little:.3g} A" if self._is_sure(self._quiet) else ""
        return "steady load" if now - self._constant >= _CONSTANT and self._is_sure(self._constant) else ""

    def _is_sure(self, since: float) -> bool:
        """Return whether two dips since then (s) confirm the target's own voltage, and else make the next one."""
        if self._is_live and self._dipped[0] < since and self._context.observation.charge_current >= self._measurable:
            self._due = -math.inf
            return False
        return True

    def _add(self, current: float, volts: float) -> None:
        """Add a sample; at the end of the ramp, learn the loop's resistance by the voltage's rise with the current."""
        known, stands = self._port[1], min(self._profile.standing_current, current)
        self._port = known, volts - current * self.rise
        self._own = self._own[1], volts - stands * self.rise - (current - stands) * self._loop
        if not self._ramps or current < _LIMITED * self.limit or math.isnan(known):
            return
        self._loop = max((min(known, volts) - self._rest) / current, 0.0)
        self._context.clean[self._profile] = min(self._clean, self._loop)
        self._ramps, self._seen, self.rise = False, volts, self._loop - self._clean
        self._allow(self.rise)

    @property
    def _clean(self) -> float:
        return self._context.clean.get(self._profile, _CLEAN)

    def _look(self, now: float, current: float, volts: float, whole: bool) -> None:
        """Begin, continue or end a dip of the current limit."""
        if not self._dip:
            jumped = now >= self._dipped[1] + _SOON and abs(volts - self._seen) > _JUMP
            if whole and current >= self._measurable and (now >= self._due or jumped):
                self._dip, self._is_shallow = [(now, current, volts)], not self._is_shallow
                depth = min(max(_DIP * current, _DIP_LEAST), _DIP_MOST * current)
                self._set_limit(current - (0.5 * depth if self._is_shallow else depth))
            return
        (_, before, high), (since, last, _) = self._dip[0], self._dip[-1]
        ends = len(self._dip) > 1
        moved = (last - current) / (last - (before if ends else self._context.limits.current)) >= _MOVED
        settled = now >= since + _SETTLED and whole and moved
        if not settled and now < since + _LONGEST:
            return
        self._set_limit(self.limit)
        if settled and not ends:
            self._dip.append((now, current, volts))
            return
        known = self.rise
        if settled:
            self._measure(current, volts)
            if before >= _LIMITED * self.limit or abs(self.rise - known) <= _SAME * self.rise:
                self._allow(known)
        self._dip, self._dipped, self._seen = [], (self._dipped[1], now), high
        self._due = now + (_SOON if abs(self.rise - known) > _CHANGED * self.rise else _PERIOD)

    def _measure(self, after: float, volts: float) -> None:
        """Learn from a dip; A and V after it cancel what the voltage gains by charging meanwhile."""
        (_, before, high), (_, current, low) = self._dip
        self._loop = max((high + volts - 2.0 * low) / (before + after - 2.0 * current), 0.0)
        self.rise, self._told = max(self._loop - self._clean, 0.0), low - current * min(self._loop, self._clean)

    def _allow(self, before: float) -> None:
        """Limit the current so that what the loop's resistance rose by, from `before` Ω, stays cool if it grows on.

        Raises:
            NoChargeCurrent: too little is left, twice in a row.
        """
        hot, least = 2.0 * self.rise - min(before, self.rise), min(_LEAST, self._profile.current)
        self.limit = min(self._profile.current, max(math.sqrt(_HEAT / hot), least) if hot else math.inf)
        if min(before, self.rise) * least * least > _HEAT:
            raise codes.NoChargeCurrent(f"contact resistance rose to {1000.0 * self.rise:.0f} mΩ: clean the electrodes")
        self._set_limit(self.limit)

    def _set_limit(self, current: float) -> None:
        self._context.limits = self._context.limits._replace(current=current)

    def _not_full(self, what: str, cause: str) -> codes.NoChargeCurrent:
        if not self._is_shown:
            return codes.NoChargeCurrent(
                f"{what}; whether the target is full is unknown: its port does not show its battery"
            )
        volts = self._told if math.isfinite(self._told) else self._context.observation.target_voltage
        return codes.NoChargeCurrent(
            f"{what} at {volts:.1f} V of {self._profile.full_voltage:.1f} V: not full; {cause}"
        )


def charge(context: Context, order: Order, target: touch.Target) -> Script[str]:
    """Supervise charging until a stop condition, a goal without charging, or a full target; return the reason.

    Raises:
        DockingError: why charging ended; the caller opens the contactor and retracts.
    """
    assert context.profile is not None  # what charges has one
    charged, checks = Charged(context, context.profile), clearance_checks(context, order, target)
    while True:
        refused = context.closing is not None and context.closing.refused  # it opens, and so ends the current
        why = "" if refused else charged.judge()
        if why:
            current, volts = context.observation.charge_current, context.observation.target_voltage
            context.end_charge(f"full: {why}")
            context.decide("full", why, charge_current_A=current, target_voltage_V=volts, energy_J=context.energy)
            return f"the target is full: {why}"
        ended, reason = order.met(context)
        if not order.goal.start_charging:
            reason, ended = "a later goal with start_charging false ended charging", "start_charging false"
        if reason:
            context.end_charge(ended)
            context.decide("stop", reason, energy_J=context.energy, time_s=context.time - order.since)
            return reason
        yield next(checks)


def clearance_checks(context: Context, order: Order, target: touch.Target) -> Script[None]:
    """Check the clearance periodically; end charging after too many checks in a row that find none or are unsure."""
    parameters = context.parameters
    unsafe = blind = 0
    while True:
        yield from context.wait(CLEARANCE_PERIOD)
        context.evidence.begin_contact()
        reply = yield from context.ask(
            observation.Service.ESTIMATE, codes.TactileStale, touch.MEASURE_TIMEOUT, _CLEARANCE_FRAMES
        )
        estimate = None if reply.estimate is None else touch.with_pitch(context, reply.estimate)
        if estimate is None or not estimate.usable:
            blind += 1
            context.decide("blind", "the clearance could not be measured", times=blind)
            if blind >= BLIND_MAX:
                raise _blind(reply, blind)
            continue
        blind = 0
        context.status.estimate = target.place.combined(estimate, later=True)
        touch.keep_evidence(context, estimate)
        lost = not clearance.judge(estimate, parameters, order.critical_angle).leaves_clearance
        unsafe = unsafe + 1 if lost else 0
        if lost:
            context.decide("unsafe", "the clearance is too small", times=unsafe, **estimate.numbers)
        if unsafe >= UNSAFE_MAX:
            place = f"{math.degrees(estimate.angle):.1f}°, {1000 * estimate.across:.1f} mm across the bars"
            raise codes.CriticalAngle(f"the target moved while charging: {place} leave no clearance")


def _blind(reply: observation.Reply, count: int) -> codes.DockingError:
    if reply.estimate is None:
        return codes.TactileStale(f"no misalignment estimate while charging, {count} times in a row: {reply.message}")
    return codes.EstimateUnsure(f"the tactile estimate stayed unsure while charging, {count} times in a row")
