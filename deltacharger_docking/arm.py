# SPDX-License-Identifier: Apache-2.0
"""The arm before and after a docking: enabled and tared, pulled off the magnets, taken home, switched off."""

from __future__ import annotations

import math

from deltacharger_docking.codes import ServoFailure, State, Stuck, TactileStale
from deltacharger_docking.context import Context
from deltacharger_docking.energy import de_energise
from deltacharger_docking.observation import Service
from deltacharger_docking.release import take_off
from deltacharger_docking.script import NEXT, Script

_OFF_TIME = 0.1  # s that servo_node needs to switch the torque off: some of its cycles


def prepare(context: Context) -> Script[None]:
    """Switch the torque on and tare the pads, both in free air; nodes that have just started are waited for."""
    parameters = context.parameters
    context.enter(State.APPROACH, parameters.approach_timeout)
    end = context.time + parameters.first_data_timeout
    while context.time <= end and (_servos_silent(context) or _pads_silent(context)):
        yield NEXT
    if _servos_silent(context):
        raise ServoFailure("servo_state is missing or stale; is servo_node running and its bus connected?")
    if _pads_silent(context):
        raise TactileStale("no tactile frames; check the board's cable and tactile_node")
    yield from de_energise(context)  # nothing is pulled off a contactor that welded in an earlier goal
    context.commanded = context.position
    if not context.observation.torque_enabled:
        yield from torque_on(context)
        while not context.observation.torque_enabled:
            yield NEXT
    context.commanded = context.position
    # After a restart nobody remembers having docked; the pads do.
    if context.status.docked or (context.observation.tared and context.observation.tactile_contact):
        yield from lift_off(context)
    reply = yield from context.ask(Service.TARE, TactileStale, context.parameters.service_timeout)
    if not reply.success:
        raise TactileStale(f"the pads were not tared: {reply.message}; they must be free before docking")
    context.decide("tared", "the pads are tared in free air")


def _servos_silent(context: Context) -> bool:
    return context.observation.servo_age > context.parameters.servo_age_max


def _pads_silent(context: Context) -> bool:
    return context.observation.tactile_age > context.parameters.tactile_age_max


def torque_on(context: Context) -> Script[None]:
    """Enable the servos where they are.

    Raises:
        ServoFailure: they were not enabled.
    """
    reply = yield from context.ask(Service.TORQUE_ON, ServoFailure, context.parameters.service_timeout)
    if not reply.success:
        raise ServoFailure(f"the servos were not enabled: {reply.message}")


def retract(context: Context, wanted: bool = False) -> Script[None]:
    """Open, confirm, release the magnets, go home and switch the torque off.

    Args:
        context: shared state.
        wanted: whether a client asked for it; then a limp arm away from home is switched on too.
    """
    parameters = context.parameters
    context.enter(State.RETRACT, math.inf)
    yield from de_energise(context)  # has its own limit: no time runs out while electrodes may be live
    context.deadline = context.time + parameters.retract_timeout
    while parameters.press_age_max < context.observation.servo_age <= parameters.servo_age_max:
        yield NEXT
    observation = context.observation
    if observation.servo_age > parameters.servo_age_max or observation.hardware_error:
        context.status.docked &= observation.tactile_contact  # the magnets still hold it
        yield from let_go(context)
        return
    if not math.isfinite(context.position[2]):
        raise ServoFailure("the arm's position is unknown, so it was not moved")
    strayed = wanted and math.dist(context.position, parameters.home) > parameters.lift
    needed = strayed or observation.tactile_contact
    if needed and not observation.torque_enabled:
        yield from torque_on(context)
    if needed or observation.torque_enabled:
        yield from lift_off(context, pull=strayed and not observation.torque_enabled)
        yield from context.move(parameters.home, parameters.travel_speed, settle=False)
        yield from context.wait(parameters.settle_time)
        away = math.dist(context.position, parameters.home)
        context.decide("retracted", "the arm is home" if away <= parameters.lift else "the arm stayed", away_m=away)
        if away > parameters.lift:
            raise Stuck(f"the arm stayed {1000 * away:.0f} mm from home; free it from the target by hand")
    context.status.docked = False
    reply = yield from context.ask(Service.TORQUE_OFF, ServoFailure, context.parameters.service_timeout)
    if not reply.success:
        raise ServoFailure(f"the servos' torque was not switched off: {reply.message}")
    context.decide("limp", "the servos' torque is off")


def let_go(context: Context) -> Script[None]:
    """Stop, and switch the torque off without insisting on an answer; IDLE follows when it should be off."""
    context.hold()
    context.decide("limp", "the servos are told to let go where the arm is")
    context.tell(Service.TORQUE_OFF)
    yield from context.wait(_OFF_TIME)


def lift_off(context: Context, pull: bool = False) -> Script[None]:
    """Pull off the magnets where there is contact or `pull` says so, then go straight back, to move sideways."""
    parameters = context.parameters
    x, y, z = context.measured()
    clear = min(max(z - parameters.lift, parameters.home_z), z)
    if pull or context.observation.tactile_contact or abs(context.contact.value) > parameters.free_current:
        yield from take_off(context, clear)
    else:
        context.commanded = x, y, z
        yield from context.move((x, y, clear), parameters.travel_speed, settle=False)
    context.status.docked = False
