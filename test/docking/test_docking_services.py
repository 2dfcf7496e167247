# SPDX-License-Identifier: Apache-2.0
"""Docking's calls: a service that comes late is waited for, one that never comes is told."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from deltacharger_docking.observation import Reply, Request, Service
from deltacharger_docking.ros.services import Services
from deltacharger_ros.executor import Spinner

from ..chargers import wait_until

pytestmark = pytest.mark.ros


@pytest.fixture
def node(context: Any, namespace: str) -> Iterator[Node]:
    node = Node("docking", context=context, namespace=namespace, use_global_arguments=False)
    spinner = Spinner(node)
    yield node
    spinner.close()
    node.destroy_node()


@pytest.fixture
def services(node: Node) -> Services:
    return Services(node, lambda stamp: 0.0)


def reply(services: Services) -> Reply:
    found: list[Reply] = []
    wait_until(lambda: found.extend(services.take()[0]) or found, "a reply", 10.0)
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
