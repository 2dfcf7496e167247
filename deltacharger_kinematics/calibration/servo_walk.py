# SPDX-License-Identifier: Apache-2.0
"""Moves a free arm from place to place, chosen to learn the most, and reads it at rest.

Chooses the next place of rest so that the readings give the most information for their time.
Every move turns all three servos, each in one direction, so that the sign of friction is known at each place. Of many
random poses the next one is chosen A-optimally: its loads and directions reduce the summed variances of 1/Kt, 1/k and
friction of all servos most for the time of the move.
"""

import math
from typing import NamedTuple

import numpy as np

from deltacharger_core import arrays, machine
from deltacharger_kinematics import delta, geometry
from deltacharger_kinematics.calibration import data, servo_fit
from deltacharger_kinematics.swing import SwingReading, swing_readings

SPEED = 0.7  # rad/s of a servo at the start of a move; a platform 0.1 m from its motors then moves at 70 mm/s
SHORTEST = 0.3  # s, shortest move
_CANDIDATES = 500
_INSET = 0.85  # of the workspace box; with a rough stiffness the arm misses a pose by some millimetres
_OUTSIDE = 0.004  # m, how far a move may leave the box
_ALONG = np.linspace(0.0, 1.0, 7)
_CONSIDERED = 60  # random candidates per choice: always the same few would always round to ticks in the same way
_TRIED = 25  # best candidates whose moves are checked
_MARGIN = 0.01  # rad between goals and joint limits


class ServoModel(NamedTuple):
    """Present estimate of the servos: N·m/rad and N·m, (3,)."""

    stiffness: arrays.Array
    friction: arrays.Array


class Way(NamedTuple):
    """Move to the next place: goals (rad), directions of rotation, and angles at rest (rad)."""

    goals: geometry.Vector
    directions: tuple[int, int, int]
    angles: arrays.Array


def seconds_of(turns: arrays.Array) -> arrays.Array:
    """Return the duration (s) of a move by (..., 3) rad; its initial speed is three times the mean."""
    return np.asarray(3.0 * np.abs(turns).max(-1) / SPEED)


class PosePlanner:
    """Chooses places one after another; `learn` adds each reading."""

    def __init__(self, task: servo_fit.ServoTask) -> None:
        self._delta = delta.Delta(task.geometry)
        low, high = (np.array(corner) for corner in (task.geometry.workspace_min, task.geometry.workspace_max))
        middle, reach = 0.5 * (high + low), 0.5 * _INSET * (high - low)
        drawn = middle + reach * np.random.default_rng(task.seed).uniform(-1.0, 1.0, (_CANDIDATES, 3))
        points = np.concatenate([drawn, [middle]])
        solved = self._delta.inverse(points)
        good = np.asarray(solved.status) == 0
        if not good.any():
            raise servo_fit.ServoTrouble("no pose of the workspace is within the arm's reach: check its geometry")
        self._angles = np.asarray(solved.angles)[good]
        self._loads = self._delta.holding_torque(points[good], task.gravity)
        self._box = low - _OUTSIDE, high + _OUTSIDE
        self._limits = task.geometry.joint_min + _MARGIN, task.geometry.joint_max - _MARGIN
        self._random = np.random.default_rng(task.seed + 1)
        self._information = np.tile(1e-4 * np.eye(2), (geometry.LIMB_COUNT, 1, 1))

    def learn(self, loads: arrays.Array, directions: tuple[int, int, int]) -> None:
        """Add a reading: loads (3,) N·m and the directions of its servos."""
        rows = np.stack([loads, 0.1 * np.array(directions)], axis=-1)
        self._information += rows[:, :, None] * rows[:, None, :]

    def next(self, goals: geometry.Vector, angles: arrays.Array, model: ServoModel, turn: float, rest: float) -> Way:
        """Return the move to the place with the most information for its time.

        Args:
            goals: present goals, rad.
            angles: present angles at rest, rad.
            model: present estimate of the servos.
            turn: rad, smallest rotation of every servo.
            rest: s for settling and reading.

        Raises:
            ServoTrouble: no place is reachable from here.
        """
        turns = self._angles - angles
        signs = np.sign(turns)
        ahead = self._angles + (self._loads + signs * model.friction) / model.stiffness
        fits = (np.abs(turns) >= turn).all(-1) & (ahead > self._limits[0]).all(-1) & (ahead < self._limits[1]).all(-1)
        some = self._random.random(len(fits)) * len(fits) < _CONSIDERED
        seconds = np.maximum(seconds_of(ahead - goals), SHORTEST)
        gain = self._gain(signs) / (seconds + rest)
        for allowed in (fits & some, fits):
            for index in np.argsort(np.where(allowed, -gain, math.inf))[: min(_TRIED, int(allowed.sum()))]:
                if self._stays_in_the_workspace(angles, self._angles[index]):
                    first, second, third = (int(sign) for sign in signs[index])
                    return Way(servo_fit.whole_ticks(ahead[index]), (first, second, third), self._angles[index])
        raise servo_fit.ServoTrouble(
            "no pose can be reached from the arm's present position: push it by hand into the middle of its workspace"
        )

    def middle(self, angles: arrays.Array, model: ServoModel) -> Way:
        """Return the move to the middle of the workspace from any position; its directions are unknown (0)."""
        between = self._between(angles, self._angles[-1])
        again = self._delta.inverse(self._delta.forward(between).position).angles
        if not np.allclose(again, between, atol=1e-3):  # NaN, too
            raise servo_fit.ServoTrouble(
                "the arm cannot be moved from its position: switch the torque off, and push it to the middle by hand"
            )
        middle = self._angles[-1]
        return Way(servo_fit.whole_ticks(middle + self._loads[-1] / model.stiffness), (0, 0, 0), middle)

    def _gain(self, signs: arrays.Array) -> arrays.Array:
        """Return by how much each candidate reduces the summed variances of all servos."""
        rows = np.stack([self._loads, 0.1 * signs], axis=-1)
        inverse = np.linalg.inv(self._information)
        ahead = np.einsum("sij,csj->csi", inverse, rows)
        return np.asarray(((ahead**2).sum(-1) / (1.0 + (rows * ahead).sum(-1))).sum(-1))

    @staticmethod
    def _between(begin: arrays.Array, end: arrays.Array) -> arrays.Array:
        return np.asarray(begin) + _ALONG[:, None] * (np.asarray(end) - begin)

    def _stays_in_the_workspace(self, begin: arrays.Array, end: arrays.Array) -> bool:
        points = self._delta.forward(self._between(begin, end)).position
        low, high = self._box
        return bool(((points[1:] >= low) & (points[1:] <= high)).all())


