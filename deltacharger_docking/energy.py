# SPDX-License-Identifier: Apache-2.0
"""Energising: probe the target, close the contactor, monitor the conditions, and open it as soon as one fails."""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Script, Wait
from deltacharger_docking.codes import (
    POWER_FAULTS,
    SILENT_SERVOS,
    ChargeOvercurrent,
    ContactorWelded,
    DockingError,
    DuplicateSource,
    Leaning,
    NoChargeCurrent,
    NoContact,
    NoTactileContact,
    PowerStale,
    ReverseCurrent,
    ReversePolarity,
    ServoFailure,
    ShortCircuit,
    State,
    TactileStale,
    VoltageOutOfRange,
)
from deltacharger_docking.context import Context
from deltacharger_docking.observation import Reply, Service

_LAST_WORD = 0.2  # s before the phase ends: time to report why no current flows


def wait_for_single_sources(context: Context, state: State = State.MEASURE) -> Script[None]:
    """Wait until each topic and service that docking uses has only one source.

    Args:
        context: of the docking.
        state: during the wait; its checks stay active.

    Raises:
        DuplicateSource: there is still a second source after duplicate_source_timeout.
    """
    limit = context.parameters.duplicate_source_timeout
    context.enter(state, math.inf)
    begun = context.time
    if names := context.observation.duplicate_sources:
        context.decide("wait", f"nothing is energised while there is a second source: {names}", limit_s=limit)
    with context.waiting_for("a second source to disappear"):
        while names := context.observation.duplicate_sources:
            if context.time - begun > limit:
                raise _duplicate(names)
            yield NEXT


def _duplicate(names: str) -> DuplicateSource:
    return DuplicateSource(
        f"energising is refused because there is a second source: {names}; stop the second node, or give it its "
        "own namespace or ROS_DOMAIN_ID"
    )


def check_battery(context: Context) -> None:
    """Refuse a battery that is unfit or unmeasured before anything touches; without fresh data `energise` judges it.

    This protects the case of electrodes wired to an unmeasured battery: they would be live from the first contact.

    Raises:
        DockingError: as `energise`.
    """
    if context.observation.power_age <= context.parameters.power_age_max:
        unfit = _battery_problem(context)
        if unfit is not None:
            raise unfit


def energise(context: Context) -> Script[None]:
    """Probe, close the contactor and wait until charge current has been stable.

    Raises:
        DockingError: with the code of the finding: short, polarity, voltage, a bar lifted by pitch, no current, or
            a fault of the power stage.
    """
    parameters = context.parameters
    context.enter(State.ENERGISE, parameters.energise_timeout)
    if context.observation.power_fault:
        yield from _clear_fault(context)
    reply = yield from context.ask(Service.PROBE, PowerStale, parameters.probe_timeout)
    context.decide(
        "probe",
        f"the probe {'answered' if reply.success else 'failed: ' + reply.message}",
        resistance_ohm=reply.resistance,
        target_voltage_V=reply.target_voltage,
    )
    _check_probe(context, reply)
    watch = Watch(context)
    problem = watch.reason_not_to_close()
    if problem is not None:
        raise problem
    context.decide("close", "all checks passed: the contactor is ordered to close")
    context.energise = context.live = True
    with context.waiting_for(f"{parameters.charge_stable_time:g} s of charge current"):
        yield from _current_flows(context, watch)
    context.decide(
        "charging",
        f"charge current has been stable for {parameters.charge_stable_time:g} s",
        charge_current_A=context.observation.charge_current,
        target_voltage_V=context.observation.target_voltage,
    )


def _current_flows(context: Context, watch: Watch) -> Script[None]:
    parameters, stable_since = context.parameters, math.inf
    while context.time - stable_since < parameters.charge_stable_time:
        problem = watch.problem()
        if problem is None and context.time > context.deadline - _LAST_WORD:
            problem = NoChargeCurrent(no_current(context))
        if problem is not None:
            raise problem
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


def de_energise(context: Context) -> Script[None]:
    """Open the contactor and confirm that no current flows.

    Raises:
        ContactorWelded: current still flows, or the power stage does not confirm that it stopped.
    """
    context.energise = context.status.charging = False
    if not (context.live or _is_closed(context)):
        return
    current = context.observation.charge_current
    context.decide("open", "the contactor is ordered to open", charge_current_A=current)
    begun, parameters = context.time, context.parameters
    while _is_closed(context) or not context.time - context.observation.power_age >= begun + parameters.opening_time:
        if context.time > begun + parameters.open_timeout:
            raise _welded(context)
        yield NEXT
    current = context.observation.charge_current
    context.decide("opened", "no current flows", charge_current_A=current, time_s=context.time - begun)
    context.live = False


