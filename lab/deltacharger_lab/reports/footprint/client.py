# SPDX-License-Identifier: Apache-2.0
"""A charger as its client sees it: when it accepts goals, the rates of its topics, its dockings."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from deltacharger.msg import ServoState, TactileFrame
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from deltacharger_ros.client import ChargerClient, ClientError
from deltacharger_ros.messages import seconds
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import Scene

TOPICS = ("tactile_frame", "servo_state")
_POLL = 0.02  # s
_GONE_WITHIN = 30.0  # s until the previous charger has left the graph


class Watcher:
    """A client that runs before the charger starts, and counts its messages.

    Args:
        client: its node listens until it is closed.
    """

    def __init__(self, client: ChargerClient) -> None:
        self._client = client
        self._stamps: dict[str, list[float]] = {name: [] for name in TOPICS}
        kinds = ((TactileFrame, qos_profile_sensor_data), (ServoState, QoSProfile(depth=10)))
        for (name, stamps), (kind, qos) in zip(self._stamps.items(), kinds, strict=True):
            client.node.create_subscription(kind, name, partial(_keep, stamps), qos)

    def is_ready(self, scene: Scene) -> bool:
        """Return whether goals would be accepted now; for a scene without goals, whether all its nodes are there."""
        if "docking_node" in scene.nodes:
            return self._client.is_ready()
        there = {name for name, _ in self._client.node.get_node_names_and_namespaces()}
        return all({name, NODES[name].stands_in_for} & there for name in scene.nodes)

    def count(self) -> Callable[[], dict[str, float]]:
        """Start to count messages; the returned call gives their number per second of their stamps, NaN for too few."""
        begin = {name: len(each) for name, each in self._stamps.items()}
        return lambda: {name: _rate(self._stamps[name][begin[name] :]) for name in TOPICS}

    def is_gone(self) -> bool:
        """Return whether no node serves or publishes a charger's names."""
        node = self._client.node
        return not self._client.answers() and not any(node.count_publishers(name) for name in TOPICS)

    def wait_until_gone(self) -> bool:
        """Wait until the charger has left the graph; False if it does not."""
        deadline = time.monotonic() + _GONE_WITHIN
        while not self.is_gone():
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL)
        return True

    def dock(self, electrodes: Pose | None, deadline: float) -> str:
        """Dock and return why it failed; '' if the robot charges."""
        try:
            outcome = self._client.dock(DockRequest(electrodes), deadline=deadline)
        except ClientError as error:
            return str(error)
        return "" if outcome.success else f"{outcome.error_name}: {outcome.error_message}"


def _keep(stamps: list[float], message: Any) -> None:
    stamps.append(seconds(message.header.stamp))


def _rate(stamps: list[float]) -> float:
    long = len(stamps) > 2 and stamps[-1] > stamps[0]
    return (len(stamps) - 1) / (stamps[-1] - stamps[0]) if long else math.nan
