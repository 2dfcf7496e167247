# SPDX-License-Identifier: Apache-2.0
"""How a servo in mode 5 springs and brakes, from readings after a jump of its goal.

With a goal that stands, the servo's own current gives Kt I = k (goal − angle) − d ω whatever its gear rubs, so that k
and d follow by least squares. Nothing else brakes in mode 5: d comes from the D gain alone.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deltacharger_kinematics.geometry import Vector

LEAST_DAMPING = 0.15
"""N·m·s/rad; with less, the arm swings into the magnets and docks again when it lets go."""
SURELY = 2.0
"""Standard deviations by which a damping is surely below that."""
_HEARD = 0.7  # of the largest change of a current, from which the servo has heard
_SOFTEST = 1.0  # N·m/rad
_LEFT, _TURNS = 0.4, 0.15  # share of the jump, and rad/s, that a creeping servo has left; friction holds a still one
_APART = 0.03  # s between the readings on either side of one, whose rate they show: a missing reading at most
_FEWEST, _LEAST_TURN = 6, 0.01  # readings, and rad that an arm must turn to show how it swings


class SwingReading(NamedTuple):
    """One reading of a servo whose goal stands: goal less angle (rad), rate (rad/s), current (A)."""

    servo: int
    error: float
    rate: float
    current: float


class Swung(NamedTuple):
    """What a swing shows of a servo: stiffness (N·m/rad), damping, its error (N·m·s/rad), play (rad); NaN = nothing."""

    stiffness: float
    damping: float
    damping_stddev: float
    play: float


def swing_readings(
    seen: Sequence[tuple[float, Sequence[float], Sequence[float]]], goals: Vector, most: Sequence[float]
) -> list[SwingReading]:
    """Return the readings that count, with rates from the readings on either side.

    Not those at a servo's bound, nor those before its current shows that it has heard of the jump; none of a servo that
    has not turned, since it may never have heard.

    Args:
        seen: time (s), angles (rad) and currents (A) in order, the first before the jump.
        goals: after the jump, rad.
        most: current of each servo at which its bound may cut, A.
    """
    found = []
    for index, (goal, bound) in enumerate(zip(goals, most, strict=True)):
        if max((abs(row[1][index] - seen[0][1][index]) for row in seen), default=0.0) < _LEAST_TURN:
            continue
        changes = [abs(row[2][index] - seen[0][2][index]) for row in seen]
        heard = next((number for number, each in enumerate(changes) if each > _HEARD * max(changes)), 1)
        for before, now, after in zip(seen[heard - 1 :], seen[heard:], seen[heard + 1 :], strict=False):
            rate = (after[1][index] - before[1][index]) / (after[0] - before[0])
            if abs(now[2][index]) < bound and after[0] - before[0] < _APART:
                found.append(SwingReading(index, goal - now[1][index], rate, now[2][index]))
    return found


def fit_swing(readings: Sequence[SwingReading], constant: float) -> tuple[Swung, Swung, Swung]:
    """Return what fits the readings of each servo best: Kt I = k error − d rate + offset.

    Play shifts the angles by a constant while the load keeps its sign, hence the offset.

    Args:
        readings: of swings, whatever the gears rub.
        constant: torque constant Kt, N·m/A.
    """
    found = []
    for index in range(3):
        rows = np.array([each[1:] for each in readings if each.servo == index])
        found.append(Swung(*(math.nan,) * 4))
        if len(rows) < _FEWEST or np.ptp(rows[:, 0]) < _LEAST_TURN:
            continue
        known = np.column_stack((rows[:, 0], -rows[:, 1], np.ones(len(rows))))
        fit, left, rank, _ = np.linalg.lstsq(known, constant * rows[:, 2], rcond=None)
        if rank == 3 and len(left) and fit[0] > _SOFTEST:  # else the arm creeps too evenly to tell spring and damper
            spread = float(left[0]) / (len(rows) - 3) * np.linalg.inv(known.T @ known)
            k, d, offset = fit.tolist()
            found[-1] = Swung(k, d, math.sqrt(max(float(spread[1, 1]), 0.0)), 2.0 * abs(offset / k))
    return found[0], found[1], found[2]


def creeps(readings: Sequence[SwingReading], servo: int) -> bool:
    """Return whether a servo still turns toward its goal from far away, after the last of its readings."""
    own = [each for each in readings if each.servo == servo]
    if len(own) < _FEWEST:
        return False
    left = own[-1].error
    rate = math.copysign(1.0, left) * sum(each.rate for each in own[-_FEWEST:]) / _FEWEST
    return abs(left) > _LEFT * abs(own[0].error) and rate > _TURNS


def surely_swings(servo: Swung) -> bool:
    """Return whether a servo surely brakes too little."""
    return servo.damping + SURELY * servo.damping_stddev < LEAST_DAMPING
