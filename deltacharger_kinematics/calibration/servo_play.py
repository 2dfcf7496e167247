# SPDX-License-Identifier: Apache-2.0
"""Measures the play between a servo's encoder and its arm, at places where friction alone can hold the arm.

A loaded servo does not reveal its play: the encoder stays on one side of it, and goal − angle is still torque over
stiffness. If its share of the weight is smaller than its friction, the goal can sweep from one side to the other while
the arm stands still. The torque then falls from (L + f) / (1 − g) to 0, stays there while the goal crosses the play,
and falls on to (L − f) / (1 − g), with f and g of `servo_fit`. The width of that step is the play. Sweeps in both
directions at several places move in whole ticks. The result is mean and spread of all plays that explain the
readings, which includes the uncertainty due to ticks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.calibration.data import TICK
from deltacharger_kinematics.calibration.servo_fit import CONSTANT, FRICTION, OFFSET_ERROR, ServoFit
from deltacharger_kinematics.calibration.servo_plan import PosePlanner
from deltacharger_kinematics.calibration.servo_walk import ArmWalk
from deltacharger_kinematics.geometry import Vector

WIDEST = 0.05
"""rad, largest detectable play."""
_LIGHT = 0.6  # of a servo's friction; friction holds the arm at a smaller share of the weight
_SWEEPS = 12  # maximum, both directions counted
_WAIT, _READ = 0.06, 0.12  # s at each goal
_FINE = 0.2  # of the friction; change of torque from goal to goal
_ENOUGH = 0.6  # of the friction on the other side, end of a sweep
_GRID = np.arange(0.0, WIDEST, 5e-5)
_DRAWS = 400  # random draws of uncertain values
_GIVE = 0.0025  # rad/(N·m), compliance of a gear before it slips; also its standard deviation
_VAGUE = 0.005  # rad, standard deviation from which a play is not reported
_MODEL_ERROR = 1e-3  # N·m


class Sweep(NamedTuple):
    """Sweep of one servo's goal back from the place where it had slipped.

    Attributes:
        direction: direction of rotation before, +1 or −1.
        load: share of the weight there, N·m.
        back: distance of the goal from the start, rad, (n,).
        currents: A, (n,).
        current_errors: A, (n,).
    """

    direction: int
    load: float
    back: Array
    currents: Array
    current_errors: Array


class Play(NamedTuple):
    """Play between encoder and arm.

    Attributes:
        width: of each servo, rad (3,); NaN if unknown, because the arm's weight hides it.
        error: standard deviation, rad (3,).
        strange: servos whose sweeps no play explains.
    """

    width: Array
    error: Array
    strange: tuple[int, ...] = ()


def untold() -> Play:
    """Return unknown play for all servos."""
    return Play(np.full(3, math.nan), np.full(3, math.nan))


def sweep_play(walk: ArmWalk, planner: PosePlanner, fit: ServoFit, seconds: float) -> Play:
    """Measure the play of every servo whose friction can hold the arm somewhere in the workspace.

    Args:
        walk: the arm.
        planner: provides the places.
        fit: fit of the readings at rest.
        seconds: time for all servos together.

    Raises:
        ServoTrouble: as in `ArmWalk`.
    """
    found, strange = untold(), []
    light = [servo for servo in range(3) if planner.lightest(servo) < _LIGHT * max(fit.friction[servo], 0.0)]
    for servo in light:
        sweeps = _sweeps(walk, planner, fit, servo, seconds / len(light))
        if sweeps:
            width, error = play_of(sweeps, fit, servo)
            if math.isnan(width):
                strange.append(servo)
            elif error < _VAGUE:
                found.width[servo], found.error[servo] = width, error
    return found._replace(strange=tuple(strange))


def _sweeps(walk: ArmWalk, planner: PosePlanner, fit: ServoFit, servo: int, seconds: float) -> list[Sweep]:
    """Move to places with a small load of a servo and sweep there in both directions."""
    end, sweeps = walk.spent + seconds, list[Sweep]()
    stiffness, friction = float(fit.stiffness[servo]), float(fit.friction[servo])
    turn = 3.0 * friction / stiffness + 0.02
    for place in planner.light_places(servo, _LIGHT * friction, _SWEEPS // 2):
        goals = planner.goals_at(place, walk.model)
        walk.lead(_moved(goals, servo, -turn), place)
        walk.rest()
        for direction in (1, -1):
            if walk.spent > end:
                return sweeps
            walk.lead(_moved(goals, servo, 0.0), place)
            start = walk.rest()
            load = float(walk.loads(np.array(start.angles))[servo])
            sweeps.append(_sweep(walk, servo, direction, load, fit))
            walk.lead(_moved(goals, servo, direction * turn), place)
            walk.rest()
    return sweeps


def _moved(goals: Vector, servo: int, by: float) -> Vector:
    first, second, third = (
        goal + (round(by / TICK) * TICK if index == servo else 0.0) for index, goal in enumerate(goals)
    )
    return first, second, third


def _sweep(walk: ArmWalk, servo: int, direction: int, load: float, fit: ServoFit) -> Sweep:
    """Move one servo's goal back, in small steps while its torque is small, until it pulls the other way."""
    friction, stiffness, constant = (
        float(values[servo]) for values in (fit.friction, fit.stiffness, fit.torque_constant)
    )
    start, fine = walk.arm.goals(), max(1, round(_FINE * friction / stiffness / TICK))
    # The first step leaves part of the friction; smaller ones cross the rest.
    ticks = max(1, round((direction * load + (1.0 - 2.0 * _FINE) * friction) / stiffness / TICK))
    rows = []
    while ticks * TICK < WIDEST + 3.0 * friction / stiffness:
        reading = walk.step(_moved(start, servo, -direction * ticks * TICK), _WAIT, _READ)
        rows.append((ticks * TICK, reading.currents[servo], reading.current_errors[servo]))
        if direction * constant * rows[-1][1] < direction * load - _ENOUGH * friction and rows[-1][1] * direction < 0.0:
            break
        ticks += fine
    readings = np.array(rows)
    return Sweep(direction, load, readings[:, 0], readings[:, 1], readings[:, 2])


