# SPDX-License-Identifier: Apache-2.0
"""Lines of docking: commanded with the arm's weight fed forward, bounded in effort, and refused before any motion."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_docking.codes import Code, State, Unreachable
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.motion import Planner
from deltacharger_docking.observation import DockGoal, ElectrodePose
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_lab.campaigns.virtual_charger import VirtualCharger
from deltacharger_sim.parameters import TargetParameters, WorldParameters

HOME, STANDOFF = (0.0, 0.0, 0.0), (0.010, -0.020, 0.062)
PARAMETERS = DockingParameters()
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
    weightless = Planner(DockingParameters(gravity_y=0.0), DeltaGeometry()).line(HOME, STANDOFF, 0.12)
    assert np.allclose(weightless[-1].angles, DELTA.inverse(STANDOFF).angles, atol=1e-15)


def test_each_servo_may_push_by_the_same_current_above_its_holding_current() -> None:
    last = PLANNER.line(HOME, STANDOFF, 0.12)[-1]
    held = np.abs(DELTA.holding_torque(STANDOFF, PARAMETERS.gravity))
    assert np.allclose(np.subtract(last.torque_bound, held), PARAMETERS.push_current * TORQUE_CONSTANT, atol=1e-12)


def test_velocities_match_the_commanded_angles_and_end_at_rest() -> None:
    waypoints = PLANNER.line(HOME, STANDOFF, 0.12)
    times, angles, velocities = (table(waypoints, name) for name in ("time", "angles", "velocities"))
    slope = (angles[2:] - angles[:-2]) / (times[2:] - times[:-2])[:, None]
    assert np.allclose(velocities[1:-1], slope, atol=0.02 * np.abs(slope).max())
    assert waypoints[-1].velocities == (0.0, 0.0, 0.0)


def test_the_start_is_not_a_waypoint_and_times_increase() -> None:
    times = table(PLANNER.line(HOME, STANDOFF, 0.12), "time")
    assert times[0] > 0.0
    assert np.all(np.diff(times) > 0.0)


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
def test_a_line_that_leaves_the_limits_is_unreachable_and_reports_the_place(goal: tuple[float, float, float]) -> None:
    with pytest.raises(Unreachable, match=r"mm, .* along the line"):
        PLANNER.line((0.0, 0.0, 0.080), goal, 0.12)


def test_a_way_is_refused_if_its_last_leg_is_impossible() -> None:
    PLANNER.check_way(0.12, HOME, STANDOFF, HOME)
    with pytest.raises(Unreachable):
        PLANNER.check_way(0.12, HOME, STANDOFF, HOME, (0.0, 0.0, 0.190))


class Watched(VirtualCharger):
    """A charger whose machine uses its own geometry; it stores the arm's commands."""

    def __init__(self, geometry: DeltaGeometry, target: TargetParameters, **parameters: Any) -> None:
        super().__init__(WorldParameters(target=target), DockingParameters(**parameters))
        self.machine = DockingMachine(self.parameters, geometry)
        self.commands: list[tuple[State, tuple[Waypoint, ...]]] = []
        step = self.machine.step

        def watched(observation: Any) -> Any:
            command = step(observation)
            if command.trajectory is not None:
                self.commands.append((self.machine.status.state, command.trajectory))
            return command

        self.machine.step = watched  # type: ignore[method-assign]


def test_an_arm_outside_its_limits_is_not_moved() -> None:
    home_angle = float(DELTA.inverse(HOME).angles[0])
    run = Watched(DeltaGeometry(joint_min=home_angle + 0.02), TargetParameters())
    outcome = run.dock(DockGoal(ElectrodePose((0.0, 0.0, 0.080), 0.0)))
    assert outcome.code is Code.UNREACHABLE
    assert "JOINT_LIMIT" in outcome.message
    assert not any(trajectory for _, trajectory in run.commands)
    assert math.dist(run.world.snapshot().position, HOME) < 1e-3
    assert not run.observe().torque_enabled


def test_a_correction_beyond_reach_does_not_move_the_electrodes_until_retracting() -> None:
    # The rods allow the given place, but not a place 6 mm farther, which touch requests.
    given, real = (0.048, 0.0, 0.080), 0.054
    across = (0.048 + 0.003) * math.sqrt(3.0) / 2.0  # of limbs 1 and 2
    geometry = DeltaGeometry(swing_max=math.asin(across / DeltaGeometry().rod))
    run = Watched(geometry, TargetParameters(x=real))
    outcome = run.dock(DockGoal(ElectrodePose(given, 0.0), start_charging=False))
    assert outcome.code is Code.UNREACHABLE, outcome.message
    assert "SWING_LIMIT" in outcome.message
    assert State.MEASURE in run.states
    assert State.ALIGN not in run.states
    assert run.world.record.contacts == 1
    assert math.dist(run.world.snapshot().position, HOME) < 3e-3
