# SPDX-License-Identifier: Apache-2.0
"""The paper's robot, electrodes wired to the battery, with the real actions, drivers and bytes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from deltacharger.msg import ChargerPower, DockingState
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.executor import Spinner
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.composition import Composition

from ..chargers import DEADLINE, new_namespace
from ..nodes import options
from ..quick import quick_simulation

pytestmark = pytest.mark.ros

GOAL = DockRequest(Pose(0.0, 0.0, 0.080))


class Listener:
    """Messages of the charger during a test."""

    def __init__(self, context: Any, namespace: str) -> None:
        self.node = Node("listener", **options(context, namespace))
        self.power: list[ChargerPower] = []
        self.states: list[DockingState] = []
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(ChargerPower, "charger_power", self.power.append, QoSProfile(depth=10))
        self.node.create_subscription(DockingState, "docking_state", self.states.append, latched)
        self.spinner = Spinner(self.node)

    def close(self) -> None:
        self.spinner.close()
        self.node.destroy_node()


def test_it_docks_on_real_bytes_and_reports_no_charge(context: Any) -> None:
    namespace = new_namespace()
    with (
        Composition(quick_simulation("published_robot"), context, namespace) as charger,
        ChargerClient(namespace) as client,
    ):
        assert client.wait_until_ready(DEADLINE)
        listener = Listener(context, namespace)
        try:
            assert charger.charger is not None
            world = charger.charger.world
            outcome = client.dock(GOAL, deadline=DEADLINE)
            assert outcome.success, outcome
            assert "power: none" in outcome.error_message
            assert math.isnan(outcome.details["energy"])
            assert math.isnan(outcome.details["charge_current"])
            assert "charge – A, – J" in outcome.figures()
            assert world.snapshot().charge_current > 1.0, "the simulated batteries drive a current"
            refused = client.dock(DockRequest(GOAL.electrodes, start_charging=False), deadline=DEADLINE)
            assert refused.error_name == "REJECTED"
            assert client.undock(deadline=DEADLINE).success
            assert world.snapshot().charge_current == 0.0
        finally:
            listener.close()
    assert len(listener.power) > 20
    for power in listener.power:
        measured = power.battery_voltage, power.target_voltage, power.charge_current
        assert all(map(math.isnan, measured)), power
        assert (power.contactor_closed, power.fault) == (False, 0)
    assert any(state.docked for state in listener.states)
    assert not any(state.charging for state in listener.states)
    assert not {state.state for state in listener.states} & {DockingState.STATE_ENERGISE, DockingState.STATE_CHARGING}


def test_the_command_docks_its_scene_and_prints_no_current(
    start: Callable[..., Any], deltacharger: tuple[str, ...], namespace: str
) -> None:
    dock = start(*deltacharger, "dock", "--scene", "published_robot", "--namespace", namespace, "--no-picture")
    assert dock.end() == 0, dock.err
    assert any("done" in line and "does not measure, limit or interrupt" in line for line in dock.out), dock.out
    assert any("charge – A, – J" in line for line in dock.err), dock.err
