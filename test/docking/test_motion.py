# SPDX-License-Identifier: Apache-2.0
"""Lines of docking: with the arm's weight fed forward, bounded, refused before any motion, and sent piece by piece.

The receiver of the pieces follows the same line, and stops early if the sender stops.
"""

import math
import random
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest

from deltacharger_docking import codes, parameters
from deltacharger_docking.arm import Planner
from deltacharger_driver.servos import motion as driver
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.trajectory_feed import HORIZON, PULL_HORIZON, TURN, Piece, TrajectoryFeed, Waypoint, pull

HOME, STANDOFF = (0.0, 0.0, 0.0), (0.010, -0.020, 0.062)
PARAMETERS = parameters.DockingParameters()
DELTA = Delta()
PLANNER = Planner(PARAMETERS, DeltaGeometry())


def table(waypoints: tuple[Waypoint, ...], name: str) -> np.ndarray:
    return np.array([getattr(point, name) for point in waypoints])


def test_commands_lead_the_line_by_the_servos_yield_under_the_arms_weight() -> None:
    waypoints = PLANNER.line(HOME, STANDOFF, 0.12)
    held = DELTA.holding_torque(STANDOFF, PARAMETERS.gravity)
    lead = np.subtract(waypoints[-1].angles, DELTA.inverse(STANDOFF).angles)
    assert np.allclose(lead * PARAMETERS.servo_stiffness, held, atol=1e-12)
    assert np.abs(lead).max() > math.radians(0.5)
    weightless = Planner(parameters.DockingParameters(gravity=(0.0, 0.0, 0.0)), DeltaGeometry()).line(
        HOME, STANDOFF, 0.12
    )
    assert np.allclose(weightless[-1].angles, DELTA.inverse(STANDOFF).angles, atol=1e-15)


def test_commands_stay_inside_the_joint_limits_and_rest_where_they_are_cut() -> None:
    goal = (0.010, 0.020, 0.062)  # here the weight acts on the arm that is turned farthest
    limit = float(DELTA.inverse(goal).angles.max()) + 1e-6
    waypoints = Planner(PARAMETERS, DeltaGeometry(joint_max=limit)).line(HOME, goal, 0.12)
    angles, velocities = table(waypoints, "angles"), table(waypoints, "velocities")
    cut = angles == limit
    assert cut.sum() > 1
    assert angles.max() == limit
    assert not velocities[cut].any()
    assert velocities[~cut].any()


@pytest.mark.parametrize("goal", [(0.0, 0.0, 0.190), (0.150, 0.0, 0.080), (0.0, 0.0, 0.5)])
def test_a_line_or_a_last_leg_that_leaves_the_limits_is_unreachable(goal: tuple[float, float, float]) -> None:
    with pytest.raises(codes.Unreachable, match="along the line"):
        PLANNER.line((0.0, 0.0, 0.080), goal, 0.12)
    PLANNER.check_way(0.12, HOME, STANDOFF, HOME)
    with pytest.raises(codes.Unreachable):
        PLANNER.check_way(0.12, HOME, STANDOFF, HOME, goal)


TICK = 0.01
LAG = 0.06
LINE = Planner(parameters.DockingParameters(), DeltaGeometry()).line((0.0, 0.0, 0.0), (0.01, -0.02, 0.062), 0.12)
SLOW = Planner(parameters.DockingParameters(), DeltaGeometry()).line((0.0, 0.0, 0.0), (0.0, 0.0, 0.060), 0.03)
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


@pytest.mark.parametrize(("lag", "share"), [(0.02, 0.1), (LAG, 0.3), (0.364, 0.5)])
def test_the_arm_stands_still_once_the_sender_has_been_silent_for_the_horizon(lag: float, share: float) -> None:
    gone = share * END
    rows = drive(begun(lag=lag), Listener(lag), END + 1.0, received=lambda now: now < gone)
    stopped = rows[rows[:, 0] >= gone + HORIZON + TURN + TICK]
    assert np.ptp(stopped[:, 1:4], axis=0).max() == 0.0, "the goal rests"
    drift = np.abs(stopped[-1, 4:] - stopped[0, 4:]).max()
    assert drift < 0.25 * lag * peak_speed(LINE), "and the arm is not drawn after it by its whole lag"
    left = np.abs(np.subtract(LINE[-1].angles, stopped[-1, 4:])).max()
    assert left > 0.1, "far from the end, rad"


def test_a_pull_that_is_not_repeated_ends_at_the_arms_place_under_the_weaker_bound() -> None:
    goal, rest = (0.0, 0.0, 0.0), (0.2, 0.2, 0.2)
    trajectory = checked(pull(goal, (4.0,) * 3, rest, (0.9,) * 3))
    for elapsed in (0.0, 0.03, PULL_HORIZON - 1e-6):
        assert trajectory.goal_at(elapsed, rest) == goal
        assert trajectory.torque_at(elapsed) == (4.0,) * 3
    assert trajectory.goal_at(1.0, rest) == rest
    assert trajectory.torque_at(PULL_HORIZON) == (0.9,) * 3
