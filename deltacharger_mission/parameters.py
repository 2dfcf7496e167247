# SPDX-License-Identifier: Apache-2.0
"""Every parameter of missions, with its bounds. mission_node declares its ROS parameters from this table."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, choice, like, tunable, words
from deltacharger_core.texts import ON_MAP, ON_ROBOT
from deltacharger_docking.parameters import DockingNodeParameters


@dataclass(frozen=True)
class MissionParameters(Bounded):
    """Parameters of the mission state machine, which can be set between goals; reasons in docs/mission.md.

    Raises:
        ParameterError: a value lies outside its bounds.
    """

    home_x: float = tunable(0.0, -ON_MAP, ON_MAP, "m", "home of the base, x in map_frame")
    home_y: float = tunable(0.0, -ON_MAP, ON_MAP, "m", "home of the base, y in map_frame")
    home_yaw: float = tunable(0.0, -math.pi, math.pi, "rad", "heading at home")
    electrodes_x: float = tunable(
        0.0, -ON_ROBOT, ON_ROBOT, "m", "electrodes on the robot to be charged, x in the goal's target"
    )
    electrodes_y: float = tunable(
        0.0, -ON_ROBOT, ON_ROBOT, "m", "electrodes on the robot to be charged, y in the goal's target"
    )
    electrodes_yaw: float = tunable(
        0.0, -math.pi, math.pi, "rad", "direction that the electrodes face, from x toward y"
    )
    view_distance: float = tunable(0.20, 0.08, 2.0, "m", "distance from the electrodes at which the search begins")
    search_turns: int = tunable(2, 0, 8, "", "turns to each side at each distance, each by 0.2 rad")
    search_steps: int = tunable(1, 0, 5, "", "number of steps back, each by 0.15 m")
    stand_tolerance: float = tunable(0.03, 0.005, 0.5, "m", "largest distance from the right place when docking starts")
    stand_turn_tolerance: float = tunable(0.05, 0.01, 1.0, "rad", "largest error of the heading when docking starts")
    stands_max: int = tunable(3, 0, 10, "", "most moves to a better place for docking")
    undock_attempts: int = tunable(2, 1, 5, "", "attempts to undock before the robot stays where it is")
    drive_timeout: float = tunable(300.0, 1.0, 86400.0, "s", "limit for DRIVE and for RETURN")
    search_timeout: float = tunable(180.0, 1.0, 3600.0, "s", "limit for SEARCH")
    dock_timeout: float = tunable(360.0, 5.0, 7200.0, "s", "limit for DOCK until current flows; above goal_timeout")
    charge_timeout: float = tunable(14400.0, 1.0, 86400.0, "s", "limit for CHARGE")
    mission_timeout: float = tunable(18000.0, 5.0, 172800.0, "s", "limit for a mission until its final steps begin")


@dataclass(frozen=True)
class MissionNodeParameters(Bounded):
    """Navigation, and the charger's place on the robot."""

    navigation: str = choice("none", ("nav2", "none"), "nav2 drives the robot; none: the target comes to the charger")
    map_frame: str = words("map", "the navigator's frame: of home, and of targets if tf2_ros is installed")
    behavior_tree: str = words("", "file of the navigator's behavior tree; empty = the navigator's default")
    precise_behavior_tree: str = words("", "file of its behavior tree for small moves near the target; empty = default")
    base_frame: str = like(DockingNodeParameters, "base_frame", text="full name of the robot's frame")
    base_pose: tuple[float, ...] = like(
        DockingNodeParameters, "base_pose", text="charger_base on the robot, in {unit}, as in docking_node"
    )
