# SPDX-License-Identifier: Apache-2.0
"""Energising: probe the target, close the contactor, and open it again."""

import math

from deltacharger_core import machine, script
from deltacharger_docking import clearance, codes, observation, watch
from deltacharger_docking.context import Context, Live
from deltacharger_docking.parameters import TargetProfile

OPEN_TIMEOUT = 1.0  # s, limit for current to stop after an order to open
_OPENING_TIME = 0.1  # s, delay of an order to open
_PROBE_TIMEOUT = 2.0  # s, limit for an answer of probe, longer than the board's own
_DUPLICATE_SOURCE_TIMEOUT = 25.0  # s, limit for second sources to disappear before the contactor closes

_CAUSE = 0.3  # s in which servo_state shows why servo_node opened the contactor, or that it ended (live_servo_age_max)
_LAST_WORD = 0.2  # s
NO_CURRENT = 0.05  # A, below it none flows, as the board counts
_CLOSES = 3.0  # s in which the power stage pre-charges and closes
_STEP = 0.5  # V that a stage which only steps down needs between battery and target
_LATER = 1.0, 0.3  # s by which the board waits longer for current than docking, at the start and in a gap


def wait_for_single_sources(
    context: Context, begun: float, state: codes.State = codes.State.MEASURE
) -> script.Script[None]:
    """Wait until each topic and service that docking uses has only one source.

    Args:
        context: of the docking.
        begun: s, from which _DUPLICATE_SOURCE_TIMEOUT counts, also for a source that comes and goes.
        state: during the wait; its checks stay active.

    Raises:
        DuplicateSource: there is still a second source after _DUPLICATE_SOURCE_TIMEOUT.
    """
    limit = _DUPLICATE_SOURCE_TIMEOUT
    context.enter(state, math.inf)
    if names := context.observation.duplicate_sources:
        context.decide("wait", f"nothing is energised while there is a second source: {names}", limit_s=limit)
    with context.waiting_for("a second source to disappear"):
        while (late := context.time - begun > limit) or context.observation.duplicate_sources:
            if late:
                raise watch.duplicate(context.doubtful)
            yield script.NEXT


def check_battery(context: Context) -> None:
    """Refuse an unfit battery or power stage before anything touches; without fresh data `energise` judges them.

    This protects the case of electrodes wired to an unmeasured battery: they would be live from the first contact.

    Raises:
        DockingError: as `energise`.
    """
    fresh = context.observation.power_age <= context.parameters.age_max
    if fresh and (unfit := watch.battery_problem(context) or watch.stage_problem(context)) is not None:
        raise unfit


def energise(context: Context) -> script.Script[bool]:
    """Probe, close the contactor and wait until charge current has been stable.

    Returns:
        False if the last measurement ceased to hold before the contactor closed; measure again.

    Raises:
        DockingError: with the code of the finding: short, polarity, voltage, a bar lifted by pitch, no current, or
            a fault of the power stage.
    """
    parameters, profile = context.parameters, context.profile
    assert profile is not None  # a goal that charges has one
    context.enter(codes.State.ENERGISE, math.inf)  # each of its steps has its limit
    if context.observation.power_fault not in (0, watch.WELD):
        yield from _clear_fault(context)
    reply = yield from context.ask(observation.Service.PROBE, codes.PowerStale, _PROBE_TIMEOUT)
    context.decide(
        "probe",
        f"the probe {'answered' if reply.success else 'failed: ' + reply.message}",
        resistance_ohm=reply.resistance,
        target_voltage_V=reply.target_voltage,
    )
    port = machine.port_of(reply.resistance, reply.target_voltage)
    if context.doubt or context.doubtful:
        return False
    if not reply.success:
        yield from _await_cause(context)
    _check_probe(context, profile, port, reply)
    if (problem := watch.reason_not_to_close(context)) is not None:
        raise problem
    context.decide("close", "all checks passed: the contactor is ordered to close")
    context.energise = context.live = True
    context.opened = False
    context.closing = Live(context.time, reply.target_voltage if port is machine.Port.LIVE else math.nan)
    later, gap = profile.start_time + _LATER[0], profile.gap_time + _LATER[1]
    context.limits = machine.ChargeLimits(profile.current, profile.full_voltage, profile.port == "dead", later, gap)
    with context.waiting_for(f"{parameters.charge_stable_time:g} s of charge current"):
        yield from _current_flows(context, profile)
    context.decide(
        "charging",
        f"charge current has been stable for {parameters.charge_stable_time:g} s",
        charge_current_A=context.observation.charge_current,
        target_voltage_V=context.observation.target_voltage,
    )
    return True


