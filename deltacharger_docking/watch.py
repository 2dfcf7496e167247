# SPDX-License-Identifier: Apache-2.0
"""What is watched, in which phase.

Docking looks in every tick, before its script goes on, at a cause before its consequences: servo_node opens the
contactor if a servo fails, so the servos come before the power stage.
"""

import math
from collections.abc import Callable

from deltacharger_core.machine import LIVE_VOLTAGE, LONGEST_LEASE, ZERO_CURRENT
from deltacharger_docking import codes, contact
from deltacharger_docking.context import SAME_SAMPLE, SHOWS, YIELDS, Context, Live
from deltacharger_docking.parameters import TargetProfile

_FAULT_DELAY = 0.15  # s, longest delay of the fault report after a refused renewal
_PAUSE_MAX = 1.0  # s, longest pause of docking while the electrodes are live
_THERMAL_RESERVE_MIN = 5.0  # s, thermal reserve of a servo at which charging ends
FIRST_DATA_TIMEOUT = 3.0  # s, limit for the first data of nodes that have just started
_OVERCHARGES, _NEVER_FILLS = 0.1, 0.3  # V of a stage's constant voltage above and below the profile's full voltage
_ABOVE, _BELOW = 0.3, 1.0  # V that a charging target may be above full, and below empty while its load steps
_OVER, _BACK, _MUCH_BACK = 0.5, -0.5, -5.0  # A above the profile's; out of the target for 0.1 s, and at once
_COLLAPSED, _THIRD = 2.0, 1.0 / 3.0  # V, or share of a live port's voltage, that remains
_REVERSE, WELD = 6, 7  # ChargerPower.FAULT_REVERSE_CURRENT, FAULT_CONTACTOR_WELDED
_OUTSIDE = 0.002  # m beyond the workspace box; faultless dockings stay 0.1 mm within below, 20 mm elsewhere
_BESIDE = 0.030  # m beside its line; faultless dockings 14 at most, with worn gears
_LEAD_MAX = 0.003  # m that the command may lead the platform beyond what is explained
_PUSHED = 0.05  # s that the readings of a push must span
_VOLTAGE_TIME, _SAG_TIME = 0.1, 5.0  # s that a voltage may be off; that load may pull the charger's battery down
DEAD = 5.0  # V that electrodes in free air may have: snubbers and dividers leak
FADED, SURE = 1.0, 0.5  # s after an opening, until capacitors are empty; s of a voltage that is no spike


