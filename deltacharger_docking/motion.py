# SPDX-License-Identifier: Apache-2.0
"""Straight lines of the platform as joint trajectories: planned whole, checked whole, then moved or not at all."""

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


class Planner:
    """Plans lines in ``charger_base`` (m) under speed limits, with the weight of the arm fed forward.

    Attributes:
        parameters: which may be replaced where only what is not of the machine differs.
        springs: what the servos yield by.
    """

    def __init__(self, parameters: DockingParameters, geometry: DeltaGeometry) -> None:
        self.parameters = parameters
        self._delta = Delta(geometry)
        self.springs = Springs(parameters)

    def line(self, start: Vector, goal: Vector, speed: float, push: float | None = None) -> tuple[Waypoint, ...]:
        """Return the waypoints from `start` to `goal`, without the start itself.

        The commanded angles lead the wanted ones by what the servo spring yields under the arm's own weight. Pressing
        against a target puts the goal beyond it, so a goal outside the workspace box is allowed; outside the reach, the
        joint limits or the rod swing it is not.

        Args:
            start: present commanded position.
            goal: wanted position.
            speed: peak speed, m/s; the servos' own limits may make the line slower.
            push: current bound (A) above each servo's free-motion current; None = the parameter.

        Raises:
            Unreachable: some point of the line has no good solution; nothing was moved.
        """
        try:
            line = plan_line(self._delta, start, goal, speed)
        except LineRefused as error:
            if error.share == 0.0:
                raise Unreachable(
                    f"the arm stands where it cannot be moved from: {error}; push it back by hand, with its torque off"
                ) from error
            raise Unreachable(f"the arm cannot go that way: {error}; move the robot closer to the target") from error
        held = self._delta.holding_torque(line.positions, self.parameters.gravity)
        angles, velocities = self._command(line, held / self.springs.stiffness)
        allowed = self.parameters.push_current if push is None else push
        bound = np.abs(held) + allowed * self.parameters.torque_constant
        return tuple(
            Waypoint(time, _vector(row), _vector(torque), _vector(rate))
            for time, row, torque, rate in list(zip(line.times.tolist(), angles, bound, velocities, strict=True))[1:]
        )

    def check_way(self, speed: float, *places: Vector) -> None:
        """Refuse a way through `places` of which any leg would be refused, so that no leg before it is driven.

        Raises:
            Unreachable: as for `line`.
        """
        for start, goal in pairwise(places):
            self.line(start, goal, speed)

    def reachable(self, *points: Vector) -> str:
        """Return '' where every point lies in the workspace with good angles, else what is wrong with the first."""
        solved = self._delta.inverse(np.array(points))
        for point, status in zip(points, np.atleast_1d(np.asarray(solved.status)), strict=True):
            if status:
                place = ", ".join(f"{1000 * value:.1f}" for value in point)
                return f"({place}) mm: {Status(int(status)).name}"
        return ""

    def _command(self, line: Line, lead: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the commanded angles and velocities: those of the line with the lead, inside the joint limits."""
        geometry = self._delta.geometry
        wanted = line.angles + lead
        angles = np.clip(wanted, geometry.joint_min, geometry.joint_max)
        velocities = line.velocities + np.gradient(lead, line.times, axis=0)
        velocities[[0, -1]] = 0.0
        return angles, np.where(angles == wanted, velocities, 0.0)


def _vector(row: np.ndarray) -> Vector:
    return float(row[0]), float(row[1]), float(row[2])