PUSH = 0.6  # A per servo beyond the arm's weight, the usual bound before contact
_SETTLED = 7.0  # time constants of the servos until less than a thousandth of a motion is left
_SOONEST, _LATEST = 0.1, 4.0  # s until the arm counts as settled
_READ = (0.2, 0.6)  # s of reading, least and most
_JUMP, _SWINGS, _FREE = 0.01, 8.0, 0.9  # s; rad of oscillation that are read; share of the bound that may not cut
_POINTS = 0.02  # s between points of a move
_STILL = 1.5 * data.TICK  # rad, largest encoder variation at rest
_PATIENCE = 5  # readings before an arm that does not come to rest is given up
_FEWEST = 3  # messages in a reading
_INFORMATIVE = 0.03  # A, smallest current for an estimate of the stiffness
_NEAR_BOUND = 0.93  # of the current bound, not reached at rest without an obstacle
_STRANGE, _SHARE = 0.15, 0.3  # N·m plus share of the weight that only an obstacle explains
_SOFTEST, _STIFFEST = 1.0, 100.0  # N·m/rad, range of estimates


class ArmWalk:
    """An arm that moves between places of rest.

    Args:
        arm: with torque on and free to move.
        task: known properties of the arm.

    Attributes:
        model: present estimate of its servos.
        fitted: whether the estimate is from a fit.
    """

    def __init__(self, arm: servo_fit.ServoArm, task: servo_fit.ServoTask) -> None:
        self.arm = arm
        self.task = task
        self.model = ServoModel(np.full(3, machine.SERVO_STIFFNESS), np.full(3, 0.1))
        self.fitted = False
        self._began = arm.clock()
        self._constant = np.full(3, task.torque_constant)
        self._bound = np.full(3, np.inf)

    @property
    def spent(self) -> float:
        """Time since the start, s."""
        return self.arm.clock() - self._began

    @property
    def settling(self) -> float:
        """Settling time of the softest servo, s."""
        return float(np.clip(_SETTLED * machine.SERVO_DAMPING / self.model.stiffness.min(), _SOONEST, _LATEST))

    @property
    def reading_time(self) -> float:
        """Duration of a reading at rest, s."""
        return float(np.clip(self.settling, *_READ))

    def learn(self, fit: servo_fit.ServoFit) -> None:
        """Take over fitted values."""
        self.model = ServoModel(np.clip(fit.stiffness, _SOFTEST, _STIFFEST), np.clip(np.abs(fit.friction), 0.005, 0.5))
        self._constant = fit.torque_constant
        self.fitted = True

    def look(self, reading: servo_fit.StaticReading) -> None:
        """Estimate the stiffness roughly from one place: torque over error of the loaded servos."""
        errors, currents = np.subtract(reading.goals, reading.angles), np.array(reading.currents)
        loaded = (np.abs(currents) > _INFORMATIVE) & (np.abs(errors) > 0.0)
        if loaded.any():
            found = np.median(np.abs(self._constant[loaded] * currents[loaded] / errors[loaded]))
            self.model = self.model._replace(stiffness=np.full(3, np.clip(found, _SOFTEST, _STIFFEST)))

    def loads(self, angles: arrays.Array) -> arrays.Array:
        """Return each servo's share of the weight (3,), N·m."""
        return np.asarray(servo_fit.loads_at(np.array([angles]), self.task)[0])

    def visit(self, way: Way) -> servo_fit.StaticReading:
        """Make a move and read the arm at rest at its end.

        Raises:
            ServoTrouble: the arm does not come to rest, or carries more than its weight.
        """
        self.lead(way.goals, way.angles)
        reading = self.rest(way.directions)
        self._check(reading)
        return reading

    def lead(self, goals: geometry.Vector, angles: arrays.Array) -> None:
        """Move the goals, with bounded torque, so that the arm comes to rest at `angles`."""
        here = np.abs(self.loads(self.arm.read(0.02).angles[-1]))
        most = np.fmax(here, np.abs(self.loads(angles))) + PUSH * self.task.torque_constant
        self._bound = most / self.task.torque_constant
        begin = self.arm.goals()
        seconds = max(float(seconds_of(np.subtract(goals, begin))), SHORTEST)
        self.arm.follow(eased(begin, goals, seconds), (float(most[0]), float(most[1]), float(most[2])))

    def swing(self, turn: float) -> list[SwingReading]:
        """Set the goals back or forward by `turn` rad at once; return the readings while the arm swings."""
        begin = np.array(self.arm.goals())
        most = np.abs(self.loads(begin)) + PUSH * self.task.torque_constant
        goals = servo_fit.whole_ticks((begin + turn).tolist())
        self.arm.follow([(_JUMP, goals)], (float(most[0]), float(most[1]), float(most[2])))
        seconds = _SWINGS * float(np.sqrt(machine.SERVO_INERTIA / self.model.stiffness.min()))
        seen = self.arm.read(seconds)
        times = np.linspace(0.0, seconds, len(seen.angles), endpoint=False).tolist()
        rows = list(zip(times, seen.angles.tolist(), seen.currents.tolist(), strict=True))
        return swing_readings(rows, goals, (_FREE * most / self.task.torque_constant).tolist())

    def rest(self, directions: tuple[int, int, int] = (0, 0, 0)) -> servo_fit.StaticReading:
        """Wait until the arm is at rest and read it.

        Raises:
            ServoTrouble: the arm does not come to rest, or there are too few messages.
        """
        self.arm.read(self.settling)
        for _ in range(_PATIENCE):
            readings = self.arm.read(self.reading_time)
            if np.ptp(readings.angles, axis=0).max() <= _STILL:
                return self._reading(readings, directions)
        raise servo_fit.ServoTrouble(
            "the arm does not come to rest: remove the target and anything that pushes the arm, and check for a loose "
            "platform or rod or a position gain that is too high"
        )

    def _reading(self, readings: servo_fit.ArmReadings, directions: tuple[int, int, int]) -> servo_fit.StaticReading:
        if len(readings.currents) < _FEWEST:
            raise servo_fit.ServoTrouble(
                "servo_state is published too rarely for a measurement: check `rate` of servo_node"
            )
        return servo_fit.at_rest(self.arm.goals(), readings, directions)

    def _check(self, reading: servo_fit.StaticReading) -> None:
        """Refuse a reading if the arm carries more than its weight."""
        currents, bound = np.abs(reading.currents), self._bound
        for servo in range(geometry.LIMB_COUNT):
            if currents[servo] > _NEAR_BOUND * bound[servo]:
                raise servo_fit.ServoTrouble(
                    f"servo {servo + 1} is at its current bound of {bound[servo]:.2f} A and does not reach its place: "
                    "remove what blocks the platform, check for a jammed rod, and start again"
                )
        if not self.fitted:
            return
        borne = self.loads(np.array(reading.angles))
        extra = np.abs(self._constant * np.array(reading.currents) - borne) - self.model.friction
        for servo in map(int, np.flatnonzero(extra > _STRANGE + _SHARE * np.abs(borne))):
            raise servo_fit.ServoTrouble(
                f"servo {servo + 1} carries {extra[servo]:.2f} N·m more than weight and friction at one place: "
                "remove what blocks the platform there, or correct gravity of docking_node"
            )


def eased(begin: geometry.Vector, end: geometry.Vector, seconds: float) -> list[tuple[float, geometry.Vector]]:
    """Return points of a decelerating move, 1 − (1 − t)³: overshoot would leave less than full friction at rest."""
    points = []
    for share in np.linspace(0.0, 1.0, max(4, round(seconds / _POINTS)) + 1)[1:]:
        done = 1.0 - (1.0 - share) ** 3
        first, second, third = (a + done * (b - a) for a, b in zip(begin, end, strict=True))
        points.append((float(share * seconds), (first, second, third)))
    return points
