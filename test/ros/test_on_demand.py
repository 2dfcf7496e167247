# SPDX-License-Identifier: Apache-2.0
"""On-demand subscriptions work only when asked; an answer arrives even late; what is unknown is NaN."""

from __future__ import annotations

import math
from typing import Any

import pytest
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_msgs.msg import Int64

from deltacharger_core.ros import messages, on_demand

from ..chargers import DEADLINE, Spin, wait_until
from ..nodes import numbers, options

pytestmark = pytest.mark.ros

DEPTH = 3
QOS = QoSProfile(depth=DEPTH)


@pytest.fixture
def node(context: Any, namespace: str, spin: Spin) -> Node:
    return spin(Node("listener", **options(context, namespace)))


@pytest.fixture
def publisher(node: Node) -> Publisher[Int64]:
    return node.create_publisher(Int64, "counts", QOS)


def publish(publisher: Publisher[Int64], *numbers: int) -> None:
    wait_until(lambda: publisher.get_subscription_count() > 0, "the subscription")
    for number in numbers:
        publisher.publish(Int64(data=number))
    assert publisher.wait_for_all_acked()


@pytest.mark.version
def test_the_callback_runs_only_while_listening_and_gets_the_newest_first(
    node: Node, publisher: Publisher[Int64]
) -> None:
    received: list[int] = []
    counts = on_demand.OnDemandSubscription(node, Int64, "counts", lambda message: received.append(message.data), QOS)
    publish(publisher, 1, 2, 3)
    assert received == []
    with counts.listening():
        assert received == [3]  # at once, in the thread that starts to listen
        publish(publisher, 4)
        wait_until(lambda: received == [3, 4], "the next message")
        with counts.listening():  # by another one, who leaves first
            pass
        publish(publisher, 5)
        wait_until(lambda: received == [3, 4, 5], "the message during the remaining listener")
    publish(publisher, 6, 7)
    with counts.listening():
        assert received == [3, 4, 5, 7]


def test_a_flood_neither_fills_nor_holds_its_reader(node: Node, publisher: Publisher[Int64]) -> None:
    """It gets as many messages as the depth, the newest."""
    topic, taken = on_demand.PolledTopic(node, Int64, "counts", QOS), 0
    publish(publisher, *range(2 * DEPTH))
    assert [message.data for message, _ in topic.take()] == list(range(DEPTH, 2 * DEPTH))
    publish(publisher, 0)
    for _ in topic.take():
        taken += 1
        assert taken <= DEPTH
        publish(publisher, taken)
    assert taken == DEPTH


@pytest.mark.version
def test_a_latest_message_is_the_newest_from_either_path(node: Node, publisher: Publisher[Int64]) -> None:
    latest = on_demand.LatestMessage(node, Int64, "counts", QOS)
    assert latest.take() is None
    publish(publisher, 1, 2)
    assert latest.take().data == 2
    for turn in range(3, 9, 2):
        publish(publisher, turn)
        latest.wait(DEADLINE)
        assert latest.take().data == turn
        latest.rest()
        publish(publisher, turn + 1)
        wait_until(lambda turn=turn: (message := latest.take()) and message.data == turn + 1, "the next message")
    assert latest.take() is None


@pytest.mark.parametrize(
    ("kind", "count"),
    [(PredictMisalignment.Response, 14), (DetectElectrodes.Response, 7 + 36 + 3), (Probe.Response, 2)],
)
def test_every_float_of_an_answer_without_measurement_is_nan(kind: Any, count: int) -> None:
    assert 0.0 in list(numbers(kind()))
    found = list(numbers(messages.unknown(kind())))
    assert len(found) == count
    assert all(map(math.isnan, found))
