# SPDX-License-Identifier: Apache-2.0
"""Every parameter of missions, with its bounds. mission_node declares its ROS parameters from this table."""

import math
from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, choice, like, number, words
from deltacharger_core.texts import ON_MAP, ON_ROBOT
from deltacharger_docking.parameters import DockingNodeParameters


@dataclass(frozen=True)
class MissionParameters(Bounded):
    """Parameters of missions: the site, the mount of the arm, the navigator, and two limits; see docs/mission.md.

    Raises:
        ParameterError: a value lies outside its bounds.
    """

    home_x: float = number(0.0, -ON_MAP, ON_MAP, "m", "home of the base, x in map_frame")
    home_y: float = number(0.0, -ON_MAP, ON_MAP, "m", "home of the base, y in map_frame")
    home_yaw: float = number(0.0, -math.pi, math.pi, "rad", "heading at home")
    electrodes_x: float = number(0.0, -ON_ROBOT, ON_ROBOT, "m", "electrodes on the target robot, x")
    electrodes_y: float = number(0.0, -ON_ROBOT, ON_ROBOT, "m", "electrodes on the target robot, y")
    electrodes_yaw: float = number(0.0, -math.pi, math.pi, "rad", "direction that the electrodes face, from x toward y")
    view_distance: float = number(0.20, 0.08, 2.0, "m", "distance from the electrodes at which the search begins")
    drive_timeout: float = number(300.0, 1.0, 86400.0, "s", "limit for DRIVE and for RETURN")
    charge_timeout: float = number(14400.0, 1.0, 86400.0, "s", "limit for CHARGE")
    navigation: str = choice("none", ("nav2", "none"), "nav2 drives the robot; none: the target comes to the charger")
    map_frame: str = words("map", "the navigator's frame: of home and of targets")
    behavior_tree: str = words("", "file of the navigator's behavior tree; empty = the navigator's default")
    precise_behavior_tree: str = words("", "file of its behavior tree for small moves near the target; empty = default")
    base_frame: str = like(DockingNodeParameters, "base_frame", text="full name of the robot's frame")
    base_pose: tuple[float, ...] = like(
        DockingNodeParameters, "base_pose", text="charger_base on the robot, in {unit}, as in docking_node"
    )
