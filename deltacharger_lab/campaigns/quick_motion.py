# SPDX-License-Identifier: Apache-2.0
"""Lines of a campaign's dockings: the usual ones, but short slow ones at a fraction of the cost, and told whole."""

from __future__ import annotations

import functools
import math
from itertools import pairwise

from deltacharger_docking.motion import Planner
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.line import PEAK_SPEED, REFUSED, way_done
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.trajectory_feed import Piece, TrajectoryFeed, Waypoint, between

_SHORT, _SLOW = 0.008, 0.04  # m and m/s up to which the arms' own limits never bind well inside the workspace
_MARGIN = 0.02  # share of the reach that both ends must keep from its edge
_INTERVAL = 0.02  # s between two points, as in the usual lines
_LOOKS = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of a leg
_REFUSED, _EDGE = int(REFUSED), 0.02  # m around the workspace box


class QuickPlanner(Planner):
    """Plans short slow lines point by point in plain floats; the others, and all that could be refused, as ever.

    Such a line has the time law and the points of the usual one. Its lead under the arm's weight is exact at both ends
    and linear between them, which over 8 mm is right to 0.2 mN·m. Waypoints carry no velocities: nobody reads them.
    """

    def __init__(self, parameters: DockingParameters, geometry: DeltaGeometry) -> None:
        super().__init__(parameters, geometry)
        self._scalar = ScalarDelta(geometry)
        (x0, y0, z0), (x1, y1, z1) = geometry.workspace_min, geometry.workspace_max
        self._low = (x0 - _EDGE, y0 - _EDGE, z0 - _EDGE)
        self._high = (x1 + _EDGE, y1 + _EDGE, z1 + _EDGE)

    def line(self, start: Vector, goal: Vector, speed: float, push: float | None = None) -> tuple[Waypoint, ...]:
        """Return the waypoints from `start` to `goal` as `Planner.line` does."""
        length = math.dist(start, goal)
        if length <= _SHORT and speed <= _SLOW and self._is_inside(start) and self._is_inside(goal):
            quick = self._short(start, goal, length, speed, push)
            if quick is not None:
                return quick
        return super().line(start, goal, speed, push)

    def check_way(self, speed: float, *places: Vector) -> None:
        """Refuse a way as `Planner.check_way` does; one that stays well inside the reach needs a few looks only."""
        for start, goal in pairwise(places):
            if not all(self._is_good(between(start, goal, share)) for share in _LOOKS):
                super().check_way(speed, start, goal)

    def _is_good(self, point: Vector) -> bool:
        solved = self._scalar.solve(*point) if self._is_inside(point) else None
        return solved is not None and not solved[1] & _REFUSED and solved[2] >= _MARGIN

    def _is_inside(self, point: Vector) -> bool:
        return all(low <= value <= high for low, value, high in zip(self._low, point, self._high, strict=True))

    def _short(
        self, start: Vector, goal: Vector, length: float, speed: float, push: float | None
    ) -> tuple[Waypoint, ...] | None:
        """Return the line, or None where a point of it needs the full check."""
        parameters, geometry = self._parameters, self._scalar.geometry
        duration = max(PEAK_SPEED * length / speed, 2.0 * _INTERVAL)
        first = self._scalar.holding_torque(*start, parameters.gravity)
        last = self._scalar.holding_torque(*goal, parameters.gravity)
        allowed = (parameters.push_current if push is None else push) * parameters.torque_constant
        softness, low, high = 1.0 / parameters.servo_stiffness, geometry.joint_min, geometry.joint_max
        points = []
        for share, way in _ways(math.ceil(duration / _INTERVAL)):
            solved = self._scalar.solve(*between(start, goal, way))
            if solved is None or solved[1] & _REFUSED or solved[2] < _MARGIN:
                return None
            held = between(first, last, way)
            a, b, c = (
                min(max(angle + torque * softness, low), high) for angle, torque in zip(solved[0], held, strict=True)
            )
            bound = (abs(held[0]) + allowed, abs(held[1]) + allowed, abs(held[2]) + allowed)
            points.append(Waypoint(share * duration, (a, b, c), bound))
        return tuple(points)


class WholeFeed(TrajectoryFeed):
    """Tells each line at once and whole: a sender in virtual time never falls silent."""

    def piece(self, time: float, held: bool = False) -> Piece | None:
        """Return the line where it has not been told yet."""
        if not self._line or math.isfinite(self._sent):
            return None
        self._sent = time
        return self._line

    def _ran_out(self, time: float) -> bool:
        return False


@functools.lru_cache(maxsize=64)
def _ways(count: int) -> tuple[tuple[float, float], ...]:
    """Return (share of the time, share of the way) of the points of a line but its first."""
    shares = [index / count for index in range(1, count + 1)]
    return tuple((share, way_done(share)) for share in shares)
