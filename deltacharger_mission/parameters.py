# SPDX-License-Identifier: Apache-2.0
"""Every number that a mission decides by, with its bounds. mission_node declares its ROS parameters from this table."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any


def _number(default: float, low: float, high: float, description: str) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "description": description})


@dataclass(frozen=True)
class MissionParameters:
    """Parameters of the mission state machine; units in the descriptions, reasons in docs/mission.md.

    Raises:
        ValueError: a value lies outside its bounds; the message names it.
    """

    home_x: float = _number(0.0, -1e5, 1e5, "where the base returns to, x in map_frame, m")
    home_y: float = _number(0.0, -1e5, 1e5, "where the base returns to, y in map_frame, m")
    home_yaw: float = _number(0.0, -math.pi, math.pi, "heading there, rad")
    electrodes_x: float = _number(0.0, -5.0, 5.0, "electrodes on the robot to be charged, x in the goal's target, m")
    electrodes_y: float = _number(0.0, -5.0, 5.0, "electrodes on the robot to be charged, y in the goal's target, m")
    electrodes_yaw: float = _number(
        0.0, -math.pi, math.pi, "which way they face, from the target's x toward its y, rad"
    )
    view_distance: float = _number(
        0.20, 0.08, 2.0, "from charger_base to the electrodes where the search begins, m; within the camera's range"
    )
    search_turn: float = _number(0.2, 0.02, 1.0, "turn between two views, rad")
    search_turns: int = _number(2, 0, 8, "turns to either side at each distance")
    search_step: float = _number(0.15, 0.01, 1.0, "step back between two rows of views, m")
    search_steps: int = _number(1, 0, 5, "steps back")
    look_timeout: float = _number(3.0, 0.2, 60.0, "how long the camera looks for the electrodes from one place, s")
    stand_tolerance: float = _number(
        0.03, 0.005, 0.5, "distance from the right place within which the robot does not stand again before docking, m"
    )
    stand_turn_tolerance: float = _number(0.1, 0.01, 1.0, "the same for its heading, rad")
    stands_max: int = _number(3, 0, 10, "how often the robot stands again before it gives up")
    undock_attempts: int = _number(2, 1, 5, "how often undocking is tried before the robot stays where it is")
    wait_timeout: float = _number(10.0, 0.5, 600.0, "limit for WAIT, until all that a mission needs answers, s")
    drive_timeout: float = _number(300.0, 1.0, 86400.0, "limit for DRIVE, s")
    search_timeout: float = _number(180.0, 1.0, 3600.0, "limit for SEARCH, s")
    dock_timeout: float = _number(360.0, 5.0, 7200.0, "limit for DOCK until current flows; above docking's own, s")
    charge_timeout: float = _number(14400.0, 1.0, 86400.0, "limit for CHARGE, s")
    undock_timeout: float = _number(60.0, 1.0, 600.0, "limit for one attempt of UNDOCK, s")
    return_timeout: float = _number(300.0, 1.0, 86400.0, "limit for RETURN, s")
    cancel_timeout: float = _number(30.0, 0.5, 300.0, "how long the end of something called off is waited for, s")
    mission_timeout: float = _number(18000.0, 5.0, 172800.0, "limit for all of it until the way out begins, s")

    def __post_init__(self) -> None:
        for item in fields(self):
            value, bounds = getattr(self, item.name), item.metadata
            if not bounds["low"] <= value <= bounds["high"]:
                raise ValueError(f"{item.name} is {value!r}: allowed are {bounds['low']} to {bounds['high']}")