def _current_flows(context: Context, profile: TargetProfile) -> script.Script[None]:
    """Wait until at least `least_current` has flowed for `charge_stable_time`, without a gap beyond `gap_time`.

    Raises:
        NoChargeCurrent: the contactor does not close, the target does not connect, or it takes too little current.
    """
    stable = context.parameters.charge_stable_time
    closed, since, last = context.time + _CLOSES, math.inf, -math.inf  # s: when closed, flows since, flowed last
    while True:
        seen, now = context.observation, context.time
        closed = min(closed, now) if seen.contactor_closed else closed
        if seen.contactor_closed and seen.charge_current >= profile.least_current:
            since, last = min(since, now), now
            if now - since >= stable:
                return
        elif now - last > profile.gap_time:
            since = math.inf
            if now > closed + profile.start_time:
                found = f"Only {seen.charge_current:.2f} A" if seen.charge_current >= NO_CURRENT else "No current"
                raise codes.NoChargeCurrent(
                    f"{found} {profile.start_time:g} s after closing: the target has not connected, or is full; check "
                    f"its input, and start_time and least_current of profile {context.profile_name}"
                )
        yield script.Wait(since + stable, reads=True) if since < math.inf else script.NEXT


def _clear_fault(context: Context) -> script.Script[None]:
    """Open once to clear a fault that was latched before this docking; if it returns, docking ends."""
    yield from context.ask(observation.Service.OPEN, codes.PowerStale, _PROBE_TIMEOUT)
    yield from context.until(lambda: not context.observation.power_fault, OPEN_TIMEOUT)


def prove_dead(context: Context) -> script.Script[None]:
    """Let a voltage of electrodes in free air fade, or prove that the contactor is welded, which ends the goal."""
    end = context.time + watch.FADED + watch.SURE + _LAST_WORD
    while context.time < end and context.is_free and context.observation.target_voltage > watch.DEAD:
        yield script.NEXT


def de_energise(context: Context) -> script.Script[None]:
    """Open the contactor and confirm that no current flows.

    Raises:
        ContactorWelded: current still flows, or the power stage does not confirm that it stopped.
    """
    context.energise = context.status.charging = False
    context.closing = None
    if not (context.live or watch.is_closed(context)):
        context.opened = True
        return
    current = context.observation.charge_current
    context.decide("open", "the contactor is ordered to open", charge_current_A=current)
    begun = context.time
    while watch.is_closed(context) or not context.time - context.observation.power_age >= begun + _OPENING_TIME:
        if context.time > begun + OPEN_TIMEOUT:
            raise watch.welded(context)
        yield script.NEXT
    current = context.observation.charge_current
    context.decide("opened", "no current flows", charge_current_A=current, time_s=context.time - begun)
    context.live, context.opened = False, True


def _await_cause(context: Context) -> script.Script[None]:
    """Raise the servos' problem if one shows: servo_node opens the contactor if a servo fails, which ends a probe."""
    end = context.time + _CAUSE
    while context.time < end:
        if (problem := watch.unfit_servos(context)) is not None:
            raise problem
        yield script.NEXT


def _check_probe(context: Context, profile: TargetProfile, port: machine.Port, reply: observation.Reply) -> None:
    """Refuse to close on what lies at the electrodes, unless the profile expects it.

    Raises:
        DockingError: with the code of the finding.
    """
    name, voltage, seen = context.profile_name, reply.target_voltage, context.observation
    if not reply.success or port is machine.Port.UNKNOWN:
        raise codes.PowerStale(f"the probe failed: {reply.message or 'it measured nothing; check its wiring'}")
    if port is machine.Port.SHORT:
        raise codes.ShortCircuit(
            f"the probe found {reply.resistance:.2f} Ω between the electrodes; clean or realign them"
        )
    if port is machine.Port.REVERSED:
        raise codes.ReversePolarity(f"the target has {voltage:.1f} V: its electrodes are swapped")
    if port is machine.Port.LIVE and voltage >= watch.DEAD:  # less is a capacitor that an earlier probe has charged
        if not profile.empty_voltage <= voltage <= profile.full_voltage:
            allowed = f"{profile.empty_voltage:.1f} to {profile.full_voltage:.1f} V"
            raise codes.VoltageOutOfRange(
                f"the target has {voltage:.1f} V; profile {name} allows {allowed}: wrong robot or profile"
            )
        if not seen.stage_steps_up and voltage > seen.battery_voltage - _STEP:
            told = f"the target has {voltage:.1f} V, and the charger's battery {seen.battery_voltage:.1f} V"
            raise codes.VoltageOutOfRange(f"{told}, and its power stage only steps down: charge that battery")
    elif profile.port == "live":
        pitch = context.electrodes
        if port is machine.Port.OPEN and pitch and abs(pitch.pitch) > clearance.LEAN_SIGMAS * pitch.pitch_stddev:
            raise codes.Leaning(
                f"no current flows into the port; the electrodes' faces are pitched by "
                f"{math.degrees(pitch.pitch):+.1f}° about x of charger_base, so one bar does not press: level "
                "the target or the charger"
            )
        dirt = (
            ""
            if port is machine.Port.DEAD
            else ", or clean the electrodes and check that no pitch of the faces lifts a bar"
        )
        told = f"the port has no voltage ({reply.resistance:.3g} Ω), but profile {name} says it is live"
        raise codes.NoChargeCurrent(f"{told}: wake the target, or set port: dead in the profile{dirt}")
