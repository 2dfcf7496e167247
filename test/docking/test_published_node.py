# SPDX-License-Identifier: Apache-2.0
"""docking_node of `approach: published`: without clearance, current flows only with ports proven to be simulated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from deltacharger.msg import ChargerPower, Misalignment, ServoState, TactileFrame
from deltacharger.srv import Probe, SetContactor
from rclpy.node import Node
from std_srvs.srv import SetBool

from deltacharger_docking.ros.messages import estimate
from deltacharger_docking.ros.port_owners import PortOwners
from deltacharger_ros.unknown import unknown_misalignment
from deltacharger_scenes.scene import Scene, parse_scene
from deltacharger_sim.charger.simulated_charger import SimulatedCharger

from ..chargers import Spin, new_namespace
from ..running_charger import GOAL, QUICK, RunningCharger
from ..waiting import wait_until

HEARD = ("servo_state", "tactile_frame", "charger_power", "set_torque", "set_contactor", "probe")


def as_published(scene: Scene, **more: Any) -> Scene:
    """The scene with docking_node's approach as published; `more` are further parameters of it."""
    docking = {**scene.parameters.get("docking_node", {}), "approach": "published", **more}
    return replace(scene, parameters={**scene.parameters, "docking_node": docking})


@pytest.mark.ros
@pytest.mark.rest
def test_the_simulated_charger_accepts_a_goal_and_its_estimates_have_cnn_classes(context: Any) -> None:
    with RunningCharger(as_published(parse_scene(QUICK, "quick")), context) as charger:
        charger.charge()
        node = charger.node("docking_node")
        felt = node._machine.status.estimate
        assert felt.classes is not None
        assert node._calls.misalignment(felt).model.endswith("+cnn")


@pytest.mark.ros
@pytest.mark.rest
@pytest.mark.parametrize("rule", [False, True])
def test_goals_that_charge_need_nodes_that_prove_simulation_or_our_rule(
    quick_scene: Scene, context: Any, rule: bool
) -> None:
    with RunningCharger(as_published(quick_scene, published_clearance_rule=rule), context) as charger:
        outcome = charger.dock()
        assert (outcome.error_name == "REJECTED") is not rule, outcome
        if not rule:
            assert "published_clearance_rule" in outcome.error_message
            assert charger.dock(replace(GOAL, start_charging=False)).success
            assert charger.dock().error_name == "REJECTED", "nor does it energise a docked target"


def message(**shares: Any) -> Misalignment:
    base = {"angle": [0.1, 0.2, 0.7, 0, 0, 0], "vertical": [0, 0.6, 0.4, 0, 0], "horizontal": [0, 0, 0, 0, 1.0]}
    found = unknown_misalignment()
    for axis, values in {**base, **shares}.items():
        setattr(found, f"{axis}_probability", values)
    return found


def test_the_most_probable_classes_are_given_by_their_centres() -> None:
    classes = estimate(message(), with_classes=True).classes
    assert classes is not None
    assert vars(classes) == pytest.approx({"angle": 0.0349066, "vertical": -0.005, "horizontal": 0.010})
    assert estimate(message()).classes is None, "they were not asked for"


@pytest.mark.parametrize("axis", ["angle", "vertical", "horizontal"])
@pytest.mark.parametrize("shares", [[], [1.0, 0.0], [float("nan")] * 5, [1.0] * 7])
def test_missing_or_nan_probabilities_give_no_class(axis: str, shares: list[float]) -> None:
    classes = estimate(message(**{axis: shares}), with_classes=True).classes
    found: Mapping[str, float] = vars(classes or SimpleNamespace())
    assert {name for name, value in found.items() if value != value} == {axis}


class Owner(Node):
    """Replaces the node of a port: publishes and serves its topics and services."""

    def __init__(self, context: Any, namespace: str, name: str, port: str) -> None:
        super().__init__(name, namespace=namespace, context=context)
        self.declare_parameter("port", port)

    def work(self, namespace: str) -> None:
        """Publish and serve in a namespace."""
        topics: dict[str, Any] = {"servo_state": ServoState}
        services: dict[str, Any] = {"set_torque": SetBool}
        if self.get_name() == "tactile_node":
            topics = {"tactile_frame": TactileFrame, "charger_power": ChargerPower}
            services = {"set_contactor": SetContactor, "probe": Probe}
        for topic, kind in topics.items():
            self.create_publisher(kind, f"{namespace}/{topic}", 1)
        for service, kind in services.items():
            self.create_service(kind, f"{namespace}/{service}", lambda request, response: response)


@pytest.mark.ros
@pytest.mark.rest
def test_the_nodes_in_use_must_prove_simulation_and_stay_the_same(context: Any, spin: Spin, tmp_path: Path) -> None:
    """Simulated nodes of the right names prove nothing about other nodes to which docking is remapped."""
    ours, robot = (f"/{new_namespace().strip('/')}" for _ in range(2))
    with SimulatedCharger(
        parse_scene({"nodes": [], "simulation": {}}, "test").simulation, tmp_path / "ports"
    ) as charger:
        names = (("servo_node", charger.servo_port), ("tactile_node", charger.board_port))
        simulated = [spin(Owner(context, ours, name, str(port))) for name, port in names]
        docking = spin(Node("docking_node", namespace=ours, context=context))
        remaps = [item for name in HEARD for item in ("-r", f"{name}:={robot}/{name}")]
        elsewhere = spin(Node("remapped", namespace=ours, context=context, cli_args=["--ros-args", *remaps]))
        for owner in simulated:
            owner.work(ours)
        for name, _ in names:
            spin(Owner(context, robot, name, "/dev/ttyUSB0")).work(robot)
        owners = PortOwners(docking)
        wait_until(owners.is_simulated)
        assert not PortOwners(elsewhere).is_simulated()
        assert owners.are_the_same()
        spin(Owner(context, robot, "stranger", "/dev/ttyUSB0")).work(ours)
        wait_until(lambda: not owners.are_the_same())
        assert not owners.is_simulated(), "two nodes publish and serve it"
