# SPDX-License-Identifier: Apache-2.0
"""Lines of a campaign's dockings: planned at a fifth of the usual cost, and sent in one piece."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from itertools import pairwise

from deltacharger_docking.arm import Planner
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.line import PEAK_SPEED, REFUSED, ArmLimits, way_done
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.trajectory_feed import Piece, TrajectoryFeed, Waypoint, between

_MARGIN = 0.02  # share of the reach that both ends must keep from its edge
_INTERVAL = 0.02  # s between two points, as in the usual lines
_FEWEST = 24  # intervals for which differences give the arms' accelerations to 1 %, and so the time to 0.5 %
_LOOKS = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of a leg
_REFUSED, _EDGE = int(REFUSED), 0.02  # m around the workspace box


class QuickPlanner(Planner):
    """Plans lines well inside the reach point by point in plain floats; `Planner` plans all others.

    Such a line has the usual time law; the arms' limits are checked only at its points. Its lead under the arm's
    weight is exact at both ends and in the middle, and a parabola between them. Waypoints carry no velocities,
    because nothing reads them.
    """

    def __init__(self, parameters: DockingParameters, geometry: DeltaGeometry) -> None:
        super().__init__(parameters, geometry)
        self._scalar = ScalarDelta(geometry)
        self._limits = ArmLimits()
        (x0, y0, z0), (x1, y1, z1) = geometry.workspace_min, geometry.workspace_max
        self._low = (x0 - _EDGE, y0 - _EDGE, z0 - _EDGE)
        self._high = (x1 + _EDGE, y1 + _EDGE, z1 + _EDGE)

    def line(self, start: Vector, goal: Vector, speed: float) -> tuple[Waypoint, ...]:
        """Return the waypoints from `start` to `goal`, as `Planner.line`."""
        quick = self._quick(start, goal, speed)
        return super().line(start, goal, speed) if quick is None else quick

    def check_way(self, speed: float, *places: Vector) -> None:
        """Refuse a path as `Planner.check_way` does; a path well inside the reach is checked at a few points only."""
        for start, goal in pairwise(places):
            if not all(self._is_good(between(start, goal, share)) for share in _LOOKS):
                super().check_way(speed, start, goal)

    def _is_good(self, point: Vector) -> bool:
        solved = self._scalar.solve(*point) if self._is_inside(point) else None
        return solved is not None and not solved[1] & _REFUSED and solved[2] >= _MARGIN

    def _is_inside(self, point: Vector) -> bool:
        return all(low <= value <= high for low, value, high in zip(self._low, point, self._high, strict=True))

    def _quick(self, start: Vector, goal: Vector, speed: float) -> tuple[Waypoint, ...] | None:
        """Return the line; None if a point of it needs the full check."""
        duration = max(PEAK_SPEED * math.dist(start, goal) / speed, 2.0 * _INTERVAL)
        count = max(math.ceil(duration / _INTERVAL), _FEWEST)
        ways = _ways(count)
        angles = []
        for way in ways:
            point = between(start, goal, way)
            solved = self._scalar.solve(*point) if self._is_inside(point) else None
            if solved is None or solved[1] & _REFUSED or solved[2] < _MARGIN:
                return None
            angles.append(solved[0])
        duration = max(duration, self._fastest(angles))
        return tuple(self._waypoints(start, goal, ways, angles, duration))

    def _fastest(self, angles: list[Vector]) -> float:
        """Return the shortest time (s) in which the arms can pass these angles (rad), equally spaced in time."""
        turn = bend = 0.0
        for before, here, after in zip(angles, angles[1:], angles[2:]):  # noqa: B905 their lengths differ
            for a, b, c in zip(before, here, after, strict=True):
                turn, bend = max(turn, abs(c - a)), max(bend, abs(c - b - b + a))
        count = len(angles) - 1
        return max(0.5 * count * turn / self._limits.speed, count * math.sqrt(bend / self._limits.acceleration))

    def _waypoints(
        self,
        start: Vector,
        goal: Vector,
        ways: tuple[float, ...],
        angles: list[Vector],
        duration: float,
    ) -> Iterator[Waypoint]:
        parameters, geometry = self.parameters, self._scalar.geometry
        held = [
            self._scalar.holding_torque(*point, parameters.gravity)
            for point in (start, between(start, goal, 0.5), goal)
        ]
        softness, low, high = 1.0 / self.springs.stiffness, geometry.joint_min, geometry.joint_max
        for index in range(1, len(ways)):
            way, (a, b, c) = ways[index], angles[index]
            first, middle, last = (1.0 - way) * (1.0 - 2.0 * way), 4.0 * way * (1.0 - way), way * (2.0 * way - 1.0)
            d, e, f = (first * p + middle * q + last * r for p, q, r in zip(*held, strict=True))
            led = (
                min(max(a + d * softness, low), high),
                min(max(b + e * softness, low), high),
                min(max(c + f * softness, low), high),
            )
            yield Waypoint(index / (len(ways) - 1) * duration, led, self.bound((d, e, f)))


class OnePieceFeed(TrajectoryFeed):
    """Sends each line at once and complete: a sender in virtual time never falls silent."""

    def piece(self, time: float, held: bool = False) -> Piece | None:
        """Return the line if it has not been sent yet."""
        if not self._line or math.isfinite(self._sent):
            return None
        self._sent = time
        return self._line

    def _ran_out(self, time: float) -> bool:
        return False


@functools.lru_cache(maxsize=64)
def _ways(count: int) -> tuple[float, ...]:
    """Return the share of the path covered at the ends of `count` equal shares of a line's time."""
    return tuple(way_done(index / count) for index in range(count + 1))
