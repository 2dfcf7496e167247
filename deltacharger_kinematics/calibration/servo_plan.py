# SPDX-License-Identifier: Apache-2.0
"""Chooses the next place of rest so that the readings give the most information for their time.

Every move turns all three servos, each in one direction, so that the sign of friction is known at each place. Of many
random poses the next one is chosen A-optimally: its loads and directions reduce the summed variances of 1/Kt, 1/k and
friction of all servos most for the time of the move.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.calibration.servo_arm import ServoTask, ServoTrouble, whole_ticks
from deltacharger_kinematics.delta import Delta
from deltacharger_kinematics.geometry import LIMB_COUNT, Vector

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

    stiffness: Array
    friction: Array


class Way(NamedTuple):
    """Move to the next place: goals (rad), directions of rotation, and angles at rest (rad)."""

    goals: Vector
    directions: tuple[int, int, int]
    angles: Array


def seconds_of(turns: Array) -> Array:
    """Return the duration (s) of a move by (..., 3) rad; its initial speed is three times the mean."""
    return np.asarray(3.0 * np.abs(turns).max(-1) / SPEED)


class PosePlanner:
    """Chooses places one after another; `learn` adds each reading."""

    def __init__(self, task: ServoTask) -> None:
        self._delta = Delta(task.geometry)
        low, high = (np.array(corner) for corner in (task.geometry.workspace_min, task.geometry.workspace_max))
        middle, reach = 0.5 * (high + low), 0.5 * _INSET * (high - low)
        drawn = middle + reach * np.random.default_rng(task.seed).uniform(-1.0, 1.0, (_CANDIDATES, 3))
        points = np.concatenate([drawn, [middle]])
        solved = self._delta.inverse(points)
        good = np.asarray(solved.status) == 0
        if not good.any():
            raise ServoTrouble("no pose of the workspace is within the arm's reach: check its geometry")
        self._angles = np.asarray(solved.angles)[good]
        self._loads = self._delta.holding_torque(points[good], task.gravity)
        self._box = low - _OUTSIDE, high + _OUTSIDE
        self._limits = task.geometry.joint_min + _MARGIN, task.geometry.joint_max - _MARGIN
        self._random = np.random.default_rng(task.seed + 1)
        self._information = np.tile(1e-4 * np.eye(2), (LIMB_COUNT, 1, 1))

    def learn(self, loads: Array, directions: tuple[int, int, int]) -> None:
        """Add a reading: loads (3,) N·m and the directions of its servos."""
        rows = np.stack([loads, 0.1 * np.array(directions)], axis=-1)
        self._information += rows[:, :, None] * rows[:, None, :]

    def next(self, goals: Vector, angles: Array, model: ServoModel, turn: float, rest: float) -> Way:
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
                    return Way(whole_ticks(ahead[index]), (first, second, third), self._angles[index])
        raise ServoTrouble(
            "no pose can be reached from the arm's present position: push it by hand into the middle of its workspace"
        )

    def middle(self, angles: Array, model: ServoModel) -> Way:
        """Return the move to the middle of the workspace from any position; its directions are unknown (0)."""
        between = self._between(angles, self._angles[-1])
        again = self._delta.inverse(self._delta.forward(between).position).angles
        if not np.allclose(again, between, atol=1e-3):  # NaN, too
            raise ServoTrouble(
                "the arm cannot be moved from its position: switch the torque off, and push it to the middle by hand"
            )
        middle = self._angles[-1]
        return Way(self.goals_at(middle, model), (0, 0, 0), middle)

    def goals_at(self, angles: Array, model: ServoModel) -> Vector:
        """Return goals (rad) that hold the weight at a place of this planner."""
        index = int(np.abs(self._angles - angles).sum(-1).argmin())
        return whole_ticks(self._angles[index] + self._loads[index] / model.stiffness)

    def lightest(self, servo: int) -> float:
        """Return a servo's smallest share of the weight at any place, N·m."""
        return float(np.abs(self._loads[:, servo]).min())

    def light_places(self, servo: int, most: float, count: int) -> Array:
        """Return angles (n, 3) of up to `count` central places where a servo's load is at most `most` N·m."""
        light = np.flatnonzero(np.abs(self._loads[:, servo]) <= most)
        near = np.abs(self._angles[light] - self._angles[-1]).max(-1)
        return np.asarray(self._angles[light[np.argsort(near)[:count]]])

    def _gain(self, signs: Array) -> Array:
        """Return by how much each candidate reduces the summed variances of all servos."""
        rows = np.stack([self._loads, 0.1 * signs], axis=-1)
        inverse = np.linalg.inv(self._information)
        ahead = np.einsum("sij,csj->csi", inverse, rows)
        return np.asarray(((ahead**2).sum(-1) / (1.0 + (rows * ahead).sum(-1))).sum(-1))

    @staticmethod
    def _between(begin: Array, end: Array) -> Array:
        return np.asarray(begin) + _ALONG[:, None] * (np.asarray(end) - begin)

    def _stays_in_the_workspace(self, begin: Array, end: Array) -> bool:
        points = self._delta.forward(self._between(begin, end)).position
        low, high = self._box
        return bool(((points[1:] >= low) & (points[1:] <= high)).all())