def _welded(context: Context) -> ContactorWelded:
    if context.observation.power_age > context.parameters.power_age_max:
        return ContactorWelded(
            "charger_power is silent, so the contactor may still be closed; the arm stays on the target: check the "
            "board's cable and tactile_node, or switch the charger's battery off"
        )
    return ContactorWelded(
        f"the contactor has not opened {context.parameters.open_timeout:g} s after the order (charge current "
        f"{context.observation.charge_current:.1f} A); switch the charger's battery off and replace the contactor"
    )


def _is_closed(context: Context) -> bool:
    """Return whether the last measurement shows a closed contactor or current."""
    observation = context.observation
    return observation.contactor_closed or abs(observation.charge_current) >= context.parameters.zero_current


class Watch:
    """Conditions that must hold while the contactor is closed.

    Attributes:
        refused: why a renewal of the lease was refused; '' if none was.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._z = context.position[2]
        self._was_closed = False
        self._refused_at = math.inf
        self.refused = ""

    def reason_not_to_close(self) -> DockingError | None:
        """Return why the contactor must not close now; after closing, `problem` checks."""
        context, observation = self._context, self._context.observation
        if observation.power_age > context.parameters.power_age_max:
            return PowerStale("charger_power stopped; check the board's cable and tactile_node")
        if (unfit := _battery_problem(context)) is not None:
            return unfit
        if observation.tactile_age > context.parameters.tactile_age_max:
            return TactileStale("tactile frames stopped; check the board's cable and tactile_node")
        if not observation.tactile_contact:
            return NoTactileContact("the pads lost contact before the contactor was closed")
        if observation.duplicate_sources:
            return _duplicate(observation.duplicate_sources)
        return self._servo_problem() or self._contact_problem()

    def problem(self) -> DockingError | None:
        """Return the present problem, if any; a cause is checked before its consequences.

        servo_node opens the contactor if a servo fails, so the servos are checked before the contactor.
        """
        observation = self._context.observation
        self._was_closed |= observation.contactor_closed
        if (problem := self._pause_problem()) is not None:
            return problem
        if observation.power_fault:
            kind, words = POWER_FAULTS.get(observation.power_fault, (PowerStale, f"fault {observation.power_fault}"))
            return kind(f"the power stage opened the contactor: {words}")
        return self._servo_problem() or self._power_problem() or self._contact_problem()

    def problem_unmeasured(self) -> DockingError | None:
        """Return the present problem without measurements of the current: by arm and pads alone."""
        observation, parameters = self._context.observation, self._context.parameters
        if (problem := self._pause_problem()) is not None:
            return problem
        if observation.tactile_age > parameters.tactile_age_max:
            return TactileStale(
                "tactile frames stopped while the electrodes were live; check the board's cable and tactile_node"
            )
        return self._servo_problem() or self._contact_problem()

    def _pause_problem(self) -> DockingError | None:
        pause = self._context.pause
        if not pause > self._context.parameters.pause_max:
            return None
        return PowerStale(
            f"docking itself was suspended for {pause:.1f} s while the electrodes were live; check what else this "
            "computer runs"
        )

    def _servo_problem(self) -> DockingError | None:
        context, observation = self._context, self._context.observation
        if observation.servo_age > context.parameters.live_servo_age_max:
            return ServoFailure(f"servo_state stopped while the electrodes were live; {SILENT_SERVOS}")
        measured = (context.contact.value, *observation.angles, *observation.currents)  # contact.value lags: a median
        if not all(map(math.isfinite, measured)):
            return ServoFailure("the servos' currents or angles are no longer measured; check the servo bus")
        if not observation.torque_enabled:
            return ServoFailure("the servos lost their torque while electrodes were live; see servo_node's diagnostics")
        if not observation.thermal_reserve >= context.parameters.thermal_reserve_min:
            return ServoFailure("the servos' thermal reserve is used up; let them cool and dock again")
        return None

    def _power_problem(self) -> DockingError | None:
        observation, parameters = self._context.observation, self._context.parameters
        refusal = observation.contactor_refusal
        if observation.power_age > parameters.power_age_max:
            return PowerStale("charger_power stopped; check the board's cable and tactile_node")
        if refusal and not self._was_closed:
            return NoChargeCurrent(f"the contactor was not closed: {refusal}")
        if refusal or self.refused:
            return self._refusal(refusal)
        if self._was_closed and not observation.contactor_closed:
            return PowerStale("the contactor opened by itself: lease or heartbeat was lost; check the board's cable")
        if self._was_closed and not math.isfinite(observation.charge_current):
            return PowerStale("the charge current is no longer measured; check the power stage")
        if observation.charge_current < -parameters.zero_current:
            flow = f"{observation.charge_current:.1f} A flow out of the target"
            return ReverseCurrent(f"{flow}; have its charging input checked")
        if observation.charge_current > parameters.charge_current_max:
            return ChargeOvercurrent(
                f"{observation.charge_current:.1f} A exceed the limit of {parameters.charge_current_max} A; have the "
                "power stage's limiter checked"
            )
        return None

    def _refusal(self, refusal: str) -> DockingError | None:
        """Open at once; wait for charger_power to report the fault that may have caused the refusal."""
        context = self._context
        if not self.refused:
            self.refused, self._refused_at = refusal, context.time
            context.energise = False
        if context.time - self._refused_at <= context.parameters.fault_delay:
            return None
        return PowerStale(f"the contactor's lease was not renewed: {self.refused}")

    def _contact_problem(self) -> DockingError | None:
        context, parameters = self._context, self._context.parameters
        if context.observation.servo_age > parameters.press_age_max:
            return None
        lowest, contact = self._z - parameters.contact_lost_retreat, context.contact
        if contact.value + contact.currents_error < parameters.contact_lost_current or context.position[2] < lowest:
            return NoContact("contact was lost while the electrodes were live; the target moved")
        return None


def _open_circuit(context: Context) -> DockingError:
    """Return why touching electrodes do not conduct: if a known pitch lifts a bar, that; else dirt."""
    seen, found = context.electrodes, "the probe found an open circuit: the electrodes touch but do not conduct"
    if seen is not None and abs(seen.pitch) > context.parameters.lean_sigmas * seen.pitch_stddev:
        return Leaning(
            f"{found}; their faces are pitched by {math.degrees(seen.pitch):+.1f}° about x of charger_base, so one bar "
            "does not press: level the target or the charger"
        )
    return NoChargeCurrent(f"{found}; clean them, and check that no pitch of the faces lifts a bar")


def _battery_problem(context: Context) -> DockingError | None:
    """Return why the charger's own battery must not be connected to the electrodes, if anything."""
    low, high = context.parameters.battery_voltage_min, context.parameters.battery_voltage_max
    voltage = context.observation.battery_voltage
    if not math.isfinite(voltage):
        return PowerStale(
            "the voltage of the charger's own battery is not measured, so nothing is energised; check the power "
            "stage's plug and voltage divider, or set power to none if the electrodes are wired to the battery"
        )
    if low <= voltage <= high:
        return None
    cure = "charge it" if voltage < low else "check it and its charger"
    return VoltageOutOfRange(
        f"the charger's own battery has {voltage:.1f} V; allowed are {low} to {high} V: {cure}, or check the voltage "
        "divider"
    )


def _check_probe(context: Context, reply: Reply) -> None:
    parameters = context.parameters
    if not reply.success:
        raise PowerStale(f"the probe failed: {reply.message}")
    if reply.resistance < parameters.probe_resistance_min:
        raise ShortCircuit(f"the probe found {reply.resistance:.2f} Ω between the electrodes; clean or realign them")
    if not math.isfinite(reply.resistance) or not math.isfinite(reply.target_voltage):
        raise _open_circuit(context)
    if reply.target_voltage < 0.0:
        raise ReversePolarity(f"the probe found {reply.target_voltage:.1f} V: the target's electrodes are swapped")
    if not parameters.target_voltage_min <= reply.target_voltage <= parameters.target_voltage_max:
        raise VoltageOutOfRange(
            f"the target has {reply.target_voltage:.1f} V; allowed are {parameters.target_voltage_min} to "
            f"{parameters.target_voltage_max} V"
        )


def no_current(context: Context) -> str:
    """Return the message that no charge current flows."""
    contactor = "closed" if context.observation.contactor_closed else "open"
    return (
        f"charge current is {context.observation.charge_current:.2f} A with the contactor {contactor}; the target may "
        "be full, or its input switched off"
    )
