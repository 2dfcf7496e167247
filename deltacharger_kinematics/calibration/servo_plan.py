# SPDX-License-Identifier: Apache-2.0
"""Where to rest the arm next so that its servos tell most in the time that is left.

Every way from place to place turns all three servos, each in one direction, so that each place is approached with known
friction and no way is without a reading. Of many drawn poses that one is next whose weights, with the directions of the
way there, lower the variances of 1/Kt, 1/k and friction most for its time, all servos together (A-optimal).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.calibration.servo_arm import ServoTask, ServoTrouble, whole_ticks
from deltacharger_kinematics.delta import Delta
from deltacharger_kinematics.geometry import LIMB_COUNT, Vector

SPEED = 0.7  # rad/s of a servo, when a way begins; a platform at 0.1 m from its motors then makes 70 mm/s
SHORTEST = 0.3  # s of a way
_CANDIDATES = 500
_INSET = 0.85  # of the workspace box; rough knowledge of the stiffness misses a pose by some millimetres
_OUTSIDE = 0.004  # m beyond the box that a way may lead
_ALONG = np.linspace(0.0, 1.0, 7)
_LOOKED_AT = 60  # candidates of which each next one is chosen: the same few again would round the same way again
_TRIED = 25  # best candidates whose ways are looked at
_MARGIN = 0.01  # rad that goals keep from the joint limits


class ServoModel(NamedTuple):
    """What is known so far of the servos: N·m/rad and N·m, (3,)."""

    stiffness: Array
    friction: Array


class Way(NamedTuple):
    """To the next place: goals (rad), directions in which the servos turn, and where they come to rest (rad)."""

    goals: Vector
    directions: tuple[int, int, int]
    angles: Array


def seconds_of(turns: Array) -> Array:
    """Return how long a way takes whose goals turn by (..., 3) rad: it begins three times as fast as on average."""
    return np.asarray(3.0 * np.abs(turns).max(-1) / SPEED)


class PosePlanner:
    """Chooses places one after another; `learn` counts what each told."""

    def __init__(self, task: ServoTask) -> None:
        self._delta = Delta(task.geometry)
        low, high = (np.array(corner) for corner in (task.geometry.workspace_min, task.geometry.workspace_max))
        middle, reach = 0.5 * (high + low), 0.5 * _INSET * (high - low)
        drawn = middle + reach * np.random.default_rng(task.seed).uniform(-1.0, 1.0, (_CANDIDATES, 3))
        points = np.concatenate([drawn, [middle]])
        solved = self._delta.inverse(points)
        good = np.asarray(solved.status) == 0
        if not good.any():
            raise ServoTrouble("no pose of the workspace is within the arm's reach: look at its geometry")
        self._angles = np.asarray(solved.angles)[good]
        self._loads = self._delta.holding_torque(points[good], task.gravity)
        self._box = low - _OUTSIDE, high + _OUTSIDE
        self._limits = task.geometry.joint_min + _MARGIN, task.geometry.joint_max - _MARGIN
        self._random = np.random.default_rng(task.seed + 1)
        self._information = np.tile(1e-4 * np.eye(2), (LIMB_COUNT, 1, 1))

    def learn(self, loads: Array, directions: tuple[int, int, int]) -> None:
        """Count a reading: loads (3,) N·m and the directions of its servos."""
        rows = np.stack([loads, 0.1 * np.array(directions)], axis=-1)
        self._information += rows[:, :, None] * rows[:, None, :]

    def next(self, goals: Vector, angles: Array, model: ServoModel, turn: float, rest: float) -> Way:
        """Return the way to the place that tells most for its time.

        Args:
            goals: commanded now, rad.
            angles: at rest now, rad.
            model: what is known of the servos.
            turn: rad that every servo must turn at least.
            rest: s that coming to rest and reading will take.

        Raises:
            ServoTrouble: no place can be reached from here.
        """
        turns = self._angles - angles
        signs = np.sign(turns)
        ahead = self._angles + (self._loads + signs * model.friction) / model.stiffness
        fits = (np.abs(turns) >= turn).all(-1) & (ahead > self._limits[0]).all(-1) & (ahead < self._limits[1]).all(-1)
        some = self._random.random(len(fits)) * len(fits) < _LOOKED_AT
        seconds = np.maximum(seconds_of(ahead - goals), SHORTEST)
        gain = self._gain(signs) / (seconds + rest)
        for allowed in (fits & some, fits):
            for index in np.argsort(np.where(allowed, -gain, math.inf))[: min(_TRIED, int(allowed.sum()))]:
                if self._leads_through_the_workspace(angles, self._angles[index]):
                    first, second, third = (int(sign) for sign in signs[index])
                    return Way(whole_ticks(ahead[index]), (first, second, third), self._angles[index])
        raise ServoTrouble(
            "the arm cannot be moved to any pose from where it stands: push it by hand into the middle of its workspace"
        )

    def middle(self, angles: Array, model: ServoModel) -> Way:
        """Return the way to the middle of the workspace, from wherever the arm stands; its directions tell nothing."""
        between = self._between(angles, self._angles[-1])
        again = self._delta.inverse(self._delta.forward(between).position).angles
        if not np.allclose(again, between, atol=1e-3):  # NaN, too
            raise ServoTrouble(
                "the arm stands where it cannot be moved from: push it to the middle by hand, torque off"
            )
        middle = self._angles[-1]
        return Way(self.goals_at(middle, model), (0, 0, 0), middle)

    def goals_at(self, angles: Array, model: ServoModel) -> Vector:
        """Return goals (rad) that lead the weight at a place of this planner."""
        index = int(np.abs(self._angles - angles).sum(-1).argmin())
        return whole_ticks(self._angles[index] + self._loads[index] / model.stiffness)

    def lightest(self, servo: int) -> float:
        """Return the smallest share of the weight that a servo bears anywhere, N·m."""
        return float(np.abs(self._loads[:, servo]).min())

    def light_places(self, servo: int, most: float, count: int) -> Array:
        """Return angles (n, 3) of at most `count` places nearest the middle where a servo bears at most `most` N·m."""
        light = np.flatnonzero(np.abs(self._loads[:, servo]) <= most)
        near = np.abs(self._angles[light] - self._angles[-1]).max(-1)
        return np.asarray(self._angles[light[np.argsort(near)[:count]]])

    def _gain(self, signs: Array) -> Array:
        """Return by how much each candidate lowers the variances of all servos together."""
        rows = np.stack([self._loads, 0.1 * signs], axis=-1)
        inverse = np.linalg.inv(self._information)
        ahead = np.einsum("sij,csj->csi", inverse, rows)
        return np.asarray(((ahead**2).sum(-1) / (1.0 + (rows * ahead).sum(-1))).sum(-1))

    @staticmethod
    def _between(begin: Array, end: Array) -> Array:
        return np.asarray(begin) + _ALONG[:, None] * (np.asarray(end) - begin)

    def _leads_through_the_workspace(self, begin: Array, end: Array) -> bool:
        points = self._delta.forward(self._between(begin, end)).position
        low, high = self._box
        return bool(((points[1:] >= low) & (points[1:] <= high)).all())
