# SPDX-License-Identifier: Apache-2.0
"""Charging under supervision, until it is no longer wanted, the target is full, or a check fails."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from deltacharger_core.script import Script
from deltacharger_docking.clearance import judge
from deltacharger_docking.codes import CriticalAngle, DockingError, EstimateUnsure, NoChargeCurrent, TactileStale
from deltacharger_docking.context import Context
from deltacharger_docking.energy import no_current
from deltacharger_docking.observation import DockGoal, Reply, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.touch import Target, keep_evidence, with_pitch


@dataclass
class Order:
    """The present client's request for the docked target, its start (s), and the limit of the angle (rad)."""

    goal: DockGoal
    critical_angle: float
    since: float

    def is_met(self, context: Context) -> str:
        """Return the stop condition that is met; '' = none."""
        goal = self.goal
        if goal.stop_energy and context.energy_most >= goal.stop_energy:
            most = "at most " if math.isnan(context.energy) else ""
            return f"the stop condition was met: {most}{context.energy_most:.0f} J"
        if goal.stop_after and context.time - self.since >= goal.stop_after:
            return f"the stop condition was met: {context.time - self.since:.1f} s"
        return self.is_over(context)

    def is_over(self, context: Context) -> str:
        """Return that the electrodes have rested for `hold_max` since the last goal; '' = not yet."""
        limit = context.parameters.hold_max
        return f"{limit:g} s (hold_max) have passed since the last goal" if context.time - self.since >= limit else ""


class Flow(Enum):
    """What the charge current shows about the target."""

    FLOWS = "current flows"
    FULL = "current has tapered off: the target is full"
    LOST = "current was cut off"


class Taper:
    """Distinguishes a full target from a current that was cut off.

    At constant voltage a battery's current falls over minutes; a cut ends it between two samples. A current below the
    minimum means a full target if it was never less than `taper_share` of its mean over the last `taper_time`, and
    stays below the minimum for `full_time`. For a current that falls with time constant T, the mean is ahead by
    taper_time / T. At a share of one half and 2 s, everything slower than T = 4 s is a taper.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self._parameters = parameters
        self._time = math.nan
        self._below_since = math.inf
        self.mean = math.nan

    def judge(self, time: float, current: float) -> Flow:
        """Use the charge current (A) at `time` (s); NaN, which other checks handle, changes nothing."""
        if math.isnan(current):
            return Flow.FLOWS
        if math.isnan(self.mean):
            self._time, self.mean = time, current
        before, parameters = self.mean, self._parameters
        self.mean += (current - before) * -math.expm1((self._time - time) / parameters.taper_time)
        self._time = time
        if current >= parameters.charge_current_min:
            self._below_since = math.inf
            return Flow.FLOWS
        if current < parameters.taper_share * before:
            return Flow.LOST
        self._below_since = min(self._below_since, time)
        return Flow.FULL if time - self._below_since >= parameters.full_time else Flow.FLOWS


def charge(context: Context, order: Order, target: Target) -> Script[str]:
    """Supervise charging until a stop condition, a goal without charging, or a full target; return the reason.

    Raises:
        DockingError: why charging ended; the caller opens the contactor and retracts.
    """
    taper = Taper(context.parameters)
    checks = clearance_checks(context, order, target)
    while True:
        flow = taper.judge(context.time, context.observation.charge_current)
        refused = context.closing is not None and context.closing.refused  # it opens, and so ends the current
        if flow is Flow.LOST and not refused:
            raise NoChargeCurrent(no_current(context))
        if flow is Flow.FULL:
            current = context.observation.charge_current
            context.decide("full", flow.value, charge_current_A=current, mean_A=taper.mean, energy_J=context.energy)
            return "the target is full"
        reason = (
            order.is_met(context)
            if order.goal.start_charging
            else "a later goal with start_charging false ended charging"
        )
        if reason:
            context.decide("stop", reason, energy_J=context.energy, time_s=context.time - order.since)
            return reason
        yield next(checks)


def clearance_checks(context: Context, order: Order, target: Target) -> Script[None]:
    """Check the clearance periodically; end charging after too many checks in a row that find none or are unsure."""
    parameters = context.parameters
    unsafe = blind = 0
    while True:
        yield from context.wait(parameters.clearance_period)
        context.evidence.begin()
        reply = yield from context.ask(
            Service.ESTIMATE, TactileStale, parameters.measure_timeout, parameters.clearance_frames
        )
        estimate = None if reply.estimate is None else with_pitch(context, reply.estimate)
        if estimate is None or not estimate.usable:
            blind += 1
            context.decide("blind", "the clearance could not be measured", times=blind)
            if blind >= parameters.blind_max:
                raise _blind(reply, blind)
            continue
        blind = 0
        context.status.estimate = target.combined_later(estimate)
        keep_evidence(context, estimate)
        lost = not judge(estimate, parameters, order.critical_angle).leaves_clearance
        unsafe = unsafe + 1 if lost else 0
        if lost:
            context.decide("unsafe", "the clearance is too small", times=unsafe, **estimate.numbers)
        if unsafe >= parameters.unsafe_max:
            raise CriticalAngle(
                f"the target moved while charging: {math.degrees(estimate.angle):.1f}°, "
                f"{1000 * estimate.across:.1f} mm across the bars leave no clearance"
            )


def _blind(reply: Reply, count: int) -> DockingError:
    if reply.estimate is None:
        return TactileStale(f"no misalignment estimate while charging, {count} times in a row: {reply.message}")
    return EstimateUnsure(f"the tactile estimate stayed unsure while charging, {count} times in a row")
