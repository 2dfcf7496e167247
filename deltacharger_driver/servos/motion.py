# SPDX-License-Identifier: Apache-2.0
"""Which motion the servos get: trajectories, goals in each cycle, who may move the arm, whether its joints follow.

No ROS; the clock is passed in.
"""

from __future__ import annotations

import enum
import hmac
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from deltacharger_core import machine, real_time
from deltacharger_driver.errors import TrajectoryRefused
from deltacharger_driver.servos.registers import BusSettings, Drive

STALE_AFTER = 0.5  # s, age of a stamp beyond which a trajectory is refused
MOST_POINTS = 1000
"""Most points of a trajectory: 20 s of a line at the planner's spacing. Longer lines are sent in pieces."""
_QUOTED = 60  # characters of a sender's text that a message quotes
STOP_TIME = 0.5
"""s from "goal := present position" to torque off."""
_SOFTER = 4.0  # times softer than by its gains a servo may be: nobody gives the gains' units in mode 5
_FREE, _FREE_STANDING = 0.08, 0.03  # rad of an error without torque; where the encoder reads the same as before
_LATE = 0.03  # s that a goal may be older than the reading
_LASTS = 0.1  # s that an error must last: docking moves its goals behind the arm for half of it before it pulls off
_LASTS_STANDING, _DOUBT = 0.06, 1.15  # s; what a noisy current explains, more there: it lasts too
_FEWEST = 4  # readings that it must last, so that no pause of this computer makes one

FRESH = 0.2  # s, four periods of charger_power; if older, the state is unknown
_PUBLISHERS = 8  # of charger_power that are tracked; a charger has one


@dataclass(frozen=True)
class JointLimits:
    """Limits of a trajectory.

    Attributes:
        names: joint names, in the order of the servos.
        angle_min: smallest angle, rad.
        angle_max: largest angle, rad.
        torque_max: largest torque bound of a servo, N·m.
    """

    names: tuple[str, ...]
    angle_min: float
    angle_max: float
    torque_max: float


@dataclass(frozen=True)
class ServoWaypoint:
    """One point of a received trajectory, in the order of its joint names.

    Attributes:
        time: from the start, s.
        angles: rad.
        torques: bound of each servo from the start of the segment to this point, N·m; empty = unchanged.
    """

    time: float
    angles: Sequence[float]
    torques: Sequence[float] = ()


@dataclass(frozen=True)
class Trajectory:
    """Checked points in the order of the servos, times rising; without points: hold.

    Attributes:
        times: from the start, s.
        angles: rad, per point and servo.
        torques: bound, N·m, per point and servo; None = unchanged.
    """

    times: tuple[float, ...]
    angles: tuple[tuple[float, ...], ...]
    torques: tuple[tuple[float, ...] | None, ...]

    @property
    def is_hold(self) -> bool:
        """Whether it means: stay at the present goal."""
        return not self.times

    @property
    def duration(self) -> float:
        """Time of the last point, s."""
        return self.times[-1] if self.times else 0.0

    def goal_at(self, elapsed: float, start: tuple[float, ...]) -> tuple[float, ...]:
        """Return the goal angles `elapsed` s after the start: linear from `start` to the first point and on.

        Args:
            elapsed: s.
            start: goal angles when it began, rad.
        """
        elapsed = max(elapsed, 0.0)
        previous, since = start, 0.0
        for time, angles in zip(self.times, self.angles, strict=True):
            if elapsed < time:
                share = (elapsed - since) / (time - since)
                return tuple(a + share * (b - a) for a, b in zip(previous, angles, strict=True))
            previous, since = angles, time
        return previous

    def torque_at(self, elapsed: float) -> tuple[float, ...] | None:
        """Return the torque bound of each servo (N·m) at `elapsed` s; None if no point has set one yet.

        A point's bound holds from the time of the previous point, when the motion toward it begins.
        """
        bound: tuple[float, ...] | None = None
        since = 0.0
        for time, torques in zip(self.times, self.torques, strict=True):
            if elapsed < since:
                break
            if torques is not None:
                bound = torques
            since = time
        return bound

    def remaining(self, elapsed: float) -> Trajectory:
        """Return the rest after `elapsed` s as a trajectory that starts then; hold if nothing is left."""
        left = [index for index, time in enumerate(self.times) if time > elapsed]
        if not left:
            return HOLD
        first = left[0]
        return Trajectory(
            tuple(time - elapsed for time in self.times[first:]),
            self.angles[first:],
            (self.torque_at(elapsed), *self.torques[first + 1 :]),
        )


HOLD = Trajectory((), (), ())
"""Stay at the present goal."""


