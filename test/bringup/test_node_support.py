"""What every node stands on: an executor that rests while it waits, and fails aloud."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Empty

from deltacharger_bringup import node_support
from deltacharger_bringup.node_support import Spinner, StartupError

from .conftest import DEADLINE, wait_until


@pytest.fixture
def node(context: Any, namespace: str) -> Iterator[Node]:
    node = Node("subject", context=context, namespace=namespace, use_global_arguments=False)
    yield node
    node.destroy_node()


def test_an_executor_rests_while_a_message_waits_for_a_busy_worker(node: Node) -> None:
    busy, release = threading.Semaphore(0), threading.Event()

    def slow(message: Empty) -> None:
        busy.release()
        release.wait(DEADLINE)

    workers = 2
    node.create_subscription(Empty, "topic", slow, 10, callback_group=ReentrantCallbackGroup())
    publisher = node.create_publisher(Empty, "topic", 10)
    wait_until(lambda: publisher.get_subscription_count() == 1, "the subscription")
    spinner = Spinner(node, workers)
    try:
        for _ in range(workers + 1):
            publisher.publish(Empty())
        for _ in range(workers):
            assert busy.acquire(timeout=DEADLINE)
        publisher.publish(Empty())  # arrives while the one before it waits, and is what woke the original for ever
        spent, wall = time.process_time(), time.monotonic()
        threading.Event().wait(0.5)
        share = (time.process_time() - spent) / (time.monotonic() - wall)
    finally:
        release.set()
        spinner.close()
    assert share < 0.3, f"the process used {100 * share:.0f} % of a core for nothing"


def test_callbacks_of_a_reentrant_group_run_beside_each_other(node: Node) -> None:
    together = threading.Barrier(2, timeout=10.0)
    met = threading.Event()

    def meet(message: Empty) -> None:
        together.wait()
        met.set()

    for topic in ("one", "two"):
        node.create_subscription(Empty, topic, meet, 1, callback_group=ReentrantCallbackGroup())
    publishers = [node.create_publisher(Empty, topic, 1) for topic in ("one", "two")]
    wait_until(lambda: all(publisher.get_subscription_count() for publisher in publishers), "both subscriptions")
    spinner = Spinner(node)
    try:
        for publisher in publishers:
            publisher.publish(Empty())
        assert met.wait(10.0)
    finally:
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