class Watches:
    """Looks at every input of docking, in every tick.

    Args:
        context: of docking.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._outside = math.inf  # m beyond the box at most since the torque is on
        self._looked = -math.inf  # s, at the electrodes in free air
        self._dead = -math.inf  # s, when electrodes in free air last had no voltage, or were not in free air
        self._free = -math.inf  # s, since when they have been in free air with the contactor open
        self._port = 0.0  # V of the port at most in this contact, with the contactor open
        self._collapse = math.inf  # s, date of the first charger_power that shows that it has gone

    def problem(self, interruptible: bool = True) -> codes.DockingError | None:
        """Return why the script must end now, if anything; on the way back only what forbids to move on."""
        state = self._context.status.state
        for look, phases, halts in WATCHES:
            if state in phases and (interruptible or halts) and (problem := look(self)) is not None:
                return problem
        return None

    def _astray(self) -> codes.DockingError | None:
        context = self._context
        seen, geometry = context.observation, context.kinematics.geometry
        if seen.stopped:
            return codes.Astray(f"servo_node stopped the arm: {seen.stopped}")
        box = zip(geometry.workspace_min, context.position, geometry.workspace_max, strict=True)
        outside = max(0.0, *(max(low - p, p - high) for low, p, high in box))  # a limp arm may hang there
        known, self._outside = self._outside, min(self._outside, outside) if seen.torque_enabled else outside
        if seen.torque_enabled and (beside := context.beside) > _BESIDE:
            goals = context.kinematics.inverse(*context.sent)
            errors = [abs(goal - angle) for goal, angle in zip(goals, context.angles, strict=True)]
            return codes.Astray(
                f"the arm is {1000 * beside:.0f} mm beside its line, servo {errors.index(max(errors)) + 1} farthest "
                "from its goal: look for what blocks or drags it, and at its horn, gear and cable"
            )
        if not seen.torque_enabled or not outside > known + _OUTSIDE:
            return None
        x, y, z = (1000.0 * value for value in context.position)
        return codes.Astray(
            f"the arm is at ({x:.0f}, {y:.0f}, {z:.0f}) mm, outside its workspace: look at its horns, rods and "
            "zero_ticks, and at what drags it"
        )

    def _unordered(self) -> codes.DockingError | None:
        """A contactor that was seen open is closed, carries current or is reported as welded, without an order."""
        context = self._context
        if not context.opened or context.parameters.always_live or not is_closed(context):
            return None
        return welded(context)

    def _live_in_air(self) -> codes.DockingError | None:
        context, seen = self._context, self._context.observation
        now, before, self._looked = context.time, self._looked, context.time
        unlooked = now - before > SURE  # in other phases
        if context.parameters.always_live or not context.opened or not context.is_free or unlooked:
            self._free = self._dead = now
        elif not seen.target_voltage > DEAD or now - self._free < FADED:
            self._dead = now
        if now - self._dead < SURE:
            return None
        told = f"the electrodes touch nothing but have {seen.target_voltage:.1f} V with the contactor open"
        return codes.ContactorWelded(f"{told}: switch the charger's battery off, and replace the contactor")

    def _servos_silent(self) -> codes.DockingError | None:
        seen = self._context.observation
        is_missing = self._is_missing(seen.servo_age, self._context.parameters.age_max)
        return seen.servo_silence() if is_missing else None

    def _hardware_error(self) -> codes.DockingError | None:
        bits = self._context.observation.hardware_error
        if not bits:
            return None
        return codes.ServoFailure(f"a servo reports hardware error {bits:#04x}: end the cause, then call reboot_servos")

    def _torque_lost(self) -> codes.DockingError | None:
        context, state = self._context, self._context.status.state
        moves = context.lets_go or context.feed.is_under_way(context.time)
        needed = moves or context.closing is not None or state in (*_TOUCHING, codes.State.ENERGISE)
        if context.observation.torque_enabled or not needed:
            return None
        return codes.ServoFailure("the servos lost their torque; see servo_node's diagnostics")

    def _pushes_too_hard(self) -> codes.DockingError | None:
        context, most = self._context, self._context.parameters.hard_current
        if context.lets_go or context.contact.span < _PUSHED or not context.contact.value > most:
            return None
        return codes.Overcurrent(f"contact current is {context.contact.value:.2f} A, above {most} A")

    def _gives_way(self) -> codes.DockingError | None:
        """The target rolls before the push, or takes the arm along by its magnets, which the push bound cannot stop."""
        context = self._context
        way, touching = context.position[2] - context.touched, context.observation.tactile_contact
        if context.lets_go or not (touching and way > YIELDS):
            return None
        if context.contact.value < -context.parameters.current_min:
            return codes.NoContact(f"the target moves away: it dragged the arm by {1000 * way:.0f} mm")
        return rolls(context, f"it gives way by {1000 * way:.0f} mm to a push of {context.contact.force:.0f} N")

    def _does_not_follow(self) -> codes.DockingError | None:
        if self._context.is_blind or not (lead := self._context.unexplained_lead) > _LEAD_MAX:
            return None
        back = self._context.touched - self._context.position[2]
        if self._context.observation.tactile_contact and back > _LEAD_MAX:
            return codes.NoContact(f"the target moves: it pushed the arm back by {1000 * back:.0f} mm")
        return codes.ServoFailure(
            f"the arm does not follow: its command leads it by {1000 * lead:.0f} mm more than the push explains; "
            "look for an obstacle, a cable that drags, or a servo that slips"
        )

    def _pads_silent(self) -> codes.DockingError | None:
        context, age = self._context, self._context.observation.tactile_age
        if not self._is_missing(age, context.parameters.age_max):
            return None
        if context.status.state in LIVE and context.closing is None:
            return None
        return codes.TactileStale("tactile frames stopped; check the board's cable and tactile_node")

    def _is_missing(self, age: float, oldest: float) -> bool:
        """Return whether data of this age (s) end the goal; nodes that have just started get FIRST_DATA_TIMEOUT.

        A node counts as starting if none of its data was measured since the goal began, even if earlier data arrived.
        """
        context = self._context
        since = context.time - context.started
        starting = age > since and context.status.state in _BEFORE_MOVING
        return age > oldest and not (starting and since < FIRST_DATA_TIMEOUT)

    def _paused(self) -> codes.DockingError | None:
        context, pause = self._context, self._context.pause
        if context.closing is None:
            return None
        context.closing.was_closed |= context.observation.contactor_closed or pause > LONGEST_LEASE  # which has lapsed
        if not pause > _PAUSE_MAX:
            return None
        return codes.PowerStale(f"docking was suspended for {pause:.1f} s while live; check this computer's load")

    def _bridged(self) -> codes.DockingError | None:
        """A bar bridges a live port: its voltage, which was there in this contact, has gone in two charger_power."""
        context, seen, profile = self._context, self._context.observation, self._context.profile
        held = seen.tactile_contact and not context.lets_go and context.closing is None and not seen.contactor_closed
        if profile is None or profile.port == "dead" or not held:
            self._port, self._collapse = 0.0, math.inf
            return None
        self._port, sampled = max(self._port, seen.target_voltage), context.time - seen.power_age  # NaN changes nothing
        was_live = self._port >= SHOWS * profile.empty_voltage
        if not (was_live and seen.target_voltage < max(_COLLAPSED, _THIRD * self._port)):
            self._collapse = math.inf
            return None
        self._collapse = min(self._collapse, sampled)
        if sampled <= self._collapse + SAME_SAMPLE:
            return None
        return codes.ShortCircuit(
            f"the port's voltage fell from {self._port:.1f} to {seen.target_voltage:.1f} V in contact: a bar bridges "
            "it, or the target switched itself off; check how the target stands, and its fuse"
        )

    def _fault(self) -> codes.DockingError | None:
        fault = self._context.observation.power_fault
        if self._context.closing is None or not fault:
            return None
        if fault == _REVERSE:
            much = self._context.observation.least_current < _MUCH_BACK
            return _flows_back("the power stage opened the contactor: current flowed", much)
        kind, words = codes.POWER_FAULTS.get(fault, (codes.PowerStale, f"fault {fault}"))
        return kind(f"the power stage opened the contactor: {words}")

    def _servos(self) -> codes.DockingError | None:
        return None if self._context.closing is None else servo_problem(self._context)

    def _power(self) -> codes.DockingError | None:
        context, live = self._context, self._context.closing
        if live is None or context.parameters.always_live:
            return None
        observation, parameters = context.observation, context.parameters
        refusal = observation.contactor_refusal
        if observation.power_age > parameters.age_max:
            return _power_silent()
        if refusal and not live.was_closed:
            return codes.NoChargeCurrent(f"the contactor was not closed: {refusal}")
        if refusal or live.refused:
            return self._refusal(live, refusal)
        if live.was_closed and not observation.contactor_closed:
            return self._lost("the contactor opened by itself: lease or heartbeat was lost; check the board's cable")
        if live.was_closed and not math.isfinite(observation.charge_current):
            return codes.PowerStale("the charge current is no longer measured; check the power stage")
        current, most = observation.charge_current, (context.profile.current if context.profile else 0.0) + _OVER
        flows = _flows_back(f"{current:.1f} A flow", current < _MUCH_BACK) if current < _BACK else None
        limit = f"{current:.1f} A exceed the limit of {most:.1f} A; have the power stage's limiter checked"
        much = codes.ChargeOvercurrent(limit) if current > most else None
        if current < _MUCH_BACK:
            return flows
        exceeds = self._lasting(live, "current", much, _VOLTAGE_TIME)
        return self._lasting(live, "reverse", flows, _VOLTAGE_TIME) or exceeds

    def _lasting(
        self, live: Live, name: str, problem: codes.DockingError | None, longest: float
    ) -> codes.DockingError | None:
        """Return a problem that lasts for more than so many seconds."""
        if problem is None:
            live.sound[name] = self._context.time
        return problem if self._context.time - live.sound[name] > longest else None

    def _refusal(self, live: Live, refusal: str) -> codes.DockingError | None:
        """Open at once; wait for charger_power to report the fault that may have caused the refusal."""
        context = self._context
        if not live.refused:
            live.refused, live.refused_at = refusal, context.time
            context.energise = False
        if context.time - live.refused_at <= _FAULT_DELAY:
            return None
        return self._lost(f"the contactor's lease was not renewed: {live.refused}")

    def _lost(self, how: str) -> codes.DockingError:
        """Return the error of a contactor that another node opened: servo_node does so if a servo does not answer."""
        seen = self._context.observation
        return codes.PowerStale(how) if seen.servos_valid else seen.servo_silence()

    def _voltages(self) -> codes.DockingError | None:
        """A voltage that is unknown or off for longer than a spike; the charger's battery may sag under load."""
        context, live = self._context, self._context.closing
        if live is None or not live.was_closed or context.profile is None:
            return None
        least = context.parameters.battery_voltage_min
        sags = context.observation.battery_voltage < least
        battery, longest = battery_problem(context, least), _SAG_TIME if sags else _VOLTAGE_TIME
        target = self._lasting(live, "target", target_problem(context, context.profile), _VOLTAGE_TIME)
        return self._lasting(live, "battery", battery, longest) or target

    def _contact(self) -> codes.DockingError | None:
        context = self._context
        if context.closing is None or context.observation.servo_age > contact.PRESS_AGE_MAX:
            return None
        if why := context.evidence_lost:
            return codes.NoContact(f"{why} while the electrodes were live; the target moved")
        return None