def check(names: Sequence[str], points: Sequence[ServoWaypoint], limits: JointLimits) -> Trajectory:
    """Return the trajectory of `points`, or refuse it entirely.

    Args:
        names: joint of each column, in any order.
        points: in the order of time; none = hold, which needs no names.
        limits: of angles and torque bounds.

    Raises:
        TrajectoryRefused: too many points; a joint unknown, repeated or missing; a number missing or not finite; an
            angle or torque bound outside its limits; or times that do not rise.
    """
    if len(points) > MOST_POINTS:
        raise TrajectoryRefused(f"it has {len(points)} points; send at most {MOST_POINTS} at once")
    if not points and not names:
        return HOLD
    order = _order(names, limits)
    times: list[float] = []
    angles: list[tuple[float, ...]] = []
    torques: list[tuple[float, ...] | None] = []
    for number, point in enumerate(points):
        where = f"point {number}"
        _check_time(where, point.time, times)
        times.append(point.time)
        angles.append(_row(f"{where}: angle", point.angles, order, limits, limits.angle_min, limits.angle_max, " rad"))
        bounded = len(point.torques) > 0
        torques.append(
            _row(f"{where}: effort", point.torques, order, limits, 0.0, limits.torque_max, " N·m") if bounded else None
        )
    return Trajectory(tuple(times), tuple(angles), tuple(torques))


def check_age(age: float) -> None:
    """Refuse a trajectory stamped `age` s ago; negative = in the future, NaN = invalid stamp.

    Raises:
        TrajectoryRefused: NaN, or more than `STALE_AFTER` in the past or future.
    """
    if age > STALE_AFTER:
        old = f"its stamp is {age:.2f} s old, more than {STALE_AFTER} s"
        raise TrajectoryRefused(f"{old}: stamp it with the time of sending, or not at all; {real_time.COMPARE_CLOCKS}")
    if math.isnan(age):
        raise TrajectoryRefused("its stamp is before 1970; use the ROS clock, or no stamp")
    if age < -STALE_AFTER:
        raise TrajectoryRefused(f"its stamp is {-age:.2f} s in the future; {real_time.COMPARE_CLOCKS}")


def _order(names: Sequence[str], limits: JointLimits) -> list[int]:
    """Return the column of each servo."""
    unknown = next((name for name in names if name not in limits.names), "")
    if unknown:
        raise TrajectoryRefused(f"unknown joint {unknown[:_QUOTED]!a}; known: {', '.join(limits.names)}")
    if sorted(names) != sorted(limits.names):
        given = ", ".join(names)[:_QUOTED]
        raise TrajectoryRefused(
            f"it names {len(names)} joints ({given}); name each of the {len(limits.names)} exactly once"
        )
    return [list(names).index(name) for name in limits.names]


def _check_time(where: str, time: float, before: list[float]) -> None:
    if not math.isfinite(time) or time < 0.0:
        raise TrajectoryRefused(f"{where}: time_from_start is {time:g} s; send a finite number ≥ 0")
    if before and time <= before[-1]:
        raise TrajectoryRefused(f"{where}: time_from_start {time:g} s does not rise above {before[-1]:g} s")


def _row(
    what: str,
    values: Sequence[float],
    order: list[int],
    limits: JointLimits,
    low: float,
    high: float,
    unit: str,
) -> tuple[float, ...]:
    if len(values) != len(order):
        raise TrajectoryRefused(f"{what}: {len(values)} numbers for {len(order)} joints")
    row = tuple(float(values[column]) for column in order)
    for name, value in zip(limits.names, row, strict=True):
        if not math.isfinite(value):
            raise TrajectoryRefused(f"{what} of {name} is {value}; send a finite number")
        if not low <= value <= high:
            raise TrajectoryRefused(f"{what} of {name} is {value:.4f}{unit}, outside {low:.4f}…{high:.4f}{unit}")
    return row


