# SPDX-License-Identifier: Apache-2.0
"""Malformed data for the mission: it refuses or ignores them; its log: a line for each change."""

import itertools
import math
from dataclasses import astuple

import pytest
from builtin_interfaces.msg import Time
from deltacharger.action import ChargeRobot, Dock
from deltacharger.msg import DockingState
from deltacharger.srv import DetectElectrodes
from geometry_msgs.msg import PoseStamped

from deltacharger_core.texts import MESSAGE_MAX
from deltacharger_docking import codes, observation
from deltacharger_docking.mission import dialogue, parameters, places
from deltacharger_docking.mission.machine import MissionMachine
from deltacharger_docking.mission.ros import others as io
from deltacharger_docking.ros.messages import pose_stamped

pytestmark = pytest.mark.ros

NUMBERS = (0.0, 1.0, -1e-300, 1e308, -math.inf, math.nan)
LONG = "x" * 5_000_000


def test_a_pose_becomes_a_place_of_finite_numbers_or_none() -> None:
    for x, z, w in itertools.product(NUMBERS, repeat=3):
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.orientation.z, pose.pose.orientation.w = x, z, w
        found = io.place(pose)
        assert found is None or all(map(math.isfinite, (found.x, found.y, found.yaw)))
    pose.pose.position.x, pose.pose.orientation.z, pose.pose.orientation.w = 1.0, 1e300, 1e300
    assert io.place(pose) is not None


@pytest.mark.parametrize("x", [math.nan, math.inf, -1e308, 1000.0])
def test_the_robot_is_not_sent_to_implausible_electrodes(x: float) -> None:
    answer = DetectElectrodes.Response(success=True)
    answer.detection.header.frame_id = "charger_base"
    answer.detection.pose.pose.position.x = x
    reply = io.read_detection(1, answer)
    assert (reply.end, reply.electrodes) == (dialogue.End.FAILED, None)
    assert reply.message
    result = Dock.Result()
    result.suggested_base_pose.header.frame_id = "charger_base"
    result.suggested_base_pose.pose.position.x = x
    assert io.read_dock(2, dialogue.End.FAILED, result, None).suggested is None


def test_a_suggested_base_pose_is_read_with_its_yaw_and_an_invalid_yaw_gives_none() -> None:
    result = Dock.Result(error_code=Dock.Result.LEANING)
    result.suggested_base_pose = pose_stamped(observation.BasePose(0.1, 0.0, -0.2, -0.3), Time(), "charger_base")
    reply = io.read_dock(2, dialogue.End.FAILED, result, None)
    assert reply.code is codes.Code.LEANING
    assert reply.suggested is not None
    assert astuple(reply.suggested) == pytest.approx((0.1, 0.0, -0.2, -0.3))
    for wrong in (math.nan, 0.0):
        result.suggested_base_pose.pose.orientation.y = result.suggested_base_pose.pose.orientation.w = wrong
        assert io.read_dock(2, dialogue.End.FAILED, result, None).suggested is None


def test_long_messages_are_cut_and_long_frame_names_refused() -> None:
    answer, result = DetectElectrodes.Response(message=LONG), Dock.Result(error_message=LONG)
    for reply in (io.read_detection(1, answer), io.read_dock(2, dialogue.End.FAILED, result, None)):
        assert len(reply.message) < 2 * MESSAGE_MAX
    goal = ChargeRobot.Goal()
    goal.target.header.frame_id = LONG
    with pytest.raises(codes.Rejected, match="frame_id") as refusal:
        io.goal(goal, parameters.MissionParameters(navigation="nav2"))
    assert len(str(refusal.value)) < MESSAGE_MAX
    machine = MissionMachine(parameters.MissionParameters(), places.BaseMount((0, 0, 0, 0.5, 0.5, 0.5, 0.5)), None)
    with pytest.raises(codes.Rejected, match="request_id"):
        machine.start(
            dialogue.MissionGoal(None, 0.0, 0.0, LONG), dialogue.MissionObservation(0.0, frozenset(), None, ())
        )


def test_an_invalid_docking_state_is_ignored() -> None:
    assert io.read_state(DockingState(state=200)) is None
    report = io.read_state(DockingState(state=DockingState.STATE_CHARGING, charging=True))
    assert report is not None
    assert report.state is codes.State.CHARGING
