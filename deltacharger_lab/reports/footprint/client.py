# SPDX-License-Identifier: Apache-2.0
"""What a charger looks like to whoever uses it: when it takes goals, how often its topics come, how it docks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

from deltacharger.msg import ServoState, TactileFrame
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from deltacharger_ros.client import ChargerClient, ClientError
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import Scene

TOPICS = ("tactile_frame", "servo_state")
_POLL = 0.02  # s
_GONE_WITHIN = 30.0  # s until the charger before has left the graph


class Watcher:
    """A client that is there before the charger, and counts what it publishes.

    Args:
        client: whose node listens.
    """

    def __init__(self, client: ChargerClient) -> None:
        self._client = client
        self._stamps: dict[str, list[float]] = {name: [] for name in TOPICS}
        self._subscriptions: list[Any] = []

    def __enter__(self) -> Watcher:
        kinds = ((TactileFrame, qos_profile_sensor_data), (ServoState, QoSProfile(depth=10)))
        for name, (kind, qos) in zip(TOPICS, kinds, strict=True):
            take = self._taker(self._stamps[name])
            self._subscriptions.append(self._client.node.create_subscription(kind, name, take, qos))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for subscription in self._subscriptions:
            self._client.node.destroy_subscription(subscription)

    @staticmethod
    def _taker(stamps: list[float]) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)

        return take

    def is_ready(self, scene: Scene) -> bool:
        """Return whether goals would be taken now; of a scene without goals, whether all its nodes are there."""
        if "docking_node" in scene.nodes:
            return self._client.is_ready()
        there = {name for name, _ in self._client.node.get_node_names_and_namespaces()}
        return all({name, NODES[name].stands_in_for} & there for name in scene.nodes)

    def count(self) -> Counting:
        """Begin to count messages."""
        return Counting(self._stamps)

    def is_gone(self) -> bool:
        """Return whether nobody serves or publishes what a charger would."""
        node = self._client.node
        return not self._client.answers() and not any(node.count_publishers(name) for name in TOPICS)

    def wait_until_gone(self) -> bool:
        """Wait until the charger has left the graph; False where it does not."""
        deadline = time.monotonic() + _GONE_WITHIN
        while not self.is_gone():
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL)
        return True

    def dock(self, electrodes: Pose | None, deadline: float) -> Outcome | str:
        """Dock and return the outcome, or why there is none."""
        try:
            return self._client.dock(DockRequest(electrodes), deadline=deadline)
        except ClientError as error:
            return str(error)


class Counting:
    """Messages from an instant on."""

    def __init__(self, stamps: dict[str, list[float]]) -> None:
        self._stamps = stamps
        self._begin = {name: len(each) for name, each in stamps.items()}

    def rates(self) -> dict[str, float]:
        """Return messages per second of their own stamps by topic since the beginning; NaN where too few came."""
        found = {}
        for name, begin in self._begin.items():
            stamps = self._stamps[name][begin:]
            long = len(stamps) > 2 and stamps[-1] > stamps[0]
            found[name] = (len(stamps) - 1) / (stamps[-1] - stamps[0]) if long else math.nan
        return found
