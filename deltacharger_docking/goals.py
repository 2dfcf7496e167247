# SPDX-License-Identifier: Apache-2.0
"""Goals: their checks, and the suggested position of the robot for unreachable ones."""

import math
from collections.abc import Mapping

from deltacharger_core import machine, texts
from deltacharger_core.parameters import did_you_mean
from deltacharger_docking import arm, clearance, codes, observation, release
from deltacharger_docking.context import Context
from deltacharger_docking.parameters import DockingParameters, TargetProfile


def check_goal(
    goal: observation.DockGoal,
    planner: arm.Planner,
    parameters: DockingParameters,
    profiles: Mapping[str, TargetProfile],
) -> None:
    """Refuse a goal that cannot be served as given, before anything moves.

    Raises:
        Rejected: a number is not finite or outside its bounds, or no profile says what the target allows.
        Unreachable: the electrodes lie outside the workspace.
    """
    check_id(goal.request_id)
    if problem := texts.outside(goal.critical_angle, 0.0, parameters.critical_angle, "rad"):
        raise codes.Rejected(f"critical_angle: {problem}; a goal may only lower the parameter (0 = the parameter)")
    check_stops(goal.stop_energy, goal.stop_after)
    if parameters.always_live:
        _check_live(goal)
    elif goal.start_charging and not profiles:
        raise codes.Rejected("no current flows without a profile: set docking_node's target_profiles (docs/targets.md)")
    elif (name := goal.target_profile) and name not in profiles:
        known = did_you_mean(name, profiles) or f"; known are {', '.join(profiles) or 'none'}"
        raise codes.Rejected(f"target_profile '{name}' is unknown{known} (docs/targets.md)")
    if goal.electrodes is not None:
        check_place(goal.electrodes, planner, parameters)


def _check_live(goal: observation.DockGoal) -> None:
    """Refuse requests that are impossible with electrodes wired to the battery.

    Raises:
        Rejected: the goal asks for contact without current, or for counted energy.
    """
    if not goal.start_charging:
        raise codes.Rejected("power: none: contact without current is impossible: set start_charging, or undock")
    if goal.stop_energy:
        raise codes.Rejected(
            "power: none: this charger does not measure energy; leave stop_energy 0 and give stop_after"
        )
    if goal.target_profile:
        raise codes.Rejected("power: none: nothing limits the current, so leave target_profile empty (docs/targets.md)")


def check_change(goal: observation.DockGoal, context: Context) -> None:
    """Refuse a goal that would charge a target by another profile than the one by which it is being charged.

    Raises:
        Rejected: it would.
    """
    wanted = goal.target_profile or next(iter(context.profiles), "")
    if context.status.charging and goal.start_charging and wanted != context.profile_name:
        raise codes.Rejected(
            f"the target is being charged by profile '{context.profile_name}', not '{wanted}': undock it"
        )


def check_id(request_id: str) -> None:
    """Refuse a request_id that is too long.

    Raises:
        Rejected: it is.
    """
    if problem := texts.wrong_id(request_id):
        raise codes.Rejected(problem)


def check_stops(stop_energy: float, stop_after: float) -> None:
    """Refuse invalid stop conditions (J, s).

    Raises:
        Rejected: one is not finite or negative.
    """
    for name, value in (("stop_energy", stop_energy), ("stop_after", stop_after)):
        if not math.isfinite(value) or value < 0.0:
            raise codes.Rejected(f"{name} is {value}: give a finite number ≥ 0 (0 = none)")


def check_place(electrodes: observation.ElectrodePose, planner: arm.Planner, parameters: DockingParameters) -> None:
    """Refuse electrodes (charger_base) that are not finite or out of reach; errors as for `check_goal`."""
    x, y, z = electrodes.position
    pose = x, y, z, electrodes.roll
    if not all(map(math.isfinite, pose)) or any(map(math.isinf, (electrodes.yaw, electrodes.pitch))):
        raise codes.Rejected("the electrodes' pose is not finite; send numbers, or an empty frame_id to use the camera")
    if problem := texts.far((x, y, z)):
        raise codes.Rejected(f"the electrodes' place in charger_base: {problem}")
    wrong = planner.reach_problem((x, y, z), (x, y, z - parameters.standoff))
    if wrong:
        if never := planner.reach_problem((0.0, 0.0, machine.DOCK_DISTANCE)):
            raise codes.Rejected(f"the arm reaches no electrodes, not even at {never}: correct the arm's geometry")
        base = observation.BasePose.before(electrodes.position, electrodes.sure_yaw(clearance.LEAN_SIGMAS))
        dx, dy, dz = (f"{1000 * value:+.0f}" for value in (base.x, base.y, base.z))
        turn = f" and {in_words(base.yaw)}" if base.yaw else ""
        raise codes.Unreachable(
            f"the electrodes are out of the arm's reach, {wrong}; move the robot by ({dx}, {dy}, {dz}) mm of "
            f"charger_base{turn}, to suggested_base_pose",
            (x, y, z),
            base.yaw,
        )
    if z < parameters.home_z + release.BACK:
        near = f"less than {1000 * release.BACK:.0f} mm beyond home_z, {1000 * parameters.home_z:.0f} mm"
        raise codes.Rejected(f"the electrodes' z, {1000 * z:.0f} mm, is {near}: lower home_z, or move the robot back")


def in_words(yaw: float) -> str:
    """Return a turn about +y of charger_base (rad) in words; +y points up."""
    return f"turn it by {math.degrees(abs(yaw)):.1f}° to the {'left' if yaw > 0.0 else 'right'}"


def suggested_base(error: Exception) -> observation.BasePose | None:
    """Return where charger_base should stand to avoid this error; None if no such pose is known."""
    if not isinstance(error, codes.Misplaced) or error.electrodes is None:
        return None
    return observation.BasePose.before(error.electrodes, error.yaw)
