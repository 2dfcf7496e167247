# SPDX-License-Identifier: Apache-2.0
"""Electrodes that hang on the battery (power: none), as the paper has them: live whenever they touch.

Nothing closes, limits, measures or opens the circuit, so what docking can do is to look early and to part. It looks at
the first touch of each contact, before it presses home, and while it stays docked it watches as over charging. It never
says that it charges.
"""

from __future__ import annotations

import math

from deltacharger_core.script import Script
from deltacharger_docking.charging import Order, clearance_checks
from deltacharger_docking.clearance import FeltPose, Verdict
from deltacharger_docking.codes import CriticalAngle, State, TactileStale
from deltacharger_docking.context import Context
from deltacharger_docking.energy import Watch, wait_for_single_sources
from deltacharger_docking.observation import Service
from deltacharger_docking.retract import retract
from deltacharger_docking.touch import Target, tell_verdict, too_tilted, with_pitch

_UNKNOWN = "this charger does not measure, limit or interrupt it"
DOCKED = (
    f"docked; power: none: the electrodes hang on the battery, so that current may flow now; {_UNKNOWN}; undock ends it"
)
PARTED = f"the electrodes were taken off under whatever current flowed, since power is none: {_UNKNOWN}"


def stay_away(context: Context) -> Script[None]:
    """Wait before the first touch until there is no second source.

    Raises:
        DuplicateSource: there still is one after duplicate_source_timeout.
    """
    if context.observation.duplicate_sources:
        yield from wait_for_single_sources(context, State.APPROACH)


def look(context: Context, target: Target) -> Script[FeltPose | None]:
    """Feel where the electrodes have just met the target; return what forbids to press home, None where nothing does.

    It does not wait until the arm rests: what may be shorted shall not lie so for long. So light a touch may not tell;
    then it is pressed home and judged there, unless it tells a tilt beyond the limit, however unsure.

    Raises:
        CriticalAngle: the target is tilted too far.
        TactileStale: no estimate came.
    """
    parameters = context.parameters
    context.contact.clear()
    reply = yield from context.ask(
        Service.ESTIMATE, TactileStale, parameters.service_timeout, parameters.estimate_frames
    )
    if not reply.success or reply.estimate is None:
        raise TactileStale(f"no misalignment estimate at the first touch: {reply.message}")
    context.status.estimate = felt = with_pitch(context, reply.estimate)
    text = "the first touch tells" if felt.usable else "so light a touch does not tell"
    context.decide("touched", text, contact_current_A=context.contact.value, **felt.numbers)
    if not felt.usable:
        limit = min(target.critical_angle, parameters.critical_angle)
        return felt if felt.contact and abs(felt.angle) >= limit else None
    verdict = tell_verdict(context, felt, target.critical_angle)
    if verdict is Verdict.CRITICAL:
        raise CriticalAngle(too_tilted(felt.angle))
    return felt if verdict is Verdict.TOO_CLOSE else None


def watch(context: Context, order: Order, target: Target) -> Script[str]:
    """Watch over docked electrodes as while charging, until a stop condition is met; return which.

    Raises:
        DockingError: what is wrong; the caller retracts.
    """
    watching, checks = Watch(context), clearance_checks(context, order, target)
    while True:
        problem = watching.problem_unmeasured()
        if problem is not None:
            raise problem
        if reason := order.is_met(context):
            context.decide("stop", reason, time_s=context.time - order.since)
            return reason
        yield next(checks)


def part(context: Context) -> Script[None]:
    """Take the electrodes off the target, the only way to end what flows, and the arm home."""
    yield from retract(context, wanted=True)
    context.status.docked = False
    context.enter(State.IDLE, math.inf)