class ServoGoals:
    """Goal angle and current bound of each servo; used by one thread.

    Args:
        count: of servos.
        current_bound: of each servo if a trajectory sets none, A.
        torque_constant: N·m/A, converts a trajectory's torque bound into a current.

    Attributes:
        angles: rad; NaN before the first `begin_at`.
        bounds: A.
    """

    def __init__(self, count: int, current_bound: float, torque_constant: float) -> None:
        self.default = (current_bound,) * count
        self.angles: tuple[float, ...] = (math.nan,) * count
        self.bounds = self.default
        self._torque_constant = torque_constant
        self._running: tuple[Trajectory, tuple[float, ...], float] | None = None  # trajectory, start angles, start time

    @property
    def are_moving(self) -> bool:
        """Whether a trajectory is running."""
        return self._running is not None

    def begin_at(self, angles: tuple[float, ...]) -> None:
        """Hold `angles` (rad) with the default bounds."""
        self.angles, self.bounds, self._running = angles, self.default, None

    def hold(self, angles: Sequence[float]) -> None:
        """Hold `angles` (rad) without raising the bounds; a servo whose angle is NaN keeps its goal."""
        self._running = None
        self.angles = tuple(
            goal if math.isnan(angle) else angle for angle, goal in zip(angles, self.angles, strict=True)
        )
        self.bounds = tuple(map(min, self.bounds, self.default))

    def follow(self, trajectory: Trajectory, start: float, now: float) -> None:
        """Replace the running trajectory: move from the present goal to the first point that is not in the past.

        The last point holds.

        Args:
            trajectory: without points: hold the present goal.
            start: time zero of the trajectory, s; if later than `now`, `now` is used.
            now: s.
        """
        self.advance(now)  # if a piece of a line arrives in every cycle, it must not start from the last cycle's goal
        self._running = None
        # A raised bound must not outlive its trajectory: a release must not leave 2.8 A behind.
        if trajectory.is_hold:
            self.bounds = tuple(map(min, self.bounds, self.default))
        else:
            elapsed = max(now - start, 0.0)
            if elapsed < trajectory.times[0]:
                trajectory, elapsed = trajectory.remaining(elapsed), 0.0
            self._running = (trajectory, self.angles, now - elapsed)
            self.bounds = self.default

    def advance(self, now: float) -> None:
        """Update goal and bounds for `now` (s) from the running trajectory."""
        if self._running is None:
            return
        trajectory, start, since = self._running
        elapsed = now - since
        self.angles = trajectory.goal_at(elapsed, start)
        torque = trajectory.torque_at(elapsed)
        if torque is not None:
            self.bounds = tuple(value / self._torque_constant for value in torque)
        if elapsed >= trajectory.duration:
            self._running = None

    def resume_at(self, angles: Sequence[float], now: float) -> None:
        """Start the rest of the trajectory at `angles` (rad) now, so that no servo jumps to catch up."""
        running = self._running
        self.hold(angles)
        if running is not None:
            trajectory, _, since = running
            rest = trajectory.remaining(now - since)
            self._running = None if rest.is_hold else (rest, self.angles, now)


class JointWatch:
    """Whether each joint is where its goal is, and whether its goals are where it can follow, cycle by cycle.

    A servo in mode 5 is a spring: k (goal − angle) = Kt I + d ω. What torque and speed explain is no error, whatever
    the torque: one that rises to its bound does not excuse a joint that stays behind. An encoder that reads one and the
    same angle has less excuse: a joint that really stands has no lag, and one that runs away unseen must be stopped
    early.

    Args:
        settings: ids and joint limits.
        drive: gains, torque constant and type of the servos.

    Attributes:
        strays: why each joint stops the arm, as in ServoState; 0 = it does not. Kept until `begin_at`.
    """

    def __init__(self, settings: BusSettings, drive: Drive) -> None:
        self._settings, self._reach = settings, settings.reach
        self._constant, self._speed = drive.torque_constant, drive.servo.joint_speed
        self._stiffness = drive.servo.stiffness_per_gain * drive.gains[0]
        self._damping = drive.servo.damping_per_gain * drive.gains[1]
        self.begin_at((math.nan,) * len(settings.ids))

    def begin_at(self, goals: Sequence[float]) -> None:
        """Start at these goals, rad."""
        count = len(self._settings.ids)
        self._goals, self._at = tuple(goals), math.nan
        self._angles = [math.nan] * count  # rad, read before
        self._ahead = [0.0] * count  # rad that the goal has moved beyond what its largest speed allows
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
            max(ahead + abs(goal - before) - self._speed * passed, 0.0)
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
                ahead[index] = max(ahead[index] + turn - self._speed * seconds, 0.0)
                if ahead[index] > 2.0 * self.lead(most[index]) and turn > self._speed * seconds:
                    raise TrajectoryRefused(
                        f"point {number}: joint {index} would turn by {turn:.2f} rad within {seconds:.3f} s, faster "
                        f"than {self._speed} rad/s; give it more time"
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
            f"servo {servo} {machine.STRAYS[why]}"
            for servo, why in zip(self._settings.ids, self.strays, strict=True)
            if why
        )
        return "; ".join(found)

    def _stray(self, index: int, goal: float, angle: float, rate: float, current: float) -> int:
        low, high = self._reach
        if angle < low or angle > high:
            return machine.STRAY_OUTSIDE
        error = goal - angle
        stands, self._angles[index] = angle == self._angles[index], angle
        free, seconds, share = (_FREE_STANDING, _LASTS_STANDING, _DOUBT) if stands else (_FREE, _LASTS, 1.0)
        if not (abs(error) > free and abs(error) > free + share * self._explained(error, rate, current)):
            self._since[index], self._readings[index] = math.inf, 0
            return 0
        self._since[index] = min(self._since[index], self._at)
        self._readings[index] += 1
        lasts = self._at - self._since[index] >= seconds and self._readings[index] >= _FEWEST
        return machine.STRAY_BEHIND if lasts else 0

    def _explained(self, error: float, rate: float, current: float) -> float:
        """Return the error (rad) that torque and speed explain."""
        torque = self._constant * current + self._damping * rate
        return (self._yields(torque) if error * torque > 0.0 else 0.0) + _LATE * abs(rate)


