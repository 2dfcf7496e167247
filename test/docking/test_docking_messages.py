# SPDX-License-Identifier: Apache-2.0
"""What docking says on joint_trajectory."""

from __future__ import annotations

from builtin_interfaces.msg import Time

from deltacharger_docking.motion import Planner
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.ros import messages as io
from deltacharger_kinematics import DeltaGeometry
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_ros.messages import seconds


def test_a_line_is_sent_with_positions_velocities_and_efforts_and_ends_at_rest() -> None:
    waypoints = Planner(DockingParameters(), DeltaGeometry()).line((0.0, 0.0, 0.0), (0.0, 0.0, 0.06), 0.12)
    message = io.trajectory(waypoints, Time(sec=7))
    assert message.header.stamp.sec == 7
    assert list(message.joint_names) == list(io.JOINTS)
    assert len(message.points) == len(waypoints)
    for point, waypoint in zip(message.points, waypoints, strict=True):
        assert tuple(point.positions) == waypoint.angles
        assert tuple(point.velocities) == waypoint.velocities
        assert tuple(point.effort) == waypoint.torque_bound
        assert abs(seconds(point.time_from_start) - waypoint.time) < 1e-8
    assert list(message.points[-1].velocities) == [0.0, 0.0, 0.0]
    assert max(message.points[len(message.points) // 2].velocities) > 0.5


def test_a_goal_without_velocities_is_sent_without_and_no_points_mean_hold() -> None:
    (point,) = io.trajectory([Waypoint(0.0, (0.1, 0.2, 0.3), (1.0, 1.0, 1.0))], Time()).points
    assert list(point.velocities) == []
    assert not io.trajectory((), Time()).points