def play_of(sweeps: list[Sweep], fit: ServoFit, servo: int) -> tuple[float, float]:
    """Return mean and standard deviation (rad) of the plays that explain a servo's sweeps; NaN if none does.

    Each play of a grid is tested with random draws of load, friction, stiffness and gear compliance.
    """
    random = np.random.default_rng(0)
    friction = fit.friction[servo] + fit.own_error(FRICTION)[servo] * random.normal(size=_DRAWS)
    give = np.abs(_GIVE * (1.0 + random.normal(size=_DRAWS)))
    shift = 0.3 * OFFSET_ERROR * random.normal(size=_DRAWS)
    constant = fit.torque_constant[servo] * (
        1.0 + fit.own_error(CONSTANT)[servo] / fit.torque_constant[servo] * random.normal(size=_DRAWS)
    )
    grip = 1.0 / (1.0 - fit.friction_share)
    yields = fit.stiffness[servo] / (1.0 + fit.stiffness[servo] * give)
    misfit = np.zeros((_DRAWS, len(_GRID)))
    for sweep in sweeps:
        load = sweep.direction * sweep.load + shift
        for back, current, error in zip(
            sweep.back, sweep.direction * sweep.currents, sweep.current_errors, strict=True
        ):
            first, last = grip * (load + friction)[:, None], grip * (load - friction)[:, None]
            torque = torque_swept(back, _GRID, first, last, yields[:, None])
            spread = np.hypot(error * constant, _MODEL_ERROR)[:, None]
            misfit += ((torque - current * constant[:, None]) / spread) ** 2
    likelihood = np.exp(-0.5 * (misfit - misfit.min())).sum(axis=0)
    likelihood /= likelihood.sum()
    mean = float(likelihood @ _GRID)
    if misfit.min() > 25.0 * sum(len(sweep.back) for sweep in sweeps):
        return math.nan, math.nan
    return mean, float(np.sqrt(likelihood @ (_GRID - mean) ** 2))


def torque_swept(back: float, play: Array, first: Array, last: Array, stiffness: Array) -> Array:
    """Return the torque (N·m) after a goal has moved back by `back` (rad) from where the torque was `first`.

    It falls by `stiffness`, stays at 0 over the width of the play, and falls on to `last`, where the arm slips.
    """
    at_zero = np.maximum(first, 0.0) / stiffness
    before = first - stiffness * back
    after = -stiffness * (back - at_zero - play)
    return np.maximum(np.where(before > 0.0, before, np.minimum(after, 0.0)), last)
