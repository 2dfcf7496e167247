# SPDX-License-Identifier: Apache-2.0
"""Retracting: open the contactor, confirm it, release the magnets, go home, switch the torque off."""

from __future__ import annotations

import math

from deltacharger_core.script import NEXT, Script
from deltacharger_docking.codes import ServoFailure, State, Stuck
from deltacharger_docking.context import REACH, SERVICE_TIMEOUT, Context
from deltacharger_docking.energy import de_energise, prove_dead
from deltacharger_docking.evidence import PRESS_AGE_MAX
from deltacharger_docking.observation import Service
from deltacharger_docking.release import LIFT, lift_off, rolls, touches

RETRACT_TIMEOUT = 20.0  # s, limit for RETRACT
_OFF_TIME = 0.1  # s: servo_node switches the torque off within some cycles


def retract(context: Context, wanted: bool = False) -> Script[None]:
    """Open the contactor, confirm it, release the magnets, go home and switch the torque off.

    Args:
        context: shared state.
        wanted: a client requested it; then the torque is also switched on for a limp arm away from home.
    """
    parameters = context.parameters
    context.enter(State.RETRACT, math.inf)
    context.evidence.forget()
    yield from de_energise(context)  # has its own limit: the phase must not expire while electrodes may be live
    if wanted:
        yield from context.answered()
    context.deadline = context.time + RETRACT_TIMEOUT
    while PRESS_AGE_MAX < context.observation.servo_age <= parameters.servo_age_max:
        yield NEXT
    observation = context.observation
    if observation.servo_age > parameters.servo_age_max or observation.hardware_error:
        context.status.docked &= observation.tactile_contact  # the magnets still hold it
        yield from go_limp(context)
        return
    if not math.isfinite(context.position[2]):
        raise ServoFailure("the arm's position is unknown, so it was not moved; check the servo bus and servo_node")
    strayed = wanted and math.dist(context.position, parameters.home) > LIFT
    needed = strayed or observation.tactile_contact
    if needed and not observation.torque_enabled:
        yield from context.torque_on()
    if needed or observation.torque_enabled:
        begun = context.time
        yield from lift_off(context, pull=strayed and not observation.torque_enabled)
        context.touched = math.nan
        yield from context.move(parameters.home, parameters.travel_speed, settle=False)
        yield from context.wait(context.springs.settle_time)
        if touches(context) or context.touched - context.felt > REACH:  # at the end it may touch too lightly to feel
            raise rolls(context, "it followed the arm home")
        away = math.dist(context.position, parameters.home)
        context.decide("retracted", "the arm is home" if away <= LIFT else "the arm stayed", away_m=away)
        if away > LIFT:
            context.check_moved(begun)
            raise Stuck(
                f"the arm stayed {1000 * away:.0f} mm from home; free it from the target by hand"
                f"{context.springs.contradiction}"
            )
    context.status.docked = False
    yield from prove_dead(context)
    reply = yield from context.ask(Service.TORQUE_OFF, ServoFailure, SERVICE_TIMEOUT)
    if not reply.success:
        raise ServoFailure(f"the servos' torque was not switched off: {reply.message}")
    # Otherwise the next goal could read an old servo_state and send a trajectory to limp servos.
    end = context.time + parameters.servo_age_max
    while context.observation.torque_enabled:
        if context.time > end:
            raise ServoFailure("servo_state still reports torque on; check servo_node, or cut the servos' power")
        yield NEXT
    context.decide("limp", "the servos' torque is off")
    if touches(context):  # it rolled on until now
        raise rolls(context, "it followed the arm home")


def go_limp(context: Context) -> Script[None]:
    """Hold, order the torque off without waiting for the reply, and wait until servo_node must have done it."""
    context.hold()
    context.decide("limp", "the servos are ordered to switch their torque off where the arm is")
    context.send(Service.TORQUE_OFF)
    yield from context.wait(_OFF_TIME)
