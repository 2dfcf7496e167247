# SPDX-License-Identifier: Apache-2.0
"""The executor serves at once in one thread, is idle at rest, runs waiting callbacks aside, and reports errors."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import rclpy
from deltacharger.action import Dock
from rclpy.action import ActionClient, ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_msgs.msg import Empty, Int64
from std_srvs.srv import Trigger

from deltacharger_ros.executor import Spinner

from ..chargers import DEADLINE, wait_until
from ..nodes import answer, options

pytestmark = pytest.mark.ros


@pytest.fixture
def node(context: Any, namespace: str) -> Iterator[Node]:
    node = Node("subject", **options(context, namespace))
    yield node
    node.destroy_node()


@pytest.fixture
def quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Suppress error output of ending threads."""
    monkeypatch.setattr(threading, "excepthook", lambda arguments: None)


def test_an_idle_executor_uses_no_processor_time(node: Node) -> None:
    ticks: list[None] = []
    node.create_timer(0.05, lambda: ticks.append(None))
    spinner = Spinner(node)
    try:
        wait_until(lambda: ticks, "the timer")
        spent, wall = time.process_time(), time.monotonic()
        wait_until(lambda: len(ticks) > 10, "more of it")
        share = (time.process_time() - spent) / (time.monotonic() - wall)
    finally:
        spinner.close()
    assert share < 0.3, f"the process used {100 * share:.0f} % of a core for nothing"


