# SPDX-License-Identifier: Apache-2.0
"""Foreign nodes on a charger's topics and services, and a second charger: nothing live moves, and no docking fails."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_driver.servos.motion import ContactorState
from deltacharger_ros.messages import CODES
from deltacharger_scenes.scene import Scene, parse_scene

from ..chargers import Spin, new_namespace, wait_until
from ..nodes import options
from ..quick import QUICK
from ..running_charger import RunningCharger, up

pytestmark = pytest.mark.ros

HOME = (-0.2, -0.2, -0.2)  # rad; far from the target
PULL = 4.0  # N·m of each servo, more than the magnets hold


@pytest.fixture
def charger(context: Any) -> Iterator[RunningCharger]:
    with RunningCharger(parse_scene(QUICK, "strangers"), context) as charger:
        yield charger


@pytest.mark.rest
def test_a_strangers_points_part_no_live_electrodes_and_do_not_end_the_charge(
    charger: RunningCharger, context: Any, spin: Spin
) -> None:
    charger.charge()
    messages: list[str] = []
    stranger = spin(Node("stranger", **options(context, charger.namespace)))
    points = stranger.create_publisher(JointTrajectory, "joint_trajectory", QoSProfile(depth=1))
    stranger.create_subscription(
        DiagnosticArray, "/diagnostics", lambda array: messages.extend(each.message for each in array.status), 10
    )
    wait_until(points.get_subscription_count, "the stranger's discovery")
    before = charger.world.snapshot().position
    away = JointTrajectory(joint_names=list(JOINTS))
    away.points = [JointTrajectoryPoint(positions=array("d", HOME), effort=array("d", [PULL] * 3))]
    words = (ContactorState.CLOSED.value,)

    def named() -> bool:
        points.publish(away)
        return any(all(word in text for word in words) for text in messages)

    wait_until(named, "a diagnostic that names it")
    assert charger.is_closed
    assert math.dist(charger.world.snapshot().position, before) < 0.001
    assert charger.state.charging
    charger.go_home()


def assert_at_rest(charger: RunningCharger, since: int) -> None:
    """Check that an open charger has switched nothing on since a number of events."""
    assert charger.world.events[since:] == []
    assert max(map(abs, charger.world.mechanics.rates)) < 0.01


@pytest.mark.night
def test_actions_and_faults_of_one_do_not_affect_the_other(quick_scene: Scene, context: Any) -> None:
    """The one in this process is of mocks, whose faults are easy to set; two of one kind would starve each other."""
    name = new_namespace()
    with (
        RunningCharger(quick_scene, context, namespace=name) as outer,
        RunningCharger(parse_scene(QUICK, "inner"), context, command=up, namespace=f"{name}/inner") as inner,
    ):
        outer.charge()
        assert_at_rest(inner, 0)
        inner.charge()
        events, states = len(inner.world.events), len(inner.states)
        outer.set("mock_servo_node", fault="silence")
        wait_until(lambda: outer.state.error_code, "the outer to notice")
        assert CODES[outer.state.error_code] == "SERVO_STALE"
        wait_until(lambda: outer.state.state == outer.state.STATE_IDLE, "the end of its retreat")
        outer.set("mock_servo_node", fault="none")
        outer.go_home()
        assert inner.is_closed
        assert (inner.world.events[events:], inner.states[states:]) == ([], [])
        states = len(outer.states)
        inner.go_home()
        assert outer.states[states:] == []
        assert not outer.is_closed
