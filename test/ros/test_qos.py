# SPDX-License-Identifier: Apache-2.0
"""An answer arrives even if many other clients are answered before its client reads it."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from deltacharger_ros.executor import Spinner
from deltacharger_ros.qos import SERVICE

from ..chargers import DEADLINE, Spin, wait_until
from ..nodes import answer, options

pytestmark = pytest.mark.ros

OTHERS = 200


@pytest.mark.version
def test_answers_to_others_do_not_displace_a_late_clients_answer(context: Any, namespace: str, spin: Spin) -> None:
    server, others = (
        spin(Node("server", **options(context, namespace))),
        spin(Node("others", **options(context, namespace))),
    )
    answered: list[None] = []

    def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        answered.append(None)
        return response

    server.create_service(Trigger, "tare", serve, callback_group=ReentrantCallbackGroup(), qos_profile=SERVICE)
    late = Node("late", **options(context, namespace))
    client: Any = late.create_client(Trigger, "tare", qos_profile=SERVICE)
    other: Any = others.create_client(Trigger, "tare", qos_profile=SERVICE)
    assert client.wait_for_service(DEADLINE)
    assert other.wait_for_service(DEADLINE)
    own = client.call_async(Trigger.Request())
    wait_until(lambda: answered, "the answer, not yet taken")
    for _ in range(OTHERS):
        answer(other.call_async(Trigger.Request()))
    spinner = Spinner(late)
    try:
        wait_until(own.done, "the answer")
    finally:
        spinner.close()
