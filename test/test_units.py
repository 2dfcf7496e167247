# SPDX-License-Identifier: Apache-2.0
"""A place in millimetres or an angle in degrees is refused with the question for its unit, wherever it enters."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from deltacharger.action import ChargeRobot
from deltacharger.msg import ServoState

from deltacharger_bringup.scenes.scene import parse_scene
from deltacharger_core import machine, texts
from deltacharger_docking import clearance, codes, observation, parameters
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.mission.parameters import MissionParameters
from deltacharger_docking.mission.ros import others as mission
from deltacharger_docking.ros.inputs import MessageRefused, _three_servos
from deltacharger_vision.mount import Mount

pytestmark = pytest.mark.ros

MOUNT = (0.0, 250.0, 400.0, 0.5, 0.5, 0.5, 0.5)


def dock(position: tuple[float, float, float] = (0.0, 0.0, 0.08), critical_angle: float = 0.0) -> None:
    goal = observation.DockGoal(observation.ElectrodePose(position, 0.0), critical_angle, start_charging=False)
    DockingMachine(parameters.DockingParameters()).start_dock(goal, observation.Observation(0.0))


def charge(x: float, z: float = 0.0) -> None:
    goal = ChargeRobot.Goal()
    goal.target.header.frame_id = "map"
    goal.target.pose.position.x, goal.target.pose.position.z = x, z
    mission.goal(goal, MissionParameters(navigation="nav2"))


def estimate(**pose: float) -> None:
    clearance.MisalignmentEstimate.of(
        SimpleNamespace(**{**{f"{name}{end}": 0.0 for name in texts.IN_TOUCH for end in ("", "_stddev")}, **pose})
    )


WAYS: dict[str, tuple[str, Callable[[], Any]]] = {
    "a length of docking": ("millimetres", lambda: parameters.DockingParameters(standoff=18.0)),
    "the charger's mount": ("millimetres", lambda: parameters.DockingNodeParameters(base_pose=MOUNT)),
    "the camera's mount": ("millimetres", lambda: Mount.from_numbers(MOUNT)),
    "a Dock goal": ("millimetres", lambda: dock((0.0, 0.0, 80.0))),
    "its critical angle": ("degrees", lambda: dock(critical_angle=12.0)),
    "a ChargeRobot goal": ("millimetres", lambda: charge(25_000.0)),
    "a scene's goal": ("millimetres", lambda: parse_scene({"goal": {"z": 80.0}}, "x")),
    "an estimated angle": ("degrees", lambda: estimate(angle=-3.0)),
    "an estimated offset": ("millimetres", lambda: estimate(vertical=5.0)),
    "a servo's position": (
        "degrees",
        lambda: _three_servos(
            ServoState(
                name=list(machine.JOINTS),
                position=[math.nan, 4.0, -57.0],
                current=[0.0] * 3,
                hardware_error=[0] * 3,
                torque_enabled=[True] * 3,
                valid=[True] * 3,
                thermal_reserve=[60.0] * 3,
                stray=[0] * 3,
            )
        ),
    ),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_value_in_another_unit_is_asked_about(way: str) -> None:
    unit, give = WAYS[way]
    with pytest.raises(
        (ValueError, codes.DockingError, MessageRefused), match=rf" is outside .*; is it in {unit}\? Give "
    ):
        give()


def test_a_target_is_a_place_on_a_map_and_its_height_does_not_count() -> None:
    charge(-0.9 * texts.ON_MAP, z=1e9)
    estimate(angle=math.nan, horizontal=math.nan)


def test_only_a_number_that_fits_in_the_other_unit_is_asked_about() -> None:
    assert texts.outside(0.07, -0.06, 0.06, "m") == "0.07 is outside -0.06 to 0.06 m"
    assert texts.outside(-9.0, -0.06, 0.06, "m") == "-9.0 is outside -0.06 to 0.06 m; is it in millimetres? Give metres"
    assert texts.outside(300.0, -0.06, 0.06, "m") == "300.0 is outside -0.06 to 0.06 m"
    assert texts.outside(math.nan, 0.0, 1.0, "rad") == "nan is outside 0 to 1 rad"
    assert "inf is outside" in texts.far((0.0, -math.inf))
    assert not texts.far((texts.ON_ROBOT, -texts.ON_ROBOT, 0.0))
    assert not texts.untouchable(**{name: -most for name, (most, _) in texts.IN_TOUCH.items()})
    assert "0.25" in texts.untouchable(horizontal=math.inf)