def _flows_back(flow: str, much: bool) -> codes.DockingError:
    """Return the error of a target that regenerates: unless much flowed, it may be tried again."""
    kind = codes.ReverseCurrent if much else codes.Regenerated
    return kind(f"{flow} out of the target: it brakes its wheels, or a second charger feeds it")


def is_closed(context: Context) -> bool:
    """Return whether the last measurement shows a closed contactor, current, or a weld."""
    seen = context.observation
    flows = abs(seen.charge_current) >= ZERO_CURRENT
    return seen.contactor_closed or flows or seen.power_fault == WELD


def welded(context: Context) -> codes.ContactorWelded:
    """Return the error of a contactor that is closed, or may be, although it was ordered to open or never to close."""
    observation, parameters = context.observation, context.parameters
    if observation.power_age > parameters.age_max:
        return codes.ContactorWelded("charger_power is silent: check the board, or switch the charger's battery off")
    if observation.power_fault == WELD and not observation.contactor_closed:
        how = "the board reports a welded contactor"
    else:
        how = f"the contactor is closed without an order (charge current {observation.charge_current:.1f} A)"
    reserve = observation.thermal_reserve
    lasts = f"; the arm can hold the electrodes for {reserve:.0f} s" if math.isfinite(reserve) else ""
    return codes.ContactorWelded(f"{how}: switch the charger's battery off by hand and replace the contactor{lasts}")


