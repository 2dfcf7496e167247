# SPDX-License-Identifier: Apache-2.0
"""Docking with the real actions, drivers and bytes, in the simulated world: to coordinates, by camera, and wired."""

import math
import threading
from dataclasses import replace
from typing import Any

import pytest
from deltacharger.msg import ChargerPower
from rclpy.qos import QoSProfile

from deltacharger_bringup.scenes.scene import SceneError, parse_scene
from deltacharger_core.ros.outcomes import DockRequest, Progress

from ..quick import QUICK, quick_simulation
from ..running_charger import GOAL, RunningCharger

pytestmark = pytest.mark.ros


@pytest.mark.witness
def test_it_docks_and_charges_and_a_cancel_of_the_next_goal_ends_safely(context: Any) -> None:
    cancel = threading.Event()

    def on_progress(progress: Progress) -> None:
        if progress.phase == "energise":
            cancel.set()

    with RunningCharger(parse_scene(QUICK, "simulated"), context) as charger:
        assert charger.charge().details["charge_current"] > 0.5
        charger.go_home()
        outcome = charger.dock(on_progress=on_progress, cancel=cancel)
        assert (cancel.is_set(), outcome.error_name) == (True, "CANCELED"), outcome
        charger.assert_safe()
        assert math.dist(charger.world.snapshot().position, (0.0, 0.0, 0.0)) < 0.003


@pytest.mark.rest
def test_it_docks_on_real_bytes_and_reports_no_charge(context: Any) -> None:
    powers: list[ChargerPower] = []
    with RunningCharger(quick_simulation("published_robot"), context) as charger:
        node = charger.client.node
        node.create_subscription(ChargerPower, "charger_power", powers.append, QoSProfile(depth=10))
        outcome = charger.dock()
        assert outcome.success, outcome
        assert "power: none" in outcome.error_message
        assert math.isnan(outcome.details["charge_current"])
        assert charger.world.snapshot().charge_current > 1.0, "the simulated batteries drive a current"
        assert charger.dock(replace(GOAL, start_charging=False)).error_name == "REJECTED"
        assert charger.undock().success
        assert charger.world.snapshot().charge_current == 0.0
    assert len(powers) > 20
    for power in powers:
        assert all(map(math.isnan, (power.battery_voltage, power.target_voltage, power.charge_current))), power
        assert (power.contactor_closed, power.fault) == (False, 0)
    assert not any(state.charging for state in charger.states)


@pytest.mark.rest
def test_it_docks_from_the_image_and_charges(context: Any) -> None:
    pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    phases: list[str] = []
    with RunningCharger(quick_simulation("camera"), context) as charger:
        outcome = charger.dock(DockRequest(None), lambda progress: phases.append(progress.phase))
        assert outcome.success, outcome
        assert charger.is_closed
        assert phases[0] == "locate"
        assert 1 <= charger.node("simulated_camera_node").rendered < 60  # while it looked, not while it docked
        charger.go_home()


def test_a_simulated_camera_is_refused_beside_real_servos() -> None:
    nodes = ["servo_node", "simulated_camera_node", "electrode_detector_node", "docking_node"]
    with pytest.raises(SceneError, match="real servos would move there"):
        parse_scene({"nodes": nodes, "ports": {"servo": "/dev/ttyUSB0"}}, "mixed")