class ContactorState(enum.Enum):
    """Known state of the contactor; the value is the text of a refusal."""

    ABSENT = "there is none"
    OPEN = "open"
    ARMED = "the contactor may close at any moment: only the node that moved the arm before the probe may move it"
    CLOSED = "the contactor is closed: the arm must not move until it is open"
    UNKNOWN = (
        "the contactor may be closed, because charger_power is silent or its stamps are wrong: only the node that last "
        "moved the arm while it was open may move it; check tactile_node"
    )


class Sender(NamedTuple):
    """Sender of a trajectory.

    Attributes:
        secret: header.frame_id, which docking_node draws at random at its start.
        publisher: the middleware's id of the publisher; empty if rclpy does not provide it.
    """

    secret: str = ""
    publisher: bytes = b""

    def is_same(self, other: Sender) -> bool:
        """Return whether both are certainly the same sender; False if nothing is known of one."""
        same = hmac.compare_digest(self.secret.encode(), other.secret.encode())
        return same and self.publisher == other.publisher and bool(self.secret or self.publisher)


class _Report(NamedTuple):
    closed: bool
    armed: bool
    measured: float


class MotionGuard:
    """Decides who may move the arm, from the state of the contactor. Used by one thread.

    Electrodes that carry current must not separate. While the contactor is closed, no one moves the arm; docking stands
    still and opens it before it moves. While the contactor may close at any moment, or its state is unknown, only the
    sender that moved the arm when the contactor was last known to be open may move it. Holding is always allowed.

    The last report of each publisher of charger_power counts, and the worst one decides: a publisher that reports
    "open" cannot override another that reports "closed".
    """

    def __init__(self) -> None:
        self._reports: dict[bytes, _Report] = {}
        self._was_received = False
        self._leader = Sender()

    @property
    def was_received(self) -> bool:
        """Whether charger_power was ever received."""
        return self._was_received

    def observe(self, publisher: bytes, closed: bool, armed: bool, age: float, now: float) -> None:
        """Record a charger_power message.

        Args:
            publisher: id of the sender; empty = unknown.
            closed: whether the contactor is closed.
            armed: whether a probe allows it to close.
            age: s since the measurement by its stamp; negative in the future, NaN for an invalid stamp.
            now: s.
        """
        self._was_received = True
        if age > FRESH or not (closed or age >= -real_time.AHEAD):  # a wrong stamp may stop the arm but never free it
            return
        self._reports.pop(publisher, None)
        if len(self._reports) >= _PUBLISHERS:
            del self._reports[next(iter(self._reports))]
        self._reports[publisher] = _Report(closed, armed, now - (age if age > 0.0 else 0.0))

    def state(self, now: float, is_announced: bool) -> ContactorState:
        """Return the state at `now` (s).

        Args:
            now: s.
            is_announced: whether anyone publishes charger_power or serves set_contactor; used only until charger_power
                is first received.
        """
        if not self._was_received:
            return ContactorState.UNKNOWN if is_announced else ContactorState.ABSENT
        fresh = [report for report in self._reports.values() if now - report.measured <= FRESH]
        if not fresh:
            return ContactorState.UNKNOWN
        if any(report.closed for report in fresh):
            return ContactorState.CLOSED
        return ContactorState.ARMED if any(report.armed for report in fresh) else ContactorState.OPEN

    def may_move(self, sender: Sender, state: ContactorState) -> bool:
        """Return whether `sender` may move the arm in this state."""
        if state in (ContactorState.OPEN, ContactorState.ABSENT):
            return True
        return state is not ContactorState.CLOSED and sender.is_same(self._leader)

    def record_move(self, sender: Sender, state: ContactorState) -> None:
        """Record that `sender` moved the arm."""
        if state is ContactorState.OPEN:
            self._leader = sender
