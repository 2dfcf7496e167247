# SPDX-License-Identifier: Apache-2.0
"""CPU time per message for each way of receiving it, and response time of a service, also under message load.

python lab/benchmarks/executor.py [--turns 5] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import statistics
import sys
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from typing import Any

from deltacharger_core import environment

environment.prepare()
environment.isolate()

import rclpy  # noqa: E402
from deltacharger.msg import TactileFrame  # noqa: E402
from rclpy.callback_groups import ReentrantCallbackGroup  # noqa: E402
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from deltacharger_ros.executor import Spinner  # noqa: E402
from deltacharger_ros.on_demand import PolledTopic  # noqa: E402

WAYS = ("none", "polled", "node's thread, undecoded", "node's thread", "rclpy's MultiThreadedExecutor")
LISTENERS = 3
MESSAGES, PACE = 800, 400.0  # Hz
CALLS = 100
STORM = 4000.0  # Hz
_numbers = itertools.count()


@contextlib.contextmanager
def served(node: Node, way: str) -> Iterator[None]:
    """Serve a node during the block."""
    if way != WAYS[-1]:
        spinner = Spinner(node)
        try:
            yield
        finally:
            spinner.close()
        return
    executor = MultiThreadedExecutor(4, context=node.context)
    executor.add_node(node)

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown(5.0)
        thread.join(5.0)
        node.destroy_node()


def new_node(name: str) -> Node:
    return Node(f"{name}_{next(_numbers)}", use_global_arguments=False)


def frame() -> bytes:
    taxels = array("f", bytes(400))
    return serialize_message(TactileFrame(rows=10, columns=10, left=taxels, right=taxels))


def paced(rate: float, count: int, send: Callable[[int], None]) -> None:
    due = time.monotonic()
    for number in range(count):
        send(number)
        due += 1.0 / rate
        time.sleep(max(0.0, due - time.monotonic()))


def message_cost(way: str) -> float:
    """Return the CPU time of this process, s, per message published to three listeners."""
    with contextlib.ExitStack() as stack:
        publishing = new_node("publisher")
        stack.callback(publishing.destroy_node)
        publisher = publishing.create_publisher(TactileFrame, "frames", qos_profile_sensor_data)
        heard: list[Any] = []
        polled = []
        for _ in range(0 if way == WAYS[0] else LISTENERS):
            node = new_node("listener")
            if way == "polled":
                polled.append(PolledTopic(node, TactileFrame, "frames", qos_profile_sensor_data))
                stack.callback(node.destroy_node)
                continue
            raw = way.endswith("undecoded")
            node.create_subscription(TactileFrame, "frames", heard.append, qos_profile_sensor_data, raw=raw)
            stack.enter_context(served(node, way))
        time.sleep(1.0)  # for discovery
        message = frame()

        def send(number: int) -> None:
            publisher.publish(message)
            if number % 4 == 0:
                heard.extend(each for topic in polled for each in topic.take())

        began = time.process_time()
        paced(PACE, MESSAGES, send)
        return (time.process_time() - began) / MESSAGES


def answer_times(way: str, storm: bool) -> list[float]:
    """Return the time, s, of each of many calls, with or without a storm of messages to the node."""
    with contextlib.ExitStack() as stack:
        node = new_node("server")
        node.create_service(
            Trigger, "service", lambda request, response: response, callback_group=ReentrantCallbackGroup()
        )
        node.create_subscription(TactileFrame, "storm", lambda message: None, qos_profile_sensor_data)
        stack.enter_context(served(node, way))
        asking = new_node("client")
        client: Any = asking.create_client(Trigger, "service")
        publisher = asking.create_publisher(TactileFrame, "storm", qos_profile_sensor_data)
        stack.enter_context(served(asking, WAYS[1]))
        client.wait_for_service(10.0)
        ended, message = threading.Event(), frame()

        def blow() -> None:
            while not ended.is_set():
                paced(STORM / 10, 10, lambda number: [publisher.publish(message) for _ in range(10)] and None)

        thread = threading.Thread(target=blow)
        if storm:
            thread.start()
        times = []
        for _ in range(CALLS):
            answered, began = threading.Event(), time.monotonic()
            client.call_async(Trigger.Request()).add_done_callback(lambda future, answered=answered: answered.set())
            answered.wait(10.0)
            times.append(time.monotonic() - began)
            time.sleep(0.01)
        ended.set()
        if storm:
            thread.join()
        return times


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=5, help="rounds over all ways; medians are reported")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    arguments = parser.parse_args()
    rclpy.init(args=[])
    turns = range(arguments.turns)
    costs: dict[str, list[float]] = {way: [] for way in WAYS}
    answers: dict[tuple[str, bool], list[float]] = {(way, storm): [] for way in WAYS[3:] for storm in (False, True)}
    for turn in turns:
        print(f"turn {turn + 1} of {len(turns)}", file=sys.stderr)
        for way in WAYS:
            costs[way].append(message_cost(way))
        for (way, storm), times in answers.items():
            times += answer_times(way, storm)
    rclpy.try_shutdown()
    without = statistics.median(costs[WAYS[0]])
    found: dict[str, Any] = {
        "message_us": {way: 1e6 * (statistics.median(costs[way]) - without) / LISTENERS for way in WAYS[1:]},
        "answer_ms": {
            f"{way}{', storm' if storm else ''}": [1e3 * statistics.quantiles(times, n=100)[at] for at in (49, 98)]
            for (way, storm), times in answers.items()
        },
    }
    if arguments.json:
        print(json.dumps(found))
        return 0
    for way, cost in found["message_us"].items():
        print(f"{way:<40}{cost:8.0f} µs a message")
    for way, (median, late) in found["answer_ms"].items():
        print(f"{way:<40}{median:8.1f} ms to an answer, {late:.1f} ms in one of a hundred")
    return 0


if __name__ == "__main__":
    sys.exit(main())
