"""Straight lines of the platform as joint trajectories: planned whole, checked whole, then moved or not at all."""

from __future__ import annotations

import math

import numpy as np

from deltacharger_docking.codes import Unreachable
from deltacharger_docking.observation import Waypoint
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics import Delta, DeltaGeometry, Status
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.statics import TORQUE_CONSTANT
from deltacharger_kinematics.status import NO_ANSWER

_INTERVAL = 0.02  # s between waypoints; the servo node interpolates at its bus rate
_PEAK_TO_MEAN = 1.875  # of the quintic 10u³ − 15u⁴ + 6u⁵, which starts and ends at rest
_ARM_SPEED = 5.0  # rad/s; the MX-64 turns at 6.6 rad/s unloaded at 12 V
# Pressing puts the goal beyond the box, and a nearly stretched arm still presses; everything else is refused.
_REFUSED = np.uint32(NO_ANSWER | Status.WRONG_ASSEMBLY | Status.NEAR_TYPE_2 | Status.JOINT_LIMIT | Status.SWING_LIMIT)


class Planner:
    """Plans lines in ``charger_base`` (m) under speed limits, with the weight of the arm fed forward."""

    def __init__(self, parameters: DockingParameters, geometry: DeltaGeometry) -> None:
        self._parameters = parameters
        self._delta = Delta(geometry)

    def line(self, start: Vector, goal: Vector, speed: float, push: float | None = None) -> tuple[Waypoint, ...]:
        """Return the waypoints from `start` to `goal`.

        The commanded angles lead the wanted ones by what the servo spring yields under the arm's own weight. Pressing
        against a target puts the goal beyond it, so a goal outside the workspace box is allowed; outside the reach, the
        joint limits or the rod swing it is not.

        Args:
            start: present commanded position.
            goal: wanted position.
            speed: peak speed, m/s.
            push: current bound (A) above each servo's free-motion current; None = the parameter.

        Raises:
            Unreachable: some point of the line has no good solution; nothing was moved.
        """
        distance = math.dist(start, goal)
        duration = max(_PEAK_TO_MEAN * distance / speed, 2 * _INTERVAL)
        while True:
            count = max(math.ceil(duration / _INTERVAL), 1)
            u = np.linspace(0.0, 1.0, count + 1)[1:, None]
            points = np.asarray(start) + (np.asarray(goal) - np.asarray(start)) * (10 * u**3 - 15 * u**4 + 6 * u**5)
            angles, bound = self._command(points, push)
            fastest = float(np.abs(np.diff(angles, axis=0)).max(initial=0.0)) * count / duration
            if fastest <= _ARM_SPEED:
                break
            duration *= 1.05 * fastest / _ARM_SPEED
        times = u[:, 0] * duration
        return tuple(
            Waypoint(float(time), _vector(row), _vector(torque))
            for time, row, torque in zip(times, angles, bound, strict=True)
        )

    def reachable(self, *points: Vector) -> str:
        """Return '' where every point lies in the workspace with good angles, else what is wrong with the first."""
        solved = self._delta.inverse(np.array(points))
        for point, status in zip(points, np.atleast_1d(np.asarray(solved.status)), strict=True):
            if status:
                place = ", ".join(f"{1000 * value:.1f}" for value in point)
                return f"({place}) mm: {Status(int(status)).name}"
        return ""

    def _command(self, points: np.ndarray, push: float | None) -> tuple[np.ndarray, np.ndarray]:
        solved = self._delta.inverse(points)
        bad = np.flatnonzero(np.asarray(solved.status) & _REFUSED)
        if len(bad):
            place = ", ".join(f"{1000 * value:.1f}" for value in points[bad[0]])
            status = Status(int(np.asarray(solved.status)[bad[0]]))
            raise Unreachable(f"the arm cannot go to ({place}) mm: {status.name}; move the robot closer to the target")
        held = self._delta.holding_torque(points, self._parameters.gravity)
        allowed = self._parameters.push_current if push is None else push
        geometry = self._delta.geometry
        angles = np.clip(
            solved.angles + held / self._parameters.servo_stiffness, geometry.joint_min, geometry.joint_max
        )
        return angles, np.abs(held) + allowed * TORQUE_CONSTANT


def _vector(row: np.ndarray) -> Vector:
    return float(row[0]), float(row[1]), float(row[2])
