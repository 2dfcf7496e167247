# SPDX-License-Identifier: Apache-2.0
"""Electrodes wired to the battery (power: none), as in the paper: live whenever they touch.

Nothing closes, limits, measures or opens the circuit. So docking measures the misalignment at the first touch of each
contact, before it presses further, and monitors docked electrodes as it does while charging. If a check fails, it takes
the electrodes off. It never reports that it charges. `look` serves targets too whose own battery makes the port live.
"""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Script
from deltacharger_docking.charging import Order, clearance_checks
from deltacharger_docking.clearance import MisalignmentEstimate, Verdict
from deltacharger_docking.codes import CriticalAngle, State, TactileStale
from deltacharger_docking.context import SERVICE_TIMEOUT, Context, Live
from deltacharger_docking.observation import Service
from deltacharger_docking.retract import retract
from deltacharger_docking.touch import ESTIMATE_FRAMES, Target, record_verdict, rolled_too_far, with_pitch

_POWER = 0.1  # s, two periods of charger_power
_UNKNOWN = "this charger does not measure, limit or interrupt it"
DOCKED = (
    f"docked; power: none: the electrodes are wired to the battery, so current may flow now; {_UNKNOWN}; undock ends it"
)
PARTED = f"the electrodes were taken off although current may still have flowed (power: none): {_UNKNOWN}"


def look(context: Context, target: Target) -> Script[MisalignmentEstimate | None]:
    """Measure at the first touch; return the estimate if it forbids pressing further, else None.

    Where the target makes the port live, its voltage shows that no bar bridges it, and only a touch without it is
    measured. To measure at each touch would take 0.4 s more in median (150 dockings of `default`).

    It does not wait until the arm rests, since shorted electrodes must not stay in contact. If so light a touch gives
    no usable estimate, pressing continues and is judged later, unless even the unsure one exceeds the critical angle.

    Raises:
        CriticalAngle: the target is rolled too far.
        TactileStale: no estimate arrived.
    """
    parameters = context.parameters
    end = context.time + (0.0 if parameters.always_live else _POWER)
    while context.time < end and not context.port_shown:
        yield NEXT
    if not parameters.always_live and context.port_shown and not context.is_dark:
        return None
    context.contact.clear()
    reply = yield from context.ask(Service.ESTIMATE, TactileStale, SERVICE_TIMEOUT, ESTIMATE_FRAMES)
    if not reply.success or reply.estimate is None:
        raise TactileStale(f"no misalignment estimate at the first touch: {reply.message}")
    context.status.estimate = estimate = with_pitch(context, reply.estimate)
    text = "the first touch gives an estimate" if estimate.usable else "the touch is too light for an estimate"
    context.decide("touched", text, contact_current_A=context.contact.value, **estimate.numbers)
    if not estimate.usable:
        limit = min(target.critical_angle, parameters.critical_angle)
        return estimate if estimate.contact and abs(estimate.angle) >= limit else None
    verdict = record_verdict(context, estimate, target.critical_angle)
    if verdict is Verdict.CRITICAL:
        raise CriticalAngle(rolled_too_far(estimate.angle))
    return estimate if verdict is Verdict.TOO_CLOSE else None


def watch(context: Context, order: Order, target: Target) -> Script[str]:
    """Monitor docked electrodes as is done while charging, until a stop condition is met; return that condition.

    Raises:
        DockingError: the problem; the caller retracts.
    """
    checks, context.closing = clearance_checks(context, order, target), Live(context.time)
    while True:
        if reason := order.is_met(context):
            context.decide("stop", reason, time_s=context.time - order.since)
            return reason
        yield next(checks)


def part(context: Context) -> Script[None]:
    """Retract: the only way to end the current."""
    yield from retract(context, wanted=True)
    context.status.docked = False
    context.enter(State.IDLE, math.inf)
