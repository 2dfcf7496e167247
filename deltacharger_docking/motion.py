# SPDX-License-Identifier: Apache-2.0
"""Straight lines of the platform as joint trajectories, planned and checked completely before the arm moves."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from deltacharger_docking.codes import Unreachable
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.springs import Springs
from deltacharger_kinematics import Delta, DeltaGeometry, Status
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.line import Line, LineRefused, plan_line
from deltacharger_kinematics.trajectory_feed import Waypoint

_PUSH_ABOVE = 0.2
"""A above the band at which a servo's current is bounded while it pushes. From statics, then seeds 5 and 19."""


def push_current(parameters: DockingParameters) -> float:
    """Return the current bound (A) of each servo above its free-motion current."""
    return parameters.current_max + _PUSH_ABOVE


class Planner:
    """Plans lines in ``charger_base`` (m) under speed limits, with the weight of the arm fed forward.

    Attributes:
        parameters: may be replaced if those of the machine stay equal.
        springs: the servos' yielding.
    """

    def __init__(self, parameters: DockingParameters, geometry: DeltaGeometry) -> None:
        self.parameters = parameters
        self._delta = Delta(geometry)
        self.springs = Springs(parameters)

    def line(self, start: Vector, goal: Vector, speed: float) -> tuple[Waypoint, ...]:
        """Return the waypoints from `start` to `goal`, without the start itself.

        The commanded angles lead the desired ones by the servos' yield under the arm's weight. The goal may be outside
        the workspace box, since pressing puts it beyond the target. It must be within reach, joint limits and rod
        swing.

        Args:
            start: present commanded position.
            goal: wanted position.
            speed: peak speed, m/s; the servos' own limits may make the line slower.

        Raises:
            Unreachable: a point of the line has no good solution; nothing was moved.
        """
        try:
            line = plan_line(self._delta, start, goal, speed)
        except LineRefused as error:
            if error.share == 0.0:
                raise Unreachable(
                    f"the arm cannot move from its present position: {error}; push it back by hand, with its torque off"
                ) from error
            raise Unreachable(f"the arm cannot go that way: {error}; move the robot closer to the target") from error
        held = self._delta.holding_torque(line.positions, self.parameters.gravity)
        angles, velocities = self._command(line, held / self.springs.stiffness)
        bound = np.abs(held) + self._beyond_weight()
        return tuple(
            Waypoint(time, _vector(row), _vector(torque), _vector(rate))
            for time, row, torque, rate in list(zip(line.times.tolist(), angles, bound, velocities, strict=True))[1:]
        )

    def bound(self, held: Vector) -> Vector:
        """Return the torque bound (N·m) of each servo that holds `held`: its free-motion torque and the push."""
        a, b, c = (abs(torque) + more for torque, more in zip(held, self._beyond_weight(), strict=True))
        return a, b, c

    def _beyond_weight(self) -> Vector:
        push = push_current(self.parameters) * self.parameters.torque_constant
        a, b, c = self.springs.beyond_weight
        return a + push, b + push, c + push

    def check_way(self, speed: float, *places: Vector) -> None:
        """Check every leg of a way through `places` before the arm moves.

        Raises:
            Unreachable: as for `line`.
        """
        for start, goal in pairwise(places):
            self.line(start, goal, speed)

    def reach_problem(self, *points: Vector) -> str:
        """Return '' if every point is in the workspace with good angles, else the problem of the first bad one."""
        solved = self._delta.inverse(np.array(points))
        for point, status in zip(points, np.atleast_1d(np.asarray(solved.status)), strict=True):
            if status:
                place = ", ".join(f"{1000 * value:.1f}" for value in point)
                return f"({place}) mm: {Status(int(status)).name}"
        return ""

    def _command(self, line: Line, lead: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the commanded angles and velocities: the line's with the lead, inside the joint limits."""
        geometry = self._delta.geometry
        wanted = line.angles + lead
        angles = np.clip(wanted, geometry.joint_min, geometry.joint_max)
        velocities = line.velocities + np.gradient(lead, line.times, axis=0)
        velocities[[0, -1]] = 0.0
        return angles, np.where(angles == wanted, velocities, 0.0)


def _vector(row: np.ndarray) -> Vector:
    return float(row[0]), float(row[1]), float(row[2])
