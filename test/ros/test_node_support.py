# SPDX-License-Identifier: Apache-2.0
"""What every node stands on: an executor that rests while it waits, and fails aloud."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.action import Dock
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Empty, Int64
from std_srvs.srv import Trigger

from deltacharger_ros import node_support, patient_executor
from deltacharger_ros.node_support import Spinner, StartupError

from ..chargers import DEADLINE, wait_until

pytestmark = pytest.mark.ros


@pytest.fixture
def node(context: Any, namespace: str) -> Iterator[Node]:
    node = Node("subject", context=context, namespace=namespace, use_global_arguments=False)
    yield node
    node.destroy_node()


def test_an_executor_rests_while_a_message_waits_for_its_group(node: Node) -> None:
    busy, release, came = threading.Event(), threading.Event(), threading.Event()

    def slow() -> None:
        busy.set()
        release.wait(DEADLINE)

    group = MutuallyExclusiveCallbackGroup()
    node.create_timer(0.01, slow, callback_group=group)
    node.create_subscription(Empty, "topic", lambda message: came.set(), 10, callback_group=group)
    publisher = node.create_publisher(Empty, "topic", 10)
    wait_until(lambda: publisher.get_subscription_count() == 1, "the subscription")
    spinner = Spinner(node, 2)
    try:
        assert busy.wait(DEADLINE)
        for _ in range(3):
            publisher.publish(Empty())  # they wait for the timer, and are what woke the original for ever
        spent, wall = time.process_time(), time.monotonic()
        threading.Event().wait(0.5)
        share = (time.process_time() - spent) / (time.monotonic() - wall)
        assert not came.is_set()
        release.set()
        assert came.wait(DEADLINE)
    finally:
        release.set()
        spinner.close()
    assert share < 0.3, f"the process used {100 * share:.0f} % of a core for nothing"


def test_timers_of_a_reentrant_group_run_beside_each_other_and_beside_messages(node: Node) -> None:
    busy, release, came = threading.Semaphore(0), threading.Event(), threading.Event()

    def slow() -> None:
        busy.release()
        release.wait(DEADLINE)

    group = ReentrantCallbackGroup()
    for period in (0.01, 0.02):
        node.create_timer(period, slow, callback_group=group)
    node.create_subscription(Empty, "topic", lambda message: came.set(), 1, callback_group=group)
    publisher = node.create_publisher(Empty, "topic", 1)
    wait_until(publisher.get_subscription_count, "the subscription")
    spinner = Spinner(node, 2)
    try:
        for _ in range(2):
            assert busy.acquire(timeout=DEADLINE)
        publisher.publish(Empty())
        assert came.wait(DEADLINE)
    finally:
        release.set()
        spinner.close()


def test_messages_are_served_in_order_while_a_service_takes_its_time(node: Node) -> None:
    called, release = threading.Event(), threading.Event()

    def slow(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        called.set()
        release.wait(DEADLINE)
        return response

    heard: list[int] = []
    group = ReentrantCallbackGroup()
    node.create_service(Trigger, "service", slow, callback_group=group)
    client: Any = node.create_client(Trigger, "service", callback_group=group)
    node.create_subscription(Int64, "topic", lambda message: heard.append(message.data), 100, callback_group=group)
    publisher = node.create_publisher(Int64, "topic", 100)
    wait_until(publisher.get_subscription_count, "the subscription")
    spinner = Spinner(node, 2)
    try:
        assert client.wait_for_service(DEADLINE)
        answer = client.call_async(Trigger.Request())
        assert called.wait(DEADLINE)
        for number in range(50):
            publisher.publish(Int64(data=number))
        wait_until(lambda: len(heard) == 50, "every message")
        assert heard == list(range(50))
        assert not answer.done()
        release.set()
        wait_until(answer.done, "the answer")
    finally:
        release.set()
        spinner.close()


def test_entities_that_come_and_go_are_served_and_forgotten(node: Node) -> None:
    spinner = Spinner(node)
    heard: list[int] = []
    publisher = node.create_publisher(Int64, "topic", 10)
    try:
        for number in range(20):
            subscription = node.create_subscription(Int64, "topic", lambda message: heard.append(message.data), 10)
            wait_until(lambda: publisher.get_subscription_count() == 1, "the subscription")
            publisher.publish(Int64(data=number))
            wait_until(lambda number=number: heard and heard[-1] == number, f"message {number}")
            node.destroy_subscription(subscription)
            wait_until(lambda: publisher.get_subscription_count() == 0, "its end")
        assert spinner.is_alive()
    finally:
        spinner.close()
    assert heard == list(range(20))


def test_an_action_client_may_be_made_while_its_node_is_served(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    add = Node.add_waitable

    def add_early(self: Node, waitable: Any) -> None:
        add(self, waitable)
        time.sleep(0.1)  # rclpy's constructor has a line to go, and the executor has been woken

    monkeypatch.setattr(Node, "add_waitable", add_early)
    spinner = Spinner(node, 2)
    came = threading.Event()
    try:
        clients: list[Any] = [ActionClient(node, Dock, f"dock_{number}") for number in range(3)]
        node.create_timer(0.01, came.set)
        assert came.wait(DEADLINE)
    finally:
        spinner.close()
    for client in clients:
        client.destroy()


def test_nothing_is_gathered_anew_between_two_messages(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[int] = []
    node.create_subscription(Int64, "topic", lambda message: heard.append(message.data), 10)
    publisher = node.create_publisher(Int64, "topic", 10)
    wait_until(publisher.get_subscription_count, "the subscription")
    spinner = Spinner(node)
    try:
        publisher.publish(Int64(data=0))
        wait_until(lambda: heard, "the first message")

        def refuse(*arguments: Any) -> None:
            raise AssertionError("all entities are gathered anew")

        monkeypatch.setattr(patient_executor, "_gather", refuse)
        monkeypatch.setattr(Executor, "_wait_for_ready_callbacks", refuse)
        for number in range(1, 20):
            publisher.publish(Int64(data=number))
            wait_until(lambda number=number: heard[-1] == number, f"message {number}")
        assert spinner.is_alive()
    finally:
        monkeypatch.undo()
        spinner.close()


def test_a_callback_that_raises_ends_the_spinner(node: Node, capfd: pytest.CaptureFixture[str]) -> None:
    def fail(message: Empty) -> None:
        raise RuntimeError("a defect")

    node.create_subscription(Empty, "topic", fail, 1)
    publisher = node.create_publisher(Empty, "topic", 1)
    wait_until(lambda: publisher.get_subscription_count() == 1, "the subscription")
    spinner = Spinner(node)
    spinner_thread_reports = threading.excepthook
    threading.excepthook = lambda arguments: None
    try:
        publisher.publish(Empty())
        wait_until(lambda: not spinner.is_alive(), "the end of the spinner")
    finally:
        threading.excepthook = spinner_thread_reports
        spinner.close()


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"rate": 900.0}, "'rate'"),
        ({"rate": "fast"}, "'rate'"),
        ({"rat": 5.0}, "did you mean 'rate'"),
    ],
)
def test_a_wrong_parameter_stops_the_node_with_its_name(
    context: Any, namespace: str, given: dict[str, Any], says: str
) -> None:
    class Subject(Node):
        def __init__(self) -> None:
            overrides = [Parameter(name, value=value) for name, value in given.items()]
            super().__init__(
                "subject",
                context=context,
                namespace=namespace,
                parameter_overrides=overrides,
                use_global_arguments=False,
            )
            node_support.declare(self, "rate", 50.0, "how often (Hz)", 1.0, 500.0)
            node_support.reject_unknown(self)

    with pytest.raises(StartupError, match=says):
        Subject()
