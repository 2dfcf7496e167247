# SPDX-License-Identifier: Apache-2.0
"""Measures the servos of a free arm: moves from place to place and reads at rest until the time is over."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.calibration.servo_arm import ServoArm, ServoTask, StaticReading
from deltacharger_kinematics.calibration.servo_fit import CONSTANT, STIFFNESS, ServoFit, fit_servos
from deltacharger_kinematics.calibration.servo_plan import PosePlanner
from deltacharger_kinematics.calibration.servo_play import Play, sweep_play
from deltacharger_kinematics.calibration.servo_walk import ArmWalk
from deltacharger_kinematics.swing import SwingReading, Swung, fit_swing

_FIRST_TURN, _TURN = 0.12, 0.03  # rad, smallest rotation of a servo before and after its friction is known
_ROUGH = 8  # readings between fits of the model
_SURELY_TURNED = 0.015  # rad of encoder rotation, more than any play
_SWING, _SWINGS = 0.9, 2  # A by which the goals jump, forward and back
_AT_REST = 0.8  # share of the time for readings at rest; the other share is for play


@dataclass(frozen=True)
class MeasuredArm:
    """Measured servos of an arm.

    Attributes:
        readings: at rest, in order.
        fit: stiffness, torque constant and friction.
        play: play between encoder and arm.
        swings: how each servo springs and brakes.
        seconds: duration of the measurement.
    """

    readings: tuple[StaticReading, ...]
    fit: ServoFit
    play: Play
    swings: tuple[Swung, Swung, Swung]
    seconds: float


def measure_servos(
    arm: ServoArm, task: ServoTask, progress: Callable[[float], None] = lambda share: None
) -> MeasuredArm:
    """Measure the servos of an arm.

    Args:
        arm: with torque on and free to move.
        task: known properties of the arm.
        progress: called with the share done, 0 to 1.

    Raises:
        ServoTrouble: the arm is blocked or does not come to rest, or the currents do not follow the weight.
    """
    walk, planner, readings = ArmWalk(arm, task), PosePlanner(task), list[StaticReading]()
    angles = _begin(walk, planner)
    while walk.spent < _AT_REST * task.seconds:
        progress(walk.spent / task.seconds)
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
    swings = _swing(walk, planner, fit)
    progress(1.0)
    return MeasuredArm(tuple(readings), fit, play, swings, walk.spent)


def _swing(walk: ArmWalk, planner: PosePlanner, fit: ServoFit) -> tuple[Swung, Swung, Swung]:
    """Let the arm swing in the middle, forward and back."""
    walk.visit(planner.middle(walk.arm.read(0.1).angles[-1], walk.model))
    turn = _SWING * float(fit.common(CONSTANT)[0] / fit.common(STIFFNESS)[0])
    rows: list[SwingReading] = []
    for sign in (1.0, -1.0) * _SWINGS:
        rows += walk.swing(sign * turn)
    return fit_swing(rows, float(fit.common(CONSTANT)[0]))


def _begin(walk: ArmWalk, planner: PosePlanner) -> Array:
    """Estimate the stiffness roughly, and move to the middle."""
    reading = walk.rest()
    walk.look(reading)
    for _ in range(2):  # the first move uses a guess
        reading = walk.visit(planner.middle(np.array(reading.angles), walk.model))
        walk.look(reading)
    return np.array(reading.angles)


def _surely_turned(reading: StaticReading, before: Array) -> StaticReading:
    """Return a reading that counts only for the servos that turned in the planned direction."""
    turned = np.subtract(reading.angles, before) * reading.directions
    first, second, third = (
        direction if turn > _SURELY_TURNED and math.isfinite(turn) else 0
        for direction, turn in zip(reading.directions, turned, strict=True)
    )
    return StaticReading(
        reading.goals, reading.angles, reading.currents, reading.current_errors, (first, second, third)
    )