def test_services_of_a_reentrant_group_wait_concurrently(node: Node) -> None:
    busy, release, ticks = threading.Semaphore(0), threading.Event(), []

    def slow(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        busy.release()
        release.wait(DEADLINE)
        return response

    def quick(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = "quick"
        return response

    waits = ReentrantCallbackGroup()
    node.create_service(Trigger, "slow", slow, callback_group=waits)
    node.create_service(Trigger, "own_workers", quick, callback_group=ReentrantCallbackGroup())
    node.create_service(Trigger, "no_worker", quick)
    node.create_timer(0.01, lambda: ticks.append(None))
    clients: list[Any] = [node.create_client(Trigger, name) for name in ("slow", "own_workers", "no_worker")]
    spinner = Spinner(node)
    try:
        assert all(client.wait_for_service(DEADLINE) for client in clients)
        waiting = [clients[0].call_async(Trigger.Request()) for _ in range(6)]  # more than there are workers
        for _ in range(2):
            assert busy.acquire(timeout=DEADLINE)
        for client in clients[1:]:
            answer = client.call_async(Trigger.Request())
            wait_until(answer.done, "the answer")
            assert answer.result().message == "quick"
        ticks.clear()
        wait_until(lambda: ticks, "the timer")
        assert not any(each.done() for each in waiting)
        release.set()
        wait_until(lambda: all(each.done() for each in waiting), "all answers")
    finally:
        release.set()
        spinner.close()


def test_goals_wait_concurrently_and_are_answered(node: Node) -> None:
    begun, release = threading.Semaphore(0), threading.Event()

    def execute(handle: Any) -> Dock.Result:
        begun.release()
        release.wait(DEADLINE)
        handle.succeed()
        return Dock.Result(success=True)

    server: Any = ActionServer(node, Dock, "dock", execute, callback_group=ReentrantCallbackGroup())
    client: Any = ActionClient(node, Dock, "dock")
    spinner = Spinner(node)
    try:
        assert client.wait_for_server(DEADLINE)
        sent = [answer(spinner.call_soon(client.send_goal_async, Dock.Goal())) for _ in range(2)]
        for _ in sent:
            assert begun.acquire(timeout=DEADLINE)
        wait_until(lambda: all(each.done() for each in sent), "both accepted")
        results = [each.result().get_result_async() for each in sent]
        release.set()
        wait_until(lambda: all(each.done() for each in results), "both results")
        assert all(each.result().result.success for each in results)
    finally:
        release.set()
        spinner.close(client, server)


def test_messages_are_served_in_order_during_a_slow_service(node: Node) -> None:
    called, release = threading.Event(), threading.Event()

    def slow(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        called.set()
        release.wait(DEADLINE)
        return response

    received: list[int] = []
    group = ReentrantCallbackGroup()
    node.create_service(Trigger, "service", slow, callback_group=group)
    client: Any = node.create_client(Trigger, "service", callback_group=group)
    node.create_subscription(Int64, "topic", lambda message: received.append(message.data), 100, callback_group=group)
    publisher = node.create_publisher(Int64, "topic", 100)
    wait_until(publisher.get_subscription_count, "the subscription")
    spinner = Spinner(node)
    try:
        assert client.wait_for_service(DEADLINE)
        answer = client.call_async(Trigger.Request())
        assert called.wait(DEADLINE)
        for number in range(50):
            publisher.publish(Int64(data=number))
        wait_until(lambda: len(received) == 50, "every message")
        assert received == list(range(50))
        assert not answer.done()
        release.set()
        wait_until(answer.done, "the answer")
    finally:
        release.set()
        spinner.close()


def test_added_entities_are_served_and_removed_ones_released(node: Node) -> None:
    spinner = Spinner(node)
    received: list[int] = []
    publisher = node.create_publisher(Int64, "topic", 10)
    try:
        for number in range(20):
            subscription = node.create_subscription(Int64, "topic", lambda message: received.append(message.data), 10)
            wait_until(lambda: publisher.get_subscription_count() == 1, "the subscription")
            publisher.publish(Int64(data=number))
            wait_until(lambda number=number: received and received[-1] == number, f"message {number}")
            node.destroy_subscription(subscription)
            wait_until(lambda: publisher.get_subscription_count() == 0, "its end")
        assert spinner.is_alive()
    finally:
        spinner.close()
    assert received == list(range(20))


def test_an_action_client_may_be_created_while_its_node_is_served(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    add = Node.add_waitable

    def add_early(self: Node, waitable: Any) -> None:
        add(self, waitable)
        time.sleep(0.1)  # rclpy's constructor has a line to go, and the executor has been woken

    monkeypatch.setattr(Node, "add_waitable", add_early)
    spinner = Spinner(node)
    came = threading.Event()
    try:
        clients: list[Any] = [ActionClient(node, Dock, f"dock_{number}") for number in range(3)]
        node.create_timer(0.01, came.set)
        assert came.wait(DEADLINE)
    finally:
        spinner.close()
    for client in clients:
        client.destroy()


def test_a_callback_that_raises_ends_the_spinner(node: Node, quiet: None) -> None:
    def fail(message: Empty) -> None:
        raise RuntimeError("a defect")

    node.create_subscription(Empty, "topic", fail, 1)
    publisher = node.create_publisher(Empty, "topic", 1)
    wait_until(lambda: publisher.get_subscription_count() == 1, "the subscription")
    spinner = Spinner(node)
    try:
        publisher.publish(Empty())
        wait_until(lambda: not spinner.is_alive(), "the end of the spinner")
    finally:
        spinner.close()


def test_a_service_that_raises_in_its_worker_ends_the_spinner(node: Node, quiet: None) -> None:
    def fail(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        raise RuntimeError("a defect")

    node.create_service(Trigger, "service", fail, callback_group=ReentrantCallbackGroup())
    client: Any = node.create_client(Trigger, "service")
    spinner = Spinner(node)
    try:
        assert client.wait_for_service(DEADLINE)
        client.call_async(Trigger.Request())
        wait_until(lambda: not spinner.is_alive(), "the end of the spinner")
    finally:
        spinner.close()


def test_a_program_that_closes_nothing_ends_normally() -> None:
    """Even while many messages arrive."""
    code = """
import threading, rclpy
from rclpy.node import Node
from std_msgs.msg import Empty
from deltacharger_ros.executor import Spinner
rclpy.init(args=[])
node, received = Node("subject"), threading.Semaphore(0)
node.create_subscription(Empty, "topic", lambda message: received.release(), 10)
publisher = node.create_publisher(Empty, "topic", 10)
spinner = Spinner(node)
def pour():
    while True:
        publisher.publish(Empty())
threading.Thread(target=pour, daemon=True).start()
received.acquire()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=DEADLINE, check=False)
    assert ended.returncode == 0, ended.stderr.decode()


def test_the_shutdown_of_ros_ends_the_spinner(namespace: str) -> None:
    own = rclpy.Context()
    rclpy.init(context=own, args=[])
    spinner = Spinner(Node("subject", context=own, namespace=namespace, use_global_arguments=False))
    rclpy.shutdown(context=own)
    wait_until(lambda: not spinner.is_alive(), "the end of the spinner")
    spinner.close()


def test_callbacks_work_while_a_node_closes(context: Any, namespace: str) -> None:
    class Subject(Node):
        answered = False

        def close(self) -> None:
            future = self.create_client(Trigger, "service").call_async(Trigger.Request())
            wait_until(future.done, "the answer")
            self.answered = True

    node = Subject("subject", **options(context, namespace))
    node.create_service(Trigger, "service", lambda request, response: response, callback_group=ReentrantCallbackGroup())
    spinner = Spinner(node)
    spinner.close()
    assert node.answered
    assert not spinner.is_alive()


def test_a_node_closes_despite_a_callback_that_never_ends(node: Node) -> None:
    called, release = threading.Event(), threading.Event()

    def stuck(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        called.set()
        release.wait(DEADLINE)
        return response

    node.create_service(Trigger, "service", stuck, callback_group=ReentrantCallbackGroup())
    client: Any = node.create_client(Trigger, "service")
    spinner = Spinner(node)
    assert client.wait_for_service(DEADLINE)
    client.call_async(Trigger.Request())
    assert called.wait(DEADLINE)
    try:
        spinner.close()
        assert not spinner.is_alive()
    finally:
        release.set()  # its answer has no receiver
