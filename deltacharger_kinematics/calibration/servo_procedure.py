# SPDX-License-Identifier: Apache-2.0
"""Measure the servos of an arm that stands free: from place to place, at rest in each, until the time is over."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.calibration.servo_arm import ServoArm, ServoTask, StaticReading
from deltacharger_kinematics.calibration.servo_fit import ServoFit, fit_servos
from deltacharger_kinematics.calibration.servo_plan import PosePlanner
from deltacharger_kinematics.calibration.servo_play import Play, sweep_play
from deltacharger_kinematics.calibration.servo_walk import ArmWalk

_FIRST_TURN, _TURN = 0.12, 0.03  # rad that a servo turns at least, before and after its friction is known
_ROUGH = 8  # readings, after which and every so many the model is fitted anew
_SURELY_TURNED = 0.015  # rad that an encoder shows, beyond any play
_AT_REST = 0.8  # of the time; the rest is for play


@dataclass(frozen=True)
class MeasuredArm:
    """What was measured of an arm's servos.

    Attributes:
        readings: at rest, in their order.
        fit: stiffness, torque constant and friction.
        play: between encoder and arm.
        seconds: that it took.
    """

    readings: tuple[StaticReading, ...]
    fit: ServoFit
    play: Play
    seconds: float


def measure_servos(arm: ServoArm, task: ServoTask, say: Callable[[float], None] = lambda share: None) -> MeasuredArm:
    """Measure the servos of an arm.

    Args:
        arm: with its torque on and nothing in its way.
        task: what is known of it.
        say: is told how far it is, as a share of 1.

    Raises:
        ServoTrouble: something is in the way, the arm does not come to rest, or the currents do not follow the weight.
    """
    walk, planner, readings = ArmWalk(arm, task), PosePlanner(task), list[StaticReading]()
    angles = _begin(walk, planner)
    while walk.spent < _AT_REST * task.seconds:
        say(walk.spent / task.seconds)
        turn = _TURN if walk.fitted else _FIRST_TURN
        way = planner.next(arm.goals(), angles, walk.model, turn, walk.settling + walk.reading_time)
        reading = _surely_turned(walk.visit(way), angles)
        angles = np.array(reading.angles)
        if not any(reading.directions):
            continue
        readings.append(reading)
        planner.learn(walk.loads(angles), reading.directions)
        if len(readings) % _ROUGH == 0:
            walk.learn(fit_servos(readings, task))
    fit = fit_servos(readings, task)
    walk.learn(fit)
    play = sweep_play(walk, planner, fit, max(task.seconds - walk.spent, 0.0))
    if not np.isnan(play.width).all():
        fit = fit_servos(readings, task, np.nan_to_num(play.width))
    say(1.0)
    return MeasuredArm(tuple(readings), fit, play, walk.spent)


def _begin(walk: ArmWalk, planner: PosePlanner) -> Array:
    """Look at how stiff the servos are, roughly, and go to the middle."""
    reading = walk.rest()
    walk.look(reading)
    for _ in range(2):  # the first way is led by a guess
        reading = walk.visit(planner.middle(np.array(reading.angles), walk.model))
        walk.look(reading)
    return np.array(reading.angles)


def _surely_turned(reading: StaticReading, before: Array) -> StaticReading:
    """Return a reading that counts for those servos alone that turned the way that was meant."""
    turned = np.subtract(reading.angles, before) * reading.directions
    first, second, third = (
        direction if turn > _SURELY_TURNED and math.isfinite(turn) else 0
        for direction, turn in zip(reading.directions, turned, strict=True)
    )
    return StaticReading(
        reading.goals, reading.angles, reading.currents, reading.current_errors, (first, second, third)
    )
