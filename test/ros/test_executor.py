# SPDX-License-Identifier: Apache-2.0
"""The executor serves at once in one thread, is idle at rest, runs waiting callbacks aside, and reports errors."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from deltacharger.action import Dock
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from deltacharger_core.ros.executor import Spinner, order_age, serving

from ..chargers import DEADLINE, wait_until
from ..nodes import answer, call, options
from ..waiting import host

pytestmark = pytest.mark.ros

Serve = Callable[..., Spinner]


@pytest.fixture
def node(context: Any, namespace: str) -> Iterator[Node]:
    node = Node("subject", **options(context, namespace))
    yield node
    node.destroy_node()


@pytest.fixture
def serve(node: Node) -> Iterator[Serve]:
    """Serve the node from the call on; at the end close it with the given waitables."""
    closers: list[Callable[[], None]] = []

    def begin(*waitables: Any) -> Spinner:
        spinner = Spinner(node)
        closers.append(lambda: spinner.close(*waitables))
        return spinner

    yield begin
    for close in closers:
        close()


class Slow:
    """A callback that waits until the test releases it."""

    def __init__(self) -> None:
        self.begun = threading.Semaphore(0)
        self.release = threading.Event()

    def serve(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.begun.release()
        self.release.wait(DEADLINE)
        return response

    def wait_for(self, count: int) -> None:
        assert all(self.begun.acquire(timeout=DEADLINE) for _ in range(count))


@pytest.fixture
def slow(serve: Serve) -> Iterator[Slow]:
    slow = Slow()
    yield slow
    slow.release.set()


def quick(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
    response.message = "quick"
    return response


def fails(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
    raise RuntimeError("a defect")


def ended(spinner: Spinner) -> bool:
    return bool(wait_until(lambda: not spinner.is_alive(), "the end of the spinner"))


def test_an_idle_executor_uses_no_processor_time(node: Node, serve: Serve) -> None:
    ticks: list[None] = []
    node.create_timer(0.05, lambda: ticks.append(None))
    serve()
    wait_until(lambda: ticks, "the timer")
    spent, wall = time.process_time(), time.monotonic()
    time.sleep(0.3)  # it has nothing else to do
    share = (time.process_time() - spent) / (time.monotonic() - wall)
    assert share < 0.3, f"the process used {100 * share:.0f} % of a core for nothing"


@pytest.mark.version
def test_services_of_a_reentrant_group_wait_concurrently(node: Node, serve: Serve, slow: Slow) -> None:
    ticks: list[None] = []
    node.create_service(Trigger, "slow", slow.serve, callback_group=ReentrantCallbackGroup())
    node.create_service(Trigger, "own_workers", quick, callback_group=ReentrantCallbackGroup())
    node.create_service(Trigger, "no_worker", quick)
    node.create_timer(0.01, lambda: ticks.append(None))
    clients: list[Any] = [node.create_client(Trigger, name) for name in ("slow", "own_workers", "no_worker")]
    serve()
    assert all(client.wait_for_service(DEADLINE) for client in clients)
    waiting = [clients[0].call_async(Trigger.Request()) for _ in range(6)]  # more than there are workers
    slow.wait_for(2)
    assert [call(client, Trigger.Request()).message for client in clients[1:]] == ["quick"] * 2
    ticks.clear()
    wait_until(lambda: ticks, "the timer")
    assert not any(each.done() for each in waiting)
    slow.release.set()
    wait_until(lambda: all(each.done() for each in waiting), "all answers")


@pytest.mark.version
def test_a_service_knows_how_old_its_request_is(node: Node, serve: Serve) -> None:
    """Whatever the type of the service; here the node is suspended when the request is sent."""
    ages: list[float] = []

    def old(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        ages.append(order_age())
        return response

    node.create_service(Trigger, "aged", old, callback_group=ReentrantCallbackGroup())
    client: Any = node.create_client(Trigger, "aged")
    wait_until(client.service_is_ready)
    asked = client.call_async(Trigger.Request())
    time.sleep(0.2)  # the suspension
    serve()
    answer(asked)
    assert 0.2 <= ages[0] < DEADLINE
    assert order_age() == 0.0, "no request is served here"


@pytest.mark.parametrize(("ago", "seconds"), [(1.3, 1.3), (math.inf, 0.0), (-3600.0, 0.0), (1e9, 0.0)])
def test_only_a_request_that_surely_is_old_has_an_age(ago: float, seconds: float) -> None:
    sent = 0 if math.isinf(ago) else time.time_ns() - round(1e9 * ago)
    with serving(SimpleNamespace(source_timestamp=sent)):
        assert order_age() == pytest.approx(seconds, abs=host(0.1))


@pytest.mark.version
def test_an_action_client_may_be_created_while_its_node_is_served(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    add, came = Node.add_waitable, threading.Event()

    def add_early(self: Node, waitable: Any) -> None:
        add(self, waitable)
        time.sleep(0.1)  # rclpy's constructor has a line to go, and the executor has been woken

    monkeypatch.setattr(Node, "add_waitable", add_early)
    spinner = Spinner(node)
    clients = [ActionClient(node, Dock, f"dock_{number}") for number in range(2)]
    node.create_timer(0.01, came.set)
    assert came.wait(DEADLINE)
    spinner.close(*clients)


@pytest.mark.version
@pytest.mark.parametrize("group", [MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup])
def test_a_callback_that_raises_ends_the_spinner(
    node: Node, serve: Serve, monkeypatch: pytest.MonkeyPatch, group: Any
) -> None:
    """In the serving thread, and in a worker."""
    monkeypatch.setattr(threading, "excepthook", lambda arguments: None)
    node.create_service(Trigger, "service", fails, callback_group=group())
    client: Any = node.create_client(Trigger, "service")
    spinner = serve()
    assert client.wait_for_service(DEADLINE)
    client.call_async(Trigger.Request())
    assert ended(spinner)


def test_the_shutdown_of_ros_ends_the_spinner(namespace: str) -> None:
    own = rclpy.Context()
    rclpy.init(context=own, args=[])
    spinner = Spinner(Node("subject", context=own, namespace=namespace, use_global_arguments=False))
    rclpy.shutdown(context=own)
    assert ended(spinner)
    spinner.close()


@pytest.mark.rest
def test_a_node_closes_despite_a_callback_that_never_ends(node: Node, serve: Serve, slow: Slow) -> None:
    node.create_service(Trigger, "service", slow.serve, callback_group=ReentrantCallbackGroup())
    client: Any = node.create_client(Trigger, "service")
    spinner = serve()
    assert client.wait_for_service(DEADLINE)
    client.call_async(Trigger.Request())
    slow.wait_for(1)
    spinner.close()
    assert not spinner.is_alive()
