# SPDX-License-Identifier: Apache-2.0
"""A line told piece by piece, so that motion dies with its sender.

A receiver of a whole line follows it to its end, whatever has become of the sender. Here each piece reaches `HORIZON`
ahead of the instant at which it is sent and ends with the goal going back to where the arm is by then: the servos
follow their goal late, by damping / stiffness, so a goal that only stood still would draw the arm on. Pieces overlap:
the next replaces one long before that end, and one that comes late goes on from where the last has left the arm.
Nothing jumps ahead and nothing is skipped, however long the pause.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

from deltacharger_kinematics.geometry import Vector


@dataclass(frozen=True)
class Waypoint:
    """One point of a trajectory: s from its start, arm angles (rad), bound of each servo's torque (N·m).

    `velocities` (rad/s) are those of the angles, None = not told.
    """

    time: float
    angles: Vector
    torque_bound: Vector
    velocities: Vector | None = None


Piece = tuple[Waypoint, ...]

HORIZON = 0.12  # s that a piece reaches ahead: how late the next may come without a stop
PULL_HORIZON = 0.06  # s; shorter, because a pull on the magnets that lapses is only repeated
TURN = 0.01  # s in which the goal goes back to the arm once nothing follows
_PERIOD = 0.015  # s between pieces: every second tick at the servos' 100 Hz
_CLOSE = 0.04  # s from the sending; all waypoints up to here, few beyond, where only a late piece lets the arm come
_SHORTEST = 0.001  # s between two points


class TrajectoryFeed:
    """Turns one line at a time into pieces. Times are those of the caller's clock, s.

    Attributes:
        lag: by how much the arm follows its goal, s.
    """

    def __init__(self, lag: float) -> None:
        self.lag = lag
        self._line: Piece = ()
        self._times: tuple[float, ...] = ()
        self._origin = 0.0  # when the line would have begun, had it never been held
        self._sent = -math.inf  # when its last piece was sent
        self._held: float | None = None  # where on the line it is held, s from its start

    def start(self, line: Piece, time: float) -> None:
        """Begin a line, in place of any other; the receiver goes to its first waypoint from the goal that it has."""
        self._line, self._times = line, tuple(point.time for point in line)
        self._origin, self._sent, self._held = time, -math.inf, None

    def stop(self) -> None:
        """Forget the line."""
        self._line, self._times = (), ()

    @property
    def end(self) -> float:
        """When the line ends (s) if nothing holds it; it must not be empty."""
        return self._origin + self._times[-1]

    def is_under_way(self, time: float) -> bool:
        """Return whether the line has not come to its end; held ones have not."""
        if not self._line:
            return False
        return self._held is not None or self._ran_out(time) or time < self._origin + self._times[-1]

    def share(self, time: float) -> float:
        """Return the share of the line's time at which the receiver's goal is; the line must not be empty."""
        return min(max(self._place(time) / self._times[-1], 0.0), 1.0)

    def hold(self, time: float) -> Piece:
        """Stop on the line and return the piece that says so; empty = stay at the present goal."""
        if not self.is_under_way(time):
            return ()
        place = self._place(time)
        if self._held is None and not self._ran_out(time):
            place = self._behind(place)
        self._held = place
        return (self._sample(place, 0.0, at_rest=True),) if place >= self._times[0] else ()

    def piece(self, time: float, held: bool = False) -> Piece | None:
        """Return what to send now; None = nothing.

        Args:
            time: now.
            held: whether the line may not go on now.
        """
        if not self.is_under_way(time):
            return None
        if held:
            told = self.hold(time) if self._held is None else None
            return told if math.isfinite(self._sent) else None  # what never began need not be stopped
        if self._held is not None or self._ran_out(time):
            self._origin = time - self._place(time)
            self._held = None
        elif math.isfinite(self._sent) and (time - self._sent < _PERIOD or self._place(time) < self._times[0]):
            return None
        self._sent = time
        return self._ahead(time - self._origin)

    def _ahead(self, place: float) -> Piece:
        """Return the points from `place` to the horizon and what follows if nobody says more."""
        end, reach = self._times[-1], place + HORIZON
        ways = [0.0] if place >= self._times[0] else []
        ways += [each - place for each in self._times if place + _SHORTEST < each <= place + _CLOSE]
        ways += [each for each in (0.5 * (_CLOSE + HORIZON), HORIZON) if place + each < end - _SHORTEST]
        points = [self._sample(place + each, each) for each in ways if place + each < end - _SHORTEST]
        if self._is_last(place):
            return (*points, self._sample(end, end - place))
        return (*points, self._sample(self._behind(reach), HORIZON + TURN, at_rest=True))

    def _place(self, time: float) -> float:
        """Return where on the line (s from its start) the receiver's goal is now."""
        if self._held is not None:
            return self._held
        if self._ran_out(time):
            return self._behind(self._sent - self._origin + HORIZON)
        return time - self._origin

    def _ran_out(self, time: float) -> bool:
        """Return whether the last piece has brought the goal back to the arm."""
        told = math.isfinite(self._sent)
        return told and time - self._sent > HORIZON and not self._is_last(self._sent - self._origin)

    def _is_last(self, place: float) -> bool:
        """Return whether a piece sent at `place` leads to the end of the line."""
        return self._times[-1] - place <= HORIZON + _SHORTEST

    def _behind(self, place: float) -> float:
        """Return where on the line the arm is when its goal is at `place`."""
        return max(place - self.lag, min(place, self._times[0]))

    def _sample(self, place: float, offset: float, at_rest: bool = False) -> Waypoint:
        """Return the line's point at `place` for `offset` s after the sending; between waypoints linear in angles."""
        index = min(bisect_left(self._times, place), len(self._times) - 1)
        after, before = self._line[index], self._line[max(index - 1, 0)]
        span = after.time - before.time
        share = min(max((place - before.time) / span, 0.0), 1.0) if span > 0.0 else 1.0
        velocities: Vector | None = None
        if after.velocities is not None and before.velocities is not None:
            velocities = (0.0, 0.0, 0.0) if at_rest else between(before.velocities, after.velocities, share)
        return Waypoint(offset, between(before.angles, after.angles, share), after.torque_bound, velocities)


def pull(goal: Vector, bound: Vector, rest: Vector, rest_bound: Vector) -> Piece:
    """Return the piece that puts the goal at `goal` under `bound` at once and, unless repeated, ends at `rest`.

    Args:
        goal: angles to pull toward, rad.
        bound: of each servo's torque, N·m.
        rest: angles where the arm is, rad.
        rest_bound: of each servo's torque from the end on, N·m.
    """
    pulled = tuple(Waypoint(time, goal, bound) for time in (0.0, 0.02, PULL_HORIZON))
    return (*pulled, Waypoint(PULL_HORIZON + TURN, rest, rest_bound))


def between(a: Vector, b: Vector, share: float) -> Vector:
    """Return the point of a straight line that lies `share` of the way from a to b."""
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
