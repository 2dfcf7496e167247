# SPDX-License-Identifier: Apache-2.0
"""Docking's calls: a service that comes late is waited for, one that never comes is told, none overtakes another."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from deltacharger_docking.observation import Reply, Request, Service
from deltacharger_docking.ros.services import Services

from ..chargers import Spin, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros


@pytest.fixture
def node(context: Any, namespace: str, spin: Spin) -> Node:
    return spin(Node("docking", **options(context, namespace)))


@pytest.fixture
def services(node: Node) -> Services:
    return Services(node, lambda stamp: 0.0)


def reply(services: Services) -> Reply:
    found: list[Reply] = []
    wait_until(lambda: found.extend(services.take()[0]) or found, "a reply")
    return found[0]


def test_a_service_that_appears_after_the_call_is_used(node: Node, services: Services) -> None:
    services.call(Request(7, Service.TARE))
    assert services.take() == ((), "")

    def tare(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, "tared"
        return response

    node.create_service(Trigger, "tare", tare, callback_group=ReentrantCallbackGroup())
    answer = reply(services)
    assert (answer.number, answer.success, answer.message) == (7, True, "tared")


def test_a_service_that_never_appears_is_named(services: Services) -> None:
    services.call(Request(8, Service.PROBE))
    answer = reply(services)
    assert (answer.number, answer.success) == (8, False)
    assert answer.message.startswith("no node serves")
    assert "probe" in answer.message


def test_torque_on_never_overtakes_torque_off_when_servo_node_comes_late(node: Node) -> None:
    heard = list[bool]()
    services = Services(node, lambda stamp: 0.0)
    services.call(Request(1, Service.TORQUE_ON))
    node.create_service(SetBool, "set_torque", lambda request, answer: _hear(heard, request, answer))
    client = services._clients[Service.TORQUE_ON]
    wait_until(client.service_is_ready, "the service")
    services.call(Request(2, Service.TORQUE_OFF))
    wait_until(lambda: services.take() and len(heard) == 2, "both calls")
    assert heard == [True, False]


def test_what_a_goal_that_failed_had_asked_for_is_not_sent_any_more(node: Node) -> None:
    heard = list[bool]()
    services = Services(node, lambda stamp: 0.0)
    services.call(Request(1, Service.TORQUE_ON))
    services.call(Request(2, Service.TORQUE_OFF))
    services.forget()
    node.create_service(SetBool, "set_torque", lambda request, answer: _hear(heard, request, answer))
    wait_until(lambda: services.take() and heard, "the call that makes safe")
    assert heard == [False]


def _hear(heard: list[bool], request: SetBool.Request, answer: SetBool.Response) -> SetBool.Response:
    heard.append(request.data)
    answer.success = True
    return answer
