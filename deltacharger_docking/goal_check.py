# SPDX-License-Identifier: Apache-2.0
"""Which goals can be served, and where the robot should stand for those that cannot."""

from __future__ import annotations

import math

from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_docking.codes import DockingError, Rejected, Unreachable
from deltacharger_docking.motion import Planner
from deltacharger_docking.observation import DockGoal, ElectrodePose
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import Vector


def check_goal(goal: DockGoal, planner: Planner, parameters: DockingParameters) -> None:
    """Refuse a goal that cannot be served as given, before anything moves.

    Raises:
        Rejected: a number is not finite or outside its bounds.
        Unreachable: the electrodes lie outside the workspace.
    """
    limit = parameters.critical_angle
    if not math.isfinite(goal.critical_angle) or goal.critical_angle < 0.0:
        raise Rejected(f"critical_angle is {goal.critical_angle}: give rad ≥ 0 (0 = the parameter)")
    if goal.critical_angle > limit:
        raise Rejected(f"critical_angle may only be lowered; the limit is {limit:.4f} rad, not {goal.critical_angle}")
    for name in ("stop_energy", "stop_after"):
        value = getattr(goal, name)
        if not math.isfinite(value) or value < 0.0:
            raise Rejected(f"{name} is {value}: give a finite number ≥ 0 (0 = none)")
    if goal.electrodes is not None:
        check_place(goal.electrodes, planner, parameters)


def check_place(electrodes: ElectrodePose, planner: Planner, parameters: DockingParameters) -> None:
    """Refuse electrodes (charger_base) that are not finite or out of reach; errors as in `check_goal`."""
    x, y, z = electrodes.position
    if not all(math.isfinite(value) for value in (x, y, z, electrodes.roll)):
        raise Rejected("the electrodes' pose is not finite; send numbers, or an empty frame_id to use the camera")
    wrong = planner.reachable((x, y, z), (x, y, z - parameters.standoff))
    if wrong:
        dx, dy, dz = (f"{1000 * value:+.0f}" for value in (x, y, z - DOCK_DISTANCE))
        raise Unreachable(
            f"the electrodes are out of the arm's reach, {wrong}; move the robot by ({dx}, {dy}, {dz}) mm of "
            "charger_base, to suggested_base_pose",
            (x, y, z),
        )


def suggested_base(error: DockingError) -> Vector | None:
    """Return where charger_base should stand (m, in the present one) to face electrodes that are out of reach."""
    if not isinstance(error, Unreachable) or error.electrodes is None:
        return None
    x, y, z = error.electrodes
    return x, y, z - DOCK_DISTANCE
