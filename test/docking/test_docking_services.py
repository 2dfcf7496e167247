# SPDX-License-Identifier: Apache-2.0
"""Docking's calls: it waits for a late service, reports a missing one, and no call overtakes another."""

from __future__ import annotations

import math
from typing import Any

import pytest
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from deltacharger_core.texts import MESSAGE_MAX
from deltacharger_docking.observation import Reply, Request, Service
from deltacharger_docking.ros.frame_check import FrameCheck
from deltacharger_docking.ros.services import Services

from ..chargers import Spin, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros


@pytest.fixture
def node(context: Any, namespace: str, spin: Spin) -> Node:
    return spin(Node("docking", **options(context, namespace)))


@pytest.fixture
def services(node: Node) -> Services:
    return Services(node)


def reply(services: Services) -> Reply:
    found: list[Reply] = []
    wait_until(lambda: found.extend(services.take()[0]) or found, "a reply")
    return found[0]


def test_a_service_that_appears_after_the_call_is_used(node: Node, services: Services) -> None:
    services.call(Request(7, Service.TARE))
    assert services.take() == ((), "")

    def tare(request: Any, response: Any) -> Any:
        response.success, response.message = True, "tared"
        return response

    node.create_service(Trigger, "tare", tare, callback_group=ReentrantCallbackGroup())
    answer = reply(services)
    assert (answer.number, answer.success, answer.message) == (7, True, "tared")


def test_a_service_that_never_appears_is_named(services: Services) -> None:
    services.call(Request(8, Service.PROBE, timeout=0.2))
    answer = reply(services)
    assert (answer.number, answer.success) == (8, False)
    assert answer.message.startswith("no node serves")
    assert "probe" in answer.message


def serve_torque(node: Node) -> list[bool]:
    """Serve set_torque; return what was asked for so far."""
    received = list[bool]()

    def set_torque(request: Any, response: Any) -> Any:
        received.append(request.data)
        response.success = True
        return response

    node.create_service(SetBool, "set_torque", set_torque)
    return received


def test_torque_on_never_overtakes_torque_off_when_servo_node_appears_late(node: Node, services: Services) -> None:
    services.call(Request(1, Service.TORQUE_ON))
    received = serve_torque(node)
    wait_until(services._clients[Service.TORQUE_ON].service_is_ready, "the service")
    services.call(Request(2, Service.TORQUE_OFF))
    wait_until(lambda: services.take() and len(received) == 2, "both calls")
    assert received == [True, False]


def test_pending_requests_of_a_failed_goal_are_not_sent(node: Node, services: Services) -> None:
    services.call(Request(1, Service.TORQUE_ON))
    services.call(Request(2, Service.TORQUE_OFF))
    services.forget()
    received = serve_torque(node)
    wait_until(lambda: services.take() and received, "the call that makes safe")
    assert received == [False]


def test_a_contradictory_detection_fails_with_its_reason(node: Node, services: Services) -> None:
    def lie(request: Any, response: Any) -> Any:
        response.success, response.detection.roll = True, 0.1  # beside an orientation without a roll
        return response

    node.create_service(DetectElectrodes, "detect_electrodes", lie, callback_group=ReentrantCallbackGroup())
    services.call(Request(1, Service.DETECT, timeout=5.0))
    answer = reply(services)
    assert (answer.success, answer.detection) == (False, None)
    assert "contradicts itself" in answer.message


LONG = "x" * 1_000_000
NAN, INF = math.nan, math.inf


def estimate(response: Any, value: float) -> None:
    felt = response.misalignment
    felt.contact = felt.sure = felt.in_range = True
    for name in ("angle", "vertical", "horizontal", "angle_stddev", "vertical_stddev", "horizontal_stddev"):
        setattr(felt, name, value)
    response.sequences = [2**64 - 1] * 100_000


def detection(response: Any, value: float) -> None:
    pose, response.detection.roll = response.detection.pose, value
    pose.pose.position.x, pose.covariance[35] = value, value
    response.detection.header.stamp.sec, response.detection.header.stamp.nanosec = -(2**31), 2**32 - 1


def probe(response: Any, value: float) -> None:
    response.resistance = response.target_voltage = value


ASKED: dict[Service, tuple[str, Any, Any]] = {
    Service.ESTIMATE: ("predict_misalignment", PredictMisalignment, estimate),
    Service.DETECT: ("detect_electrodes", DetectElectrodes, detection),
    Service.PROBE: ("probe", Probe, probe),
    Service.TARE: ("tare", Trigger, lambda response, value: None),
}


@pytest.mark.parametrize("service", ASKED)
def test_malformed_answers_are_refused_or_ignored(node: Node, services: Services, service: Service) -> None:
    """Success with a very long message, and with nothing, NaN or infinite numbers as its payload."""
    name, kind, fill = ASKED[service]
    values = iter((None, NAN, INF, -INF, 1e308))

    def lie(request: Any, response: Any) -> Any:
        response.success, response.message = True, LONG
        if (value := next(values)) is not None:
            fill(response, value)
        return response

    node.create_service(kind, name, lie, callback_group=ReentrantCallbackGroup())
    frames = FrameCheck()
    for number in range(1, 6):
        services.call(Request(number, service, frames=4, timeout=5.0))
        answer = frames.checked(reply(services))
        assert answer.number == number
        assert len(answer.message) < 2 * MESSAGE_MAX
        assert answer.estimate is None, "no frames stand behind it"
        if answer.detection is not None:
            assert not (answer.detection.age <= 1.0 and all(map(math.isfinite, answer.detection.position)))
