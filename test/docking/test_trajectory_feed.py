# SPDX-License-Identifier: Apache-2.0
"""A line sent piece by piece: the receiver follows the same line, and stops early if the sender stops."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest

from deltacharger_docking.motion import Planner
from deltacharger_docking.parameters import DockingParameters
from deltacharger_driver.servos import trajectory as driver
from deltacharger_kinematics import DeltaGeometry
from deltacharger_kinematics.trajectory_feed import HORIZON, PULL_HORIZON, TURN, Piece, TrajectoryFeed, Waypoint, pull

TICK = 0.01
LAG = 0.06
LINE = Planner(DockingParameters(), DeltaGeometry()).line((0.0, 0.0, 0.0), (0.01, -0.02, 0.062), 0.12)
SLOW = Planner(DockingParameters(), DeltaGeometry()).line((0.0, 0.0, 0.0), (0.0, 0.0, 0.060), 0.03)
END = LINE[-1].time
LIMITS = driver.JointLimits(("a", "b", "c"), -math.pi, math.pi, 10.0)


def checked(piece: Sequence[Waypoint]) -> driver.Trajectory:
    """The piece as servo_node reads it; refused pieces raise."""
    points = [driver.ServoWaypoint(point.time, point.angles, point.torque_bound) for point in piece]
    return driver.check(LIMITS.names if points else (), points, LIMITS)


def peak_speed(line: Piece) -> float:
    return max(max(map(abs, point.velocities or ())) for point in line)


class Listener:
    """Follows pieces from their arrival on, as linear motion of the goal, with a first-order arm."""

    def __init__(self, lag: float = LAG) -> None:
        self._lag = lag
        self._trajectory = checked(())
        self._since, self._start = 0.0, (0.0, 0.0, 0.0)
        self.goal = self.arm = LINE[0].angles
        self.pieces: list[Piece] = []

    def hear(self, piece: Piece | None, time: float) -> None:
        if piece is None:
            return
        self.advance(time, 0.0)
        self.pieces.append(piece)
        self._trajectory, self._since, self._start = checked(piece), time, self.goal

    def advance(self, time: float, step: float) -> None:
        if not self._trajectory.is_hold:
            goal = self._trajectory.goal_at(time - self._since, self._start)
            self.goal = goal[0], goal[1], goal[2]
        share = 1.0 - math.exp(-step / self._lag)
        moved = [arm + share * (goal - arm) for arm, goal in zip(self.arm, self.goal, strict=True)]
        self.arm = moved[0], moved[1], moved[2]


def drive(
    feed: TrajectoryFeed,
    listener: Listener,
    end: float,
    received: Callable[[float], bool] = lambda now: True,
    held: Callable[[float], bool] = lambda now: False,
) -> np.ndarray:
    """Run sender and receiver for `end` s; rows of time, goal and arm angles."""
    rows = []
    for step in range(1 + round(end / TICK)):
        now = step * TICK
        listener.advance(now, TICK if step else 0.0)
        rows.append((now, *listener.goal, *listener.arm))
        if received(now):
            listener.hear(feed.piece(now, held(now)), now)
    return np.array(rows)


def begun(line: Piece = LINE, lag: float = LAG) -> TrajectoryFeed:
    feed = TrajectoryFeed(lag)
    feed.start(line, 0.0)
    return feed


def test_pieces_sent_in_time_give_the_goal_of_the_complete_line_at_every_tick() -> None:
    listener, whole = Listener(), checked(LINE)
    for now, *goal in drive(begun(), listener, END + 0.1)[:, :4]:
        assert goal == pytest.approx(whole.goal_at(now, LINE[0].angles), abs=1e-12)
    assert len(listener.pieces) > 5


@pytest.mark.parametrize("lag", [0.02, LAG, 0.364])
@pytest.mark.parametrize("line", [LINE, SLOW, LINE[:2], LINE[:1]])
def test_pieces_are_short_never_refused_and_end_exactly_at_the_goal(line: Piece, lag: float) -> None:
    draw, feed, now = random.Random(3), begun(line, lag), 0.0
    pieces: list[Piece] = []
    while feed.is_under_way(now):
        piece = feed.piece(now)
        if piece is not None:
            pieces.append(piece)
        now += draw.choice((0.004, 0.01, 0.011, 0.03, 0.1))
    for piece in pieces:
        trajectory = checked(piece)
        assert trajectory.duration <= HORIZON + TURN
        assert len(piece) <= 8
        assert all(later.time - sooner.time > 5e-4 for sooner, later in pairwise(piece))
    assert pieces[-1][-1].angles == line[-1].angles
    assert pieces[-1][-1].torque_bound == line[-1].torque_bound
    assert feed.piece(now) is None


@pytest.mark.parametrize("seed", range(5))
def test_late_ticks_within_the_horizon_neither_stop_nor_delay_the_goal(seed: int) -> None:
    draw = random.Random(seed)
    due = [0.0]

    def received(now: float) -> bool:
        if now < due[0]:
            return False
        due[0] = now + draw.uniform(0.0, HORIZON - 2 * TICK)
        return True

    rows, whole = drive(begun(), Listener(), END), checked(LINE)
    late = drive(begun(), Listener(), END, received)
    goals = np.array([whole.goal_at(now, LINE[0].angles) for now in late[:, 0]])
    assert np.abs(late[:, 1:4] - goals).max() < 0.003, "chords of a curved way, in rad"
    assert np.abs(late[-1, 1:4] - rows[-1, 1:4]).max() < 1e-9


@pytest.mark.parametrize("lag", [0.02, LAG, 0.364])
@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_the_arm_stands_still_once_the_sender_has_been_silent_for_the_horizon(share: float, lag: float) -> None:
    gone = share * END
    rows = drive(begun(lag=lag), Listener(lag), END + 1.0, received=lambda now: now < gone)
    stopped = rows[rows[:, 0] >= gone + HORIZON + TURN + TICK]
    assert np.ptp(stopped[:, 1:4], axis=0).max() == 0.0, "the goal rests"
    drift = np.abs(stopped[-1, 4:] - stopped[0, 4:]).max()
    assert drift < 0.25 * lag * peak_speed(LINE), "and the arm is not drawn after it by its whole lag"
    left = np.abs(np.subtract(LINE[-1].angles, stopped[-1, 4:])).max()
    assert left > 0.1, "far from the end, rad"


@pytest.mark.parametrize("silence", [0.2, 3.0])
def test_a_returning_sender_continues_from_where_it_left_the_arm(silence: float) -> None:
    gone = 0.4 * END
    rows = drive(begun(), Listener(), END + silence + 0.2, received=lambda now: not gone < now < gone + silence)
    back = rows[:, 0] > gone + silence
    steps = np.abs(np.diff(rows[:, 1:4], axis=0)).max(axis=1)
    assert steps[back[1:]].max() < 1.1 * TICK * peak_speed(LINE), "nothing jumps to catch up"
    assert rows[-1, 1:4] == pytest.approx(LINE[-1].angles, abs=1e-9)


def test_a_paused_line_stops_at_once_and_continues_with_the_rest() -> None:
    feed, listener = begun(), Listener()
    since, until = 0.4 * END, 0.4 * END + 0.5
    rows = drive(feed, listener, END + 0.7, held=lambda now: since <= now < until)
    time, goal, arm = rows[:, 0], rows[:, 1:4], rows[:, 4:]
    still = (time > since + 2 * TICK) & (time < until)
    assert np.ptp(goal[still], axis=0).max() == 0.0
    assert np.ptp(arm[still], axis=0).max() < 0.25 * LAG * peak_speed(LINE)
    steps = np.abs(np.diff(goal, axis=0)).max(axis=1)
    assert steps[time[1:] > until].max() < 1.1 * TICK * peak_speed(LINE)
    assert goal[-1] == pytest.approx(LINE[-1].angles, abs=1e-9)
    assert sum(len(piece) == 1 for piece in listener.pieces) == 1, "a hold is sent once"
    arrival = time[np.abs(goal - LINE[-1].angles).max(axis=1) < 1e-9][0]
    assert arrival >= END + 0.5, "the time held is not made up for"


def test_a_line_held_before_it_began_leaves_the_goal_where_it_is() -> None:
    feed = begun()
    assert feed.piece(0.0, held=True) is None
    assert feed.piece(TICK, held=True) is None
    assert feed.is_under_way(100.0)
    first = feed.piece(100.0)
    assert first is not None
    assert first[0].angles == LINE[0].angles
    assert first[0].time == LINE[0].time


def test_velocities_match_the_line_and_a_piece_that_ends_early_ends_at_rest() -> None:
    piece = begun().piece(0.5 * END)
    assert piece is not None
    assert max(map(abs, piece[0].velocities or ())) == pytest.approx(peak_speed(LINE), rel=0.1)
    assert piece[-1].velocities == (0.0, 0.0, 0.0)
    bare = tuple(Waypoint(point.time, point.angles, point.torque_bound) for point in LINE)
    piece = begun(bare).piece(0.0)
    assert piece is not None
    assert {point.velocities for point in piece} == {None}


def test_a_line_that_is_stopped_or_replaced_is_no_longer_sent() -> None:
    feed = begun()
    feed.piece(0.0)
    feed.stop()
    assert not feed.is_under_way(0.1)
    assert feed.piece(0.1) is None
    assert feed.hold(0.1) == ()
    feed.start(LINE, 0.2)
    feed.start(SLOW, 0.3)
    piece = feed.piece(0.3)
    assert piece is not None
    assert piece[0] == SLOW[0]


def test_a_pull_that_is_not_repeated_ends_at_the_arms_place_under_the_weaker_bound() -> None:
    goal, rest = (0.0, 0.0, 0.0), (0.2, 0.2, 0.2)
    trajectory = checked(pull(goal, (4.0,) * 3, rest, (0.9,) * 3))
    for elapsed in (0.0, 0.03, PULL_HORIZON - 1e-6):
        assert trajectory.goal_at(elapsed, rest) == goal
        assert trajectory.torque_at(elapsed) == (4.0,) * 3
    assert trajectory.goal_at(1.0, rest) == rest
    assert trajectory.torque_at(PULL_HORIZON) == (0.9,) * 3
