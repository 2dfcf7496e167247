# SPDX-License-Identifier: Apache-2.0
"""Whether each joint is where its goal is, and whether its goals are where it can follow. No ROS.

A servo in mode 5 is a spring: k (goal − angle) = Kt I + d ω. What torque and speed explain is no error, whatever the
torque: one that rises to its bound does not excuse a joint that stays behind. An encoder that reads one and the same
angle has less excuse: a joint that really stands has no lag, and one that runs away unseen must be stopped early.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from deltacharger_core.machine import (
    DAMPING_PER_GAIN,
    JOINT_SPEED,
    STIFFNESS_PER_GAIN,
    STRAY_BEHIND,
    STRAY_OUTSIDE,
    STRAYS,
)
from deltacharger_driver.errors import TrajectoryRefused
from deltacharger_driver.servos.snapshot import BusSettings
from deltacharger_driver.servos.trajectory import Trajectory

STOP_TIME = 0.5
"""s from "goal := present position" to torque off."""
_SOFTER = 4.0  # times softer than by its gains a servo may be: nobody gives the gains' units in mode 5
_FREE, _FREE_STANDING = 0.08, 0.03  # rad of an error without torque; where the encoder reads the same as before
_LATE = 0.03  # s that a goal may be older than the reading
_LASTS = 0.1  # s that an error must last: docking moves its goals behind the arm for half of it before it pulls off
_LASTS_STANDING, _DOUBT = 0.06, 1.15  # s; what a noisy current explains, more there: it lasts too
_FEWEST = 4  # readings that it must last, so that no pause of this computer makes one


class JointWatch:
    """Compares goals, angles and currents, cycle by cycle.

    Args:
        settings: ids, gains and joint limits.
        torque_constant: N·m/A.

    Attributes:
        strays: why each joint stops the arm, as in ServoState; 0 = it does not. Kept until `begin_at`.
    """

    def __init__(self, settings: BusSettings, torque_constant: float) -> None:
        self._settings, self._reach = settings, settings.reach
        self._constant = torque_constant
        self._stiffness = STIFFNESS_PER_GAIN * settings.gains[0]
        self._damping = DAMPING_PER_GAIN * settings.gains[2]
        self.begin_at((math.nan,) * len(settings.ids))

    def begin_at(self, goals: Sequence[float]) -> None:
        """Start at these goals, rad."""
        count = len(self._settings.ids)
        self._goals, self._at = tuple(goals), math.nan
        self._angles = [math.nan] * count  # rad, read before
        self._ahead = [0.0] * count  # rad that the goal has moved beyond what `JOINT_SPEED` allows
        self._since, self._readings, self.strays = [math.inf] * count, [0] * count, [0] * count

    def lead(self, torque: float) -> float:
        """Return how far (rad) a goal may lead a joint under `torque`, N·m."""
        return self._yields(torque) + _FREE

    def _yields(self, torque: float) -> float:
        return _SOFTER * abs(torque) / self._stiffness

    def follow(self, now: float, goals: Sequence[float]) -> None:
        """Take the goals (rad) at `now` (s)."""
        passed = 0.0 if math.isnan(self._at) else now - self._at
        self._ahead = [
            max(ahead + abs(goal - before) - JOINT_SPEED * passed, 0.0)
            for ahead, before, goal in zip(self._ahead, self._goals, goals, strict=True)
        ]
        self._goals, self._at = tuple(goals), now

    def check(self, trajectory: Trajectory, elapsed: float, bounds: Sequence[float]) -> None:
        """Refuse a trajectory whose goals move faster than the joints can, from the goals last followed on.

        Args:
            trajectory: checked.
            elapsed: s since its start.
            bounds: current of each servo where it sets none, A.

        Raises:
            TrajectoryRefused: names the first joint.
        """
        rest = trajectory.remaining(elapsed)
        rows = [(0.0, self._goals, None), *zip(rest.times, rest.angles, rest.torques, strict=True)]
        if trajectory.times and elapsed >= trajectory.times[0]:  # a point in the past is a jump
            rows.insert(1, (0.0, trajectory.goal_at(elapsed, self._goals), trajectory.torque_at(elapsed)))
        ahead, most = list(self._ahead), [self._constant * bound for bound in bounds]
        for number, ((since, before, _), (time, angles, torques)) in enumerate(pairwise(rows)):
            most = [max(*pair) for pair in zip(most, torques, strict=True)] if torques else most
            for index, (start, angle) in enumerate(zip(before, angles, strict=True)):
                turn, seconds = abs(angle - start), max(time - since, 0.0)
                ahead[index] = max(ahead[index] + turn - JOINT_SPEED * seconds, 0.0)
                if ahead[index] > 2.0 * self.lead(most[index]) and turn > JOINT_SPEED * seconds:
                    raise TrajectoryRefused(
                        f"point {number}: joint {index} would turn by {turn:.2f} rad within {seconds:.3f} s, faster "
                        f"than {JOINT_SPEED} rad/s; give it more time"
                    )

    def fault(
        self,
        now: float,
        goals: Sequence[float],
        angles: Sequence[float],
        rates: Sequence[float],
        currents: Sequence[float],
    ) -> str:
        """Return why the arm must stop; '' = it need not.

        Args:
            now: time of the readings, s.
            goals: of this cycle, rad.
            angles, rates, currents: rad, rad/s, A; NaN = not measured.
        """
        self.follow(now, goals)
        for index, row in enumerate(zip(goals, angles, rates, currents, strict=True)):
            self.strays[index] = self.strays[index] or self._stray(index, *row)
        if not any(self.strays):
            return ""
        found = (
            f"servo {servo} {STRAYS[why]}" for servo, why in zip(self._settings.ids, self.strays, strict=True) if why
        )
        return "; ".join(found)

    def _stray(self, index: int, goal: float, angle: float, rate: float, current: float) -> int:
        low, high = self._reach
        if angle < low or angle > high:
            return STRAY_OUTSIDE
        error = goal - angle
        stands, self._angles[index] = angle == self._angles[index], angle
        free, seconds, share = (_FREE_STANDING, _LASTS_STANDING, _DOUBT) if stands else (_FREE, _LASTS, 1.0)
        if not (abs(error) > free and abs(error) > free + share * self._explained(error, rate, current)):
            self._since[index], self._readings[index] = math.inf, 0
            return 0
        self._since[index] = min(self._since[index], self._at)
        self._readings[index] += 1
        lasts = self._at - self._since[index] >= seconds and self._readings[index] >= _FEWEST
        return STRAY_BEHIND if lasts else 0

    def _explained(self, error: float, rate: float, current: float) -> float:
        """Return the error (rad) that torque and speed explain."""
        torque = self._constant * current + self._damping * rate
        return (self._yields(torque) if error * torque > 0.0 else 0.0) + _LATE * abs(rate)