def reason_not_to_close(context: Context) -> codes.DockingError | None:
    """Return why the contactor must not close now."""
    observation, parameters = context.observation, context.parameters
    if observation.power_age > parameters.age_max:
        return _power_silent()
    if (unfit := battery_problem(context) or stage_problem(context)) is not None:
        return unfit
    if observation.tactile_age > parameters.age_max:
        return codes.TactileStale("tactile frames stopped; check the board's cable and tactile_node")
    if not observation.tactile_contact:
        return codes.NoTactileContact("the pads lost contact before the contactor was closed")
    if observation.duplicate_sources:
        return duplicate(observation.duplicate_sources)
    return unfit_servos(context)


def unfit_servos(context: Context) -> codes.DockingError | None:
    """Return why the servos must not begin to hold live electrodes, if anything."""
    seen = context.observation
    measured = (context.contact.value, *seen.angles, *seen.currents)  # contact.value lags: a median
    if not all(map(math.isfinite, measured)):
        return codes.ServoFailure("the servos' currents or angles are not measured; check the servo bus")
    return servo_problem(context)


def servo_problem(context: Context) -> codes.DockingError | None:
    """Return why the servos must not hold live electrodes, if anything."""
    observation = context.observation
    if observation.servo_age > context.parameters.live_servo_age_max:
        return observation.servo_silence()
    if not observation.torque_enabled:
        return codes.ServoFailure("the servos lost torque while electrodes were live; see servo_node's diagnostics")
    if not observation.thermal_reserve >= _THERMAL_RESERVE_MIN:
        return codes.ServoFailure("the servos' thermal reserve is used up; let them cool and dock again")
    return None


def battery_problem(context: Context, low: float | None = None) -> codes.DockingError | None:
    """Return why the charger's own battery must not be connected to the electrodes, if anything.

    Args:
        context: of docking.
        low: V at least; None = what closing needs.
    """
    low, high = context.parameters.battery_voltage_start if low is None else low, context.parameters.battery_voltage_max
    voltage = context.observation.battery_voltage
    if not math.isfinite(voltage):
        return codes.PowerStale("the voltage of the charger's own battery is not measured; check the power stage")
    if low <= voltage <= high:
        return None
    cure = "charge it" if voltage < low else "check it and its charger"
    return codes.VoltageOutOfRange(f"the charger's own battery has {voltage:.1f} V, not {low} to {high} V: {cure}")


