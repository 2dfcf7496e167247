# SPDX-License-Identifier: Apache-2.0
"""Foreign nodes: a second source is named and keeps the contactor open, and so does an estimate of unknown frames."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from deltacharger.msg import ChargerPower
from deltacharger.srv import PredictMisalignment, Probe
from rclpy.node import Node

from deltacharger_ros import qos
from deltacharger_scenes.scene import Scene

from ..chargers import Spin, wait_until
from ..nodes import options
from ..running_charger import RunningCharger

pytestmark = [pytest.mark.ros, pytest.mark.rest]


def closings(charger: RunningCharger) -> list[bool]:
    """Collect whether charger_power reports a closed contactor."""
    found: list[bool] = []
    charger.client.node.create_subscription(
        ChargerPower, "charger_power", lambda power: found.append(power.contactor_closed), qos.LATEST
    )
    return found


def test_second_sources_are_named_and_docking_waits_until_they_are_gone(quick_scene: Scene, context: Any) -> None:
    with RunningCharger(quick_scene, context) as charger:
        named = lambda: charger.state.duplicate_sources  # noqa: E731
        node = Node("stranger", **options(context, charger.namespace))
        node.create_publisher(ChargerPower, "charger_power", 1)
        node.create_service(Probe, "probe", lambda request, response: response)
        wait_until(lambda: named().count("/stranger") == 2, "a topic and a service named")
        closed = closings(charger)
        ended = charger.begin("measure")
        assert not any(closed)
        node.destroy_node()
        assert ended.result().success
        assert charger.is_closed
        later = Node("stranger", **options(context, charger.namespace))
        later.create_publisher(ChargerPower, "charger_power", 1)
        wait_until(lambda: "stranger" in named(), "a second source while charging")
        assert charger.is_closed
        later.destroy_node()
        charger.go_home()


def test_an_estimate_of_frames_that_nobody_heard_never_closes_the_contactor(
    quick_scene: Scene, context: Any, spin: Spin
) -> None:
    def lie(request: Any, response: Any) -> Any:
        felt = response.misalignment
        response.success = felt.contact = felt.sure = felt.in_range = True
        felt.angle_stddev, felt.vertical_stddev, felt.horizontal_stddev = 0.001, 1e-5, 1e-5
        return response

    nodes = tuple(name for name in quick_scene.nodes if name != "misalignment_node")
    with RunningCharger(replace(quick_scene, nodes=nodes), context) as charger:
        closed = closings(charger)
        liar = spin(Node("liar", **options(context, charger.namespace)))
        liar.create_service(PredictMisalignment, "predict_misalignment", lie)
        service = f"/{charger.namespace}/predict_misalignment"
        wait_until(lambda: charger.node("docking_node").count_services(service) == 1, "the liar")
        outcome = charger.dock()
        assert closed
        assert not any(closed)
        assert outcome.error_name == "TACTILE_STALE", outcome
        assert "confirmed" in outcome.error_message
