# SPDX-License-Identifier: Apache-2.0
"""The paper's robot, electrodes wired to the battery, with the real actions, drivers and bytes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from deltacharger.msg import ChargerPower, DockingState
from rclpy.qos import QoSProfile

from ..quick import quick_simulation
from ..running_charger import GOAL, PATIENT, RunningCharger

pytestmark = [pytest.mark.ros, pytest.mark.rest]


def test_it_docks_on_real_bytes_and_reports_no_charge(context: Any) -> None:
    powers: list[ChargerPower] = []
    with RunningCharger(quick_simulation("published_robot", PATIENT), context) as charger:
        node = charger.client.node
        node.create_subscription(ChargerPower, "charger_power", powers.append, QoSProfile(depth=10))
        outcome = charger.dock()
        assert outcome.success, outcome
        assert "power: none" in outcome.error_message
        assert math.isnan(outcome.details["energy"])
        assert math.isnan(outcome.details["charge_current"])
        assert "charge – A, – J" in outcome.figures()
        assert charger.world.snapshot().charge_current > 1.0, "the simulated batteries drive a current"
        assert charger.dock(replace(GOAL, start_charging=False)).error_name == "REJECTED"
        assert charger.undock().success
        assert charger.world.snapshot().charge_current == 0.0
    assert len(powers) > 20
    for power in powers:
        assert all(map(math.isnan, (power.battery_voltage, power.target_voltage, power.charge_current))), power
        assert (power.contactor_closed, power.fault) == (False, 0)
    assert any(state.docked for state in charger.states)
    assert not any(state.charging for state in charger.states)
    assert not {state.state for state in charger.states} & {DockingState.STATE_ENERGISE, DockingState.STATE_CHARGING}


def test_the_command_docks_its_scene_and_prints_no_current(
    start: Callable[..., Any], deltacharger: tuple[str, ...], namespace: str
) -> None:
    dock = start(*deltacharger, "dock", "--scene", "published_robot", "--namespace", namespace, "--no-picture")
    assert dock.end() == 0, dock.err
    assert any("does not measure" in line for line in dock.out), dock.out
    assert any("charge – A, – J" in line for line in dock.err), dock.err
