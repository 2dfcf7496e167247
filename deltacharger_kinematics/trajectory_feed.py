# SPDX-License-Identifier: Apache-2.0
"""Sends a line in short pieces, so that motion stops when its sender stops.

A receiver of a complete line would follow it to the end even if the sender had died. Here each piece reaches `HORIZON`
ahead of its sending and ends with the goal returning to the arm's position at that time. This is necessary because the
servos follow their goal with a delay of damping / stiffness: a goal that only stood still would pull the arm on. Pieces
overlap: the next one replaces the last long before its end. A late piece continues where the last one has left the arm,
so the goal never jumps or skips, however long the pause.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass

from deltacharger_kinematics.geometry import Vector


@dataclass(frozen=True)
class Waypoint:
    """One point of a trajectory: time (s) from its start, arm angles (rad), torque bound of each servo (N·m).

    `velocities`: of the angles, rad/s; None = not given.
    """

    time: float
    angles: Vector
    torque_bound: Vector
    velocities: Vector | None = None


Piece = tuple[Waypoint, ...]

HORIZON = 0.12  # s that a piece reaches ahead: maximum delay of the next one without a stop
PULL_HORIZON = 0.06  # s; shorter, because an expired pull on the magnets is simply repeated
TURN = 0.01  # s in which the goal returns to the arm if no piece follows
_PERIOD = 0.015  # s between pieces: every second tick at the servos' 100 Hz
_CLOSE = 0.04  # s from the sending; all waypoints up to here, few beyond, which are used only if the next is late
_SHORTEST = 0.001  # s between two points


class TrajectoryFeed:
    """Splits one line at a time into pieces. Times are by the caller's clock, s.

    Attributes:
        lag: delay of the arm behind its goal, s.
    """

    def __init__(self, lag: float) -> None:
        self.lag = lag
        self._line: Piece = ()
        self._times: tuple[float, ...] = ()
        self._origin = 0.0  # start time of the line, shifted by the time it was held
        self._sent = -math.inf  # time of its last piece
        self._held: float | None = None  # place where it is held, s from the line's start

    def start(self, line: Piece, time: float) -> None:
        """Start a line; it replaces any other. The receiver moves from its present goal to the first waypoint."""
        self._line, self._times = line, tuple(point.time for point in line)
        self._origin, self._sent, self._held = time, -math.inf, None

    def stop(self) -> None:
        """Drop the line."""
        self._line, self._times = (), ()

    @property
    def end(self) -> float:
        """End time of the line (s) unless it is held; the line must not be empty."""
        return self._origin + self._times[-1]

    def is_under_way(self, time: float) -> bool:
        """Return whether the line has not ended; a held line has not."""
        if not self._line:
            return False
        return self._held is not None or self._ran_out(time) or time < self._origin + self._times[-1]

    def share(self, time: float) -> float:
        """Return the receiver's goal as a share of the line's time; the line must not be empty."""
        return min(max(self._place(time) / self._times[-1], 0.0), 1.0)

    def hold(self, time: float) -> Piece:
        """Stop on the line and return the piece for it; empty = stay at the present goal."""
        if not self.is_under_way(time):
            return ()
        place = self._place(time)
        if self._held is None and not self._ran_out(time):
            place = self._behind(place)
        self._held = place
        return (self._sample(place, 0.0, at_rest=True),) if place >= self._times[0] else ()

    def piece(self, time: float, held: bool = False) -> Piece | None:
        """Return the piece to send now; None = nothing.

        Args:
            time: now.
            held: whether the line must wait now.
        """
        if not self.is_under_way(time):
            return None
        if held:
            stop = self.hold(time) if self._held is None else None
            return stop if math.isfinite(self._sent) else None  # a line that never began needs no stop
        if self._held is not None or self._ran_out(time):
            self._origin = time - self._place(time)
            self._held = None
        elif math.isfinite(self._sent) and (time - self._sent < _PERIOD or self._place(time) < self._times[0]):
            return None
        self._sent = time
        return self._ahead(time - self._origin)

    def _ahead(self, place: float) -> Piece:
        """Return the points from `place` to the horizon, and the return to the arm in case no piece follows."""
        end, reach = self._times[-1], place + HORIZON
        ways = [0.0] if place >= self._times[0] else []
        ways += [each - place for each in self._times if place + _SHORTEST < each <= place + _CLOSE]
        ways += [each for each in (0.5 * (_CLOSE + HORIZON), HORIZON) if place + each < end - _SHORTEST]
        points = [self._sample(place + each, each) for each in ways if place + each < end - _SHORTEST]
        if self._is_last(place):
            return (*points, self._sample(end, end - place))
        return (*points, self._sample(self._behind(reach), HORIZON + TURN, at_rest=True))

    def _place(self, time: float) -> float:
        """Return the place of the receiver's goal on the line now, s from its start."""
        if self._held is not None:
            return self._held
        if self._ran_out(time):
            return self._behind(self._sent - self._origin + HORIZON)
        return time - self._origin

    def _ran_out(self, time: float) -> bool:
        """Return whether the last piece has returned the goal to the arm."""
        sent = math.isfinite(self._sent)
        return sent and time - self._sent > HORIZON and not self._is_last(self._sent - self._origin)

    def _is_last(self, place: float) -> bool:
        """Return whether a piece sent at `place` reaches the end of the line."""
        return self._times[-1] - place <= HORIZON + _SHORTEST

    def _behind(self, place: float) -> float:
        """Return the arm's place on the line when its goal is at `place`."""
        return max(place - self.lag, min(place, self._times[0]))

    def _sample(self, place: float, offset: float, at_rest: bool = False) -> Waypoint:
        """Return the line's point at `place` for `offset` s after sending; angles are interpolated linearly."""
        index = min(bisect_left(self._times, place), len(self._times) - 1)
        after, before = self._line[index], self._line[max(index - 1, 0)]
        span = after.time - before.time
        share = min(max((place - before.time) / span, 0.0), 1.0) if span > 0.0 else 1.0
        velocities: Vector | None = None
        if after.velocities is not None and before.velocities is not None:
            velocities = (0.0, 0.0, 0.0) if at_rest else between(before.velocities, after.velocities, share)
        return Waypoint(offset, between(before.angles, after.angles, share), after.torque_bound, velocities)


def pull(goal: Vector, bound: Vector, rest: Vector, rest_bound: Vector) -> Piece:
    """Return the piece that sets the goal to `goal` under `bound` at once and, unless repeated, ends at `rest`.

    Args:
        goal: angles to pull toward, rad.
        bound: torque bound of each servo, N·m.
        rest: present angles of the arm, rad.
        rest_bound: torque bound of each servo from the end on, N·m.
    """
    pulled = tuple(Waypoint(time, goal, bound) for time in (0.0, 0.02, PULL_HORIZON))
    return (*pulled, Waypoint(PULL_HORIZON + TURN, rest, rest_bound))


def between(a: Vector, b: Vector, share: float) -> Vector:
    """Return the point at `share` of the straight line from a to b."""
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
