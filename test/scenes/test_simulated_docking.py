# SPDX-License-Identifier: Apache-2.0
"""Docking with the real actions, drivers and bytes, in the simulated world, also of the paper's wired robot."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from deltacharger.msg import ChargerPower, DockingState
from rclpy.qos import QoSProfile

from deltacharger_ros.outcomes import DockRequest, Pose, Progress
from deltacharger_scenes.scene import parse_scene

from ..quick import quick_simulation
from ..running_charger import GOAL, PATIENT, QUICK, RunningCharger

pytestmark = pytest.mark.ros

HERE = Pose(0.0, 0.0, 0.080)


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[RunningCharger]:
    with RunningCharger(parse_scene(QUICK, "simulated"), context) as charger:
        yield charger


@pytest.mark.witness
def test_it_docks_and_charges_and_a_cancel_of_the_next_goal_ends_safely(charger: RunningCharger) -> None:
    assert charger.charge().details["charge_current"] > 0.5
    charger.go_home()
    cancel = threading.Event()

    def on_progress(progress: Progress) -> None:
        if progress.phase == "energise":
            cancel.set()

    outcome = charger.dock(on_progress=on_progress, cancel=cancel)
    assert (cancel.is_set(), outcome.error_name) == (True, "CANCELED"), outcome
    charger.assert_safe()
    assert math.dist(charger.world.snapshot().position, (0.0, 0.0, 0.0)) < 0.003


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (DockRequest(Pose(math.nan, 0.0, 0.08)), "REJECTED"),
        (DockRequest(HERE, critical_angle=0.4), "REJECTED"),
        (DockRequest(Pose(0.0, 0.0, 0.5)), "UNREACHABLE"),
        (DockRequest(Pose(0.0, 0.0, 0.08, math.radians(12.5))), "CRITICAL_ANGLE"),
    ],
)
def test_an_impossible_goal_is_aborted_with_its_code_and_nothing_moves(
    charger: RunningCharger, request_: DockRequest, code: str
) -> None:
    before = len(charger.world.events)
    outcome = charger.dock(request_)
    assert (outcome.success, outcome.error_name) == (False, code)
    assert outcome.error_message
    assert (outcome.details["suggested_base_pose"] is not None) == (code == "UNREACHABLE")
    assert charger.world.events[before:] == []


@pytest.mark.rest
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


@pytest.mark.rest
def test_the_command_docks_its_scene_and_prints_no_current(
    start: Callable[..., Any], deltacharger: tuple[str, ...], namespace: str
) -> None:
    dock = start(*deltacharger, "dock", "--scene", "published_robot", "--namespace", namespace, "--no-picture")
    assert dock.end() == 0, dock.err
    assert any("does not measure" in line for line in dock.out), dock.out
    assert any("charge – A, – J" in line for line in dock.err), dock.err
