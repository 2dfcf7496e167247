# SPDX-License-Identifier: Apache-2.0
"""Useful logs: one line at INFO for each goal, phase and failure; WARN and ERROR only if a person must act.

Read in /rosout; nodes as processes, whose standard error is read: test_stops.py.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.action import Dock
from rcl_interfaces.msg import Log
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_ros.messages import fill_pose
from deltacharger_ros.outcomes import DockRequest
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, Spin, new_namespace, wait_until
from ..nodes import answer, options
from ..running_charger import GOAL, RunningCharger

pytestmark = [pytest.mark.ros, pytest.mark.rest]

WARN = 30  # of rcl_interfaces/Log


class Heard:
    """The log lines of a charger."""

    def __init__(self, charger: RunningCharger) -> None:
        self.charger = charger
        self.entries: list[Log] = []

    def wait_for(self, text: str) -> str:
        """Return docking_node's first line with a text; until then nothing may have been a warning."""
        name = f"{self.charger.namespace}.docking_node"

        def lines() -> list[str]:
            return [each.msg for each in list(self.entries) if each.name == name and text in each.msg]

        found = wait_until(lines, f"'{text}'")
        assert not [each for each in self.entries if each.name == name and each.level >= WARN]
        return str(found[0])


@pytest.fixture(scope="module")
def charger(quick_scene: Scene, context: Any) -> Iterator[RunningCharger]:
    with RunningCharger(quick_scene, context, namespace=new_namespace()) as charger:
        yield charger


@pytest.fixture
def heard(charger: RunningCharger, context: Any, spin: Spin) -> Heard:
    heard = Heard(charger)
    reader = spin(Node("reader", **options(context)))
    quality = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    reader.create_subscription(Log, "/rosout", heard.entries.append, quality)
    return heard


def test_a_failed_goal_is_logged_with_code_number_and_phase_at_info(charger: RunningCharger, heard: Heard) -> None:
    charger.set("mock_tactile_node", fault="short")
    outcome = charger.dock(DockRequest(GOAL.electrodes, request_id="order-2"))
    charger.set("mock_tactile_node", fault="none")
    assert outcome.error_name == "SHORT_CIRCUIT", outcome
    end = heard.wait_for("dock order-2: failed, 502 SHORT_CIRCUIT: ")
    assert outcome.error_message in end
    assert re.search(r"charge .*; contact -?0\.\d{3} A, -?\d+\.\d N", end)
    assert "energise → retract" in heard.wait_for(", 502 SHORT_CIRCUIT: ")


def test_a_cancel_and_a_client_that_leaves_are_logged(charger: RunningCharger, heard: Heard) -> None:
    docks: Any = ActionClient(charger.client.node, Dock, "dock")
    charger.client.waitables.append(docks)
    assert docks.wait_for_server(DEADLINE)
    goal = Dock.Goal(request_id="order-3", hold=True)
    fill_pose(goal.electrodes, GOAL.electrodes)
    send = charger.client.node.executor.call_soon
    handle = answer(answer(send(docks.send_goal_async, goal)))
    assert "electrodes at (0.0, 0.0, 80.0) mm" in heard.wait_for("dock order-3: accepted")
    answer(handle.cancel_goal_async())
    heard.wait_for("dock order-3: cancelled by a client")
    heard.wait_for("dock order-3: failed, 102 CANCELED")
    goal.request_id = "order-4"
    answer(answer(send(docks.send_goal_async, goal)))
    heard.wait_for("dock order-4: energise → charging")
    assert not any("client has gone" in each.msg for each in heard.entries)
    charger.client.close()
    heard.wait_for("dock order-4: its client has gone")
