# SPDX-License-Identifier: Apache-2.0
"""Energising: probe the target, close the contactor, and open it again."""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Script, Wait
from deltacharger_docking.codes import DockingError, Leaning, NoChargeCurrent, PowerStale, ShortCircuit, State
from deltacharger_docking.context import Context, Live
from deltacharger_docking.observation import Reply, Service
from deltacharger_docking.watch import (
    DEAD,
    FADED,
    SURE,
    WELD,
    battery_problem,
    duplicate,
    is_closed,
    reason_not_to_close,
    servo_problem,
    voltage_problem,
    welded,
)

_CAUSE = 0.3  # s in which servo_state shows why servo_node opened the contactor, or that it ended (live_servo_age_max)
_LAST_WORD = 0.2  # s before the phase ends: time to report why no current flows


def wait_for_single_sources(context: Context, begun: float, state: State = State.MEASURE) -> Script[None]:
    """Wait until each topic and service that docking uses has only one source.

    Args:
        context: of the docking.
        begun: s, from which duplicate_source_timeout counts, also for a source that comes and goes.
        state: during the wait; its checks stay active.

    Raises:
        DuplicateSource: there is still a second source after duplicate_source_timeout.
    """
    limit = context.parameters.duplicate_source_timeout
    context.enter(state, math.inf)
    if names := context.observation.duplicate_sources:
        context.decide("wait", f"nothing is energised while there is a second source: {names}", limit_s=limit)
    with context.waiting_for("a second source to disappear"):
        while (late := context.time - begun > limit) or context.observation.duplicate_sources:
            if late:
                raise duplicate(context.doubtful)
            yield NEXT


def check_battery(context: Context) -> None:
    """Refuse a battery that is unfit or unmeasured before anything touches; without fresh data `energise` judges it.

    This protects the case of electrodes wired to an unmeasured battery: they would be live from the first contact.

    Raises:
        DockingError: as `energise`.
    """
    fresh = context.observation.power_age <= context.parameters.power_age_max
    if fresh and (unfit := battery_problem(context)) is not None:
        raise unfit


def energise(context: Context) -> Script[bool]:
    """Probe, close the contactor and wait until charge current has been stable.

    Returns:
        False if the last measurement ceased to hold before the contactor closed; measure again.

    Raises:
        DockingError: with the code of the finding: short, polarity, voltage, a bar lifted by pitch, no current, or
            a fault of the power stage.
    """
    parameters = context.parameters
    context.enter(State.ENERGISE, parameters.energise_timeout)
    if context.observation.power_fault not in (0, WELD):
        yield from _clear_fault(context)
    reply = yield from context.ask(Service.PROBE, PowerStale, parameters.probe_timeout)
    context.decide(
        "probe",
        f"the probe {'answered' if reply.success else 'failed: ' + reply.message}",
        resistance_ohm=reply.resistance,
        target_voltage_V=reply.target_voltage,
    )
    if context.doubt or context.doubtful:
        return False
    if not reply.success:
        yield from _await_cause(context)
    _check_probe(context, reply)
    if (problem := reason_not_to_close(context)) is not None:
        raise problem
    context.decide("close", "all checks passed: the contactor is ordered to close")
    context.energise = context.live = True
    context.opened, context.closing = False, Live(context.time)
    with context.waiting_for(f"{parameters.charge_stable_time:g} s of charge current"):
        yield from _current_flows(context)
    context.decide(
        "charging",
        f"charge current has been stable for {parameters.charge_stable_time:g} s",
        charge_current_A=context.observation.charge_current,
        target_voltage_V=context.observation.target_voltage,
    )
    return True


def _current_flows(context: Context) -> Script[None]:
    parameters, stable_since = context.parameters, math.inf
    while context.time - stable_since < parameters.charge_stable_time:
        if context.time > context.deadline - _LAST_WORD:
            raise NoChargeCurrent(no_current(context))
        flowing = context.observation.contactor_closed and (
            context.observation.charge_current >= parameters.charge_current_min
        )
        stable_since = min(stable_since, context.time) if flowing else math.inf
        yield Wait(stable_since + parameters.charge_stable_time, reads=True) if flowing else NEXT


def _clear_fault(context: Context) -> Script[None]:
    """Open once to clear a fault that was latched before this docking; if it returns, docking ends."""
    yield from context.ask(Service.OPEN, PowerStale, context.parameters.probe_timeout)
    end = context.time + context.parameters.open_timeout
    while context.observation.power_fault and context.time < end:
        yield NEXT


def prove_dead(context: Context) -> Script[None]:
    """Let a voltage of electrodes in free air fade, or prove that the contactor is welded, which ends the goal."""
    end = context.time + FADED + SURE + _LAST_WORD
    while context.time < end and context.is_free and context.observation.target_voltage > DEAD:
        yield NEXT


def de_energise(context: Context) -> Script[None]:
    """Open the contactor and confirm that no current flows.

    Raises:
        ContactorWelded: current still flows, or the power stage does not confirm that it stopped.
    """
    context.energise = context.status.charging = False
    context.closing = None
    if not (context.live or is_closed(context)):
        context.opened = True
        return
    current = context.observation.charge_current
    context.decide("open", "the contactor is ordered to open", charge_current_A=current)
    begun, parameters = context.time, context.parameters
    while is_closed(context) or not context.time - context.observation.power_age >= begun + parameters.opening_time:
        if context.time > begun + parameters.open_timeout:
            raise welded(context)
        yield NEXT
    current = context.observation.charge_current
    context.decide("opened", "no current flows", charge_current_A=current, time_s=context.time - begun)
    context.live, context.opened = False, True


def _await_cause(context: Context) -> Script[None]:
    """Raise the servos' problem if one shows: servo_node opens the contactor if a servo fails, which ends a probe."""
    end = context.time + _CAUSE
    while context.time < end:
        if (problem := servo_problem(context)) is not None:
            raise problem
        yield NEXT


def _open_circuit(context: Context) -> DockingError:
    """Return why touching electrodes do not conduct: if a known pitch lifts a bar, that; else dirt."""
    seen, found = context.electrodes, "the probe found an open circuit: the electrodes touch but do not conduct"
    if seen is not None and abs(seen.pitch) > context.parameters.lean_sigmas * seen.pitch_stddev:
        return Leaning(
            f"{found}; their faces are pitched by {math.degrees(seen.pitch):+.1f}° about x of charger_base, so one bar "
            "does not press: level the target or the charger"
        )
    return NoChargeCurrent(f"{found}; clean them, and check that no pitch of the faces lifts a bar")


def _check_probe(context: Context, reply: Reply) -> None:
    parameters = context.parameters
    if not reply.success:
        raise PowerStale(f"the probe failed: {reply.message}")
    if reply.resistance < parameters.probe_resistance_min:
        raise ShortCircuit(f"the probe found {reply.resistance:.2f} Ω between the electrodes; clean or realign them")
    if not math.isfinite(reply.resistance) or not math.isfinite(reply.target_voltage):
        raise _open_circuit(context)
    if (problem := voltage_problem(context, reply.target_voltage)) is not None:
        raise problem


def no_current(context: Context) -> str:
    """Return the message that no charge current flows."""
    contactor = "closed" if context.observation.contactor_closed else "open"
    return (
        f"charge current is {context.observation.charge_current:.2f} A with the contactor {contactor}; the target may "
        "be full, or its input switched off"
    )
