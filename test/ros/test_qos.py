# SPDX-License-Identifier: Apache-2.0
"""An answer arrives even if others are answered before; an answer without a measurement contains no number."""

from __future__ import annotations

import math
from typing import Any

import pytest
from deltacharger.msg import Misalignment
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from deltacharger_ros.executor import Spinner
from deltacharger_ros.qos import SERVICE
from deltacharger_ros.unknown import unknown, unknown_misalignment

from ..chargers import DEADLINE, Spin, wait_until
from ..nodes import answer, numbers, options

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


@pytest.mark.parametrize(
    ("kind", "count"),
    [(PredictMisalignment.Response, 14), (DetectElectrodes.Response, 7 + 36 + 3), (Probe.Response, 2)],
)
def test_every_float_of_an_answer_without_measurement_is_nan(kind: Any, count: int) -> None:
    assert 0.0 in list(numbers(kind()))
    found = list(numbers(unknown(kind())))
    assert len(found) == count
    assert all(map(math.isnan, found))


def test_an_unknown_misalignment_has_a_frame_and_no_contact() -> None:
    message = unknown_misalignment()
    assert message.header.frame_id == "end_effector"
    assert (message.contact, message.sure, message.in_range) == (False, False, False)
    assert not len(message.angle_probability)
    assert message.header.stamp == Misalignment().header.stamp