def stage_problem(context: Context) -> codes.DockingError | None:
    """Return why the power stage does not fit the target's profile, if it does not."""
    profile, name = context.profile, context.profile_name
    if profile is None:
        return None
    volts, full = context.observation.stage_voltage, profile.full_voltage
    if volts > full + _OVERCHARGES or volts < full - _NEVER_FILLS:
        does = "would overcharge it" if volts > full else "could never fill it"
        told = f"the power stage is set to {volts:.1f} V, and profile {name} is full at {full:.1f} V"
        return codes.VoltageOutOfRange(f"{told}: the stage {does}; set its voltage, or send another target_profile")
    return None


def target_problem(context: Context, profile: TargetProfile) -> codes.DockingError | None:
    """Return why the voltage of a target that is being charged forbids current, if it does."""
    voltage, high = context.observation.target_voltage, profile.full_voltage + _ABOVE
    starts = (
        profile.port == "dead" and context.status.state is codes.State.ENERGISE
    )  # its own voltage may still be missing
    low = -math.inf if starts else profile.empty_voltage - _BELOW
    if not math.isfinite(voltage):
        return codes.PowerStale("the target's voltage is not measured; check the power stage's voltage divider")
    if voltage <= -LIVE_VOLTAGE:
        return codes.ReversePolarity(f"the target has {voltage:.1f} V: its electrodes are swapped")
    if low <= voltage <= high:
        return None
    allowed = f"{profile.empty_voltage:.1f} to {profile.full_voltage:.1f} V"
    return codes.VoltageOutOfRange(f"the target has {voltage:.1f} V; profile {context.profile_name}: {allowed}")


def duplicate(names: str) -> codes.DuplicateSource:
    """Return the error of a second source."""
    return codes.DuplicateSource(f"there is a second source: {names}; stop it, or give it its own namespace")


def rolls(context: Context, how: str) -> codes.TargetRolls:
    """Stop where the arm is, and return the error of a target that rolls."""
    context.hold()
    context.decide("rolls", how)
    return codes.TargetRolls(f"the target rolls: {how}; set its brakes, or the charger's")


def _power_silent() -> codes.PowerStale:
    return codes.PowerStale("charger_power stopped; check the board's cable and tactile_node")


_BEFORE_MOVING = (codes.State.LOCATE, codes.State.APPROACH)  # in APPROACH, `prepare` waits before anything moves
_TOUCHING = (codes.State.CONTACT, codes.State.MEASURE, codes.State.ALIGN)
LIVE = (
    codes.State.ENERGISE,
    codes.State.CHARGING,
    codes.State.IDLE,
)  # IDLE: docked; live if the electrodes are wired to the battery
_LIVE_PORT = (*_TOUCHING, codes.State.ENERGISE, codes.State.IDLE)  # from the touch until our contactor closes
_ALL = (*_BEFORE_MOVING, *_TOUCHING, *LIVE, codes.State.RETRACT)
_APART = (codes.State.APPROACH, codes.State.RETRACT)
_UNDER_TORQUE = (codes.State.APPROACH, *_TOUCHING, *LIVE, codes.State.RETRACT)

WATCHES: tuple[tuple[Callable[[Watches], codes.DockingError | None], tuple[codes.State, ...], bool], ...] = (
    (Watches._astray, _ALL, True),
    (Watches._unordered, _ALL, True),
    (Watches._live_in_air, _APART, True),
    (Watches._bridged, _LIVE_PORT, False),
    (Watches._paused, LIVE, False),
    (Watches._fault, LIVE, False),
    (Watches._servos_silent, _ALL, False),
    (Watches._hardware_error, _ALL, False),
    (Watches._servos, LIVE, False),
    (Watches._pushes_too_hard, _ALL, False),
    (Watches._gives_way, _TOUCHING, False),
    (Watches._does_not_follow, (codes.State.CONTACT,), False),
    (Watches._pads_silent, (codes.State.APPROACH, *_TOUCHING, *LIVE), False),
    (Watches._torque_lost, _UNDER_TORQUE, True),
    (Watches._power, LIVE, False),
    (Watches._voltages, LIVE, False),
    (Watches._contact, LIVE, False),
)
"""In this order: the look, its phases, and whether it ends the way back too."""
