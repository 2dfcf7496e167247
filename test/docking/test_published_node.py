# SPDX-License-Identifier: Apache-2.0
"""docking_node of `approach: published`: current as printed only before ports that are proven to be simulated."""

from __future__ import annotations

import os
import pty
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from deltacharger.msg import Misalignment

from deltacharger_core.runtime import CONTROL, is_simulated
from deltacharger_docking.ros.messages import estimate
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose
from deltacharger_ros.unknown import unknown_misalignment
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene, parse_scene
from deltacharger_sim.charger.fault_channel import ControlServer

from ..chargers import DEADLINE, new_namespace
from ..quick import SCENE

PLACE = Pose(0.0, 0.0, 0.080)


def as_published(scene: Scene, **more: Any) -> Scene:
    """The scene with docking_node's approach as published; `more` are further parameters of it."""
    docking = {**scene.parameters.get("docking_node", {}), "approach": "published", **more}
    return replace(scene, parameters={**scene.parameters, "docking_node": docking})


def outcomes(scene: Scene, context: Any, *requests: DockRequest) -> list[Outcome]:
    """Serve one goal after the other on a charger of this scene."""
    namespace = new_namespace()
    with Composition(scene, context, namespace), ChargerClient(namespace, context) as client:
        assert client.wait_until_ready(DEADLINE)
        return [client.dock(request, deadline=DEADLINE) for request in requests]


@pytest.mark.ros
def test_the_simulated_charger_takes_a_goal_and_its_estimates_carry_the_cnns_classes(context: Any) -> None:
    namespace = new_namespace()
    scene = as_published(parse_scene(SCENE, "quick"))
    with Composition(scene, context, namespace) as composition, ChargerClient(namespace, context) as client:
        assert client.wait_until_ready(DEADLINE)
        outcome = client.dock(DockRequest(PLACE), deadline=DEADLINE)
        assert outcome.success, outcome
        node = composition.node("docking_node")
        felt = node._machine.status.estimate
        assert felt.classes is not None
        assert node._calls.misalignment(felt).model.endswith("+cnn")


@pytest.mark.ros
def test_before_nodes_that_prove_nothing_a_goal_that_charges_is_refused(quick_scene: Scene, context: Any) -> None:
    refused, rests, again = outcomes(
        as_published(quick_scene),
        context,
        DockRequest(PLACE),
        DockRequest(PLACE, start_charging=False),
        DockRequest(PLACE),
    )
    for outcome in (refused, again):
        assert outcome.error_name == "REJECTED"
        assert "published_clearance_rule" in outcome.error_message
    assert rests.success, rests


@pytest.mark.ros
def test_with_our_clearance_rule_any_charger_will_do(quick_scene: Scene, context: Any) -> None:
    (outcome,) = outcomes(as_published(quick_scene, published_clearance_rule=True), context, DockRequest(PLACE))
    assert outcome.error_name != "REJECTED", outcome


def test_only_a_terminal_beside_which_a_simulated_charger_listens_is_its_port(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    port = tmp_path / "servo"
    try:
        port.symlink_to(os.ttyname(slave))
        assert not is_simulated(str(port)), "a cable passed on by a terminal is as real as any"
        server = ControlServer(tmp_path / CONTROL, lambda request: {})
        try:
            assert is_simulated(str(port))
            device = tmp_path / "ttyUSB0"
            device.touch()
            assert not is_simulated(str(device)), "no terminal"
            assert not is_simulated(str(tmp_path / "gone"))
            assert not is_simulated("")
        finally:
            server.close()
        assert not is_simulated(str(port)), "its charger has gone"
    finally:
        os.close(master)
        os.close(slave)


def message(**shares: Any) -> Misalignment:
    told = {"angle": [0.1, 0.2, 0.7, 0, 0, 0], "vertical": [0, 0.6, 0.4, 0, 0], "horizontal": [0, 0, 0, 0, 1.0]}
    found = unknown_misalignment()
    for axis, values in {**told, **shares}.items():
        setattr(found, f"{axis}_probability", values)
    return found


def test_the_most_probable_classes_are_told_by_their_centres() -> None:
    classes = estimate(message(), with_classes=True).classes
    assert classes is not None
    assert vars(classes) == pytest.approx({"angle": 0.0349066, "vertical": -0.005, "horizontal": 0.010})
    assert estimate(message()).classes is None, "they were not asked for"


@pytest.mark.parametrize("axis", ["angle", "vertical", "horizontal"])
@pytest.mark.parametrize("shares", [[], [1.0, 0.0], [float("nan")] * 5, [1.0] * 7])
def test_probabilities_that_are_missing_or_nan_tell_no_class(axis: str, shares: list[float]) -> None:
    classes = estimate(message(**{axis: shares}), with_classes=True).classes
    told: Mapping[str, float] = vars(classes or SimpleNamespace())
    assert {name for name, value in told.items() if value != value} == {axis}
