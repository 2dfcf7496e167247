# SPDX-License-Identifier: Apache-2.0
"""A charger of mocks whose docking_node receives its topics through a relay that distorts them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from deltacharger.msg import ChargerPower, DockingState, ServoState, TactileFrame
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

from deltacharger_docking.ros.docking_node import DockingNode
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.executor import Spinner
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose, Progress
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, dock_at_last, new_namespace, wait_until
from ..nodes import options

PLACE = Pose(0.0, 0.0, 0.080)
TOPICS: dict[str, tuple[Any, Any]] = {
    "servo_state": (ServoState, QoSProfile(depth=1)),
    "tactile_frame": (TactileFrame, qos_profile_sensor_data),
    "charger_power": (ChargerPower, QoSProfile(depth=1)),
}
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
Distortion = Callable[[Any], Any]


class Relay(Node):
    """Publishes the mocks' messages under `heard/`, distorted by `distort[topic]`; None = no message."""

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("relay", **options(context, namespace))
        self.distort: dict[str, Distortion] = {}
        for topic, (kind, qos) in TOPICS.items():
            publisher = self.create_publisher(kind, f"heard/{topic}", qos)
            self.create_subscription(kind, topic, self._passer(topic, publisher), qos)

    def _passer(self, topic: str, publisher: Any) -> Callable[[Any], None]:
        def hand_on(message: Any) -> None:
            distort = self.distort.get(topic)
            sent = message if distort is None else distort(message)
            if sent is not None:
                publisher.publish(sent)

        return hand_on


class Hostile:
    """Mocks, the relay, docking_node behind it, and a client.

    Attributes:
        states: of docking_state, all so far.
    """

    def __init__(self, scene: Scene, context: Any, **parameters: Any) -> None:
        self.namespace, self.context = new_namespace(), context
        others = tuple(name for name in scene.nodes if name != "docking_node")
        self._mocks = Composition(replace(scene, nodes=others), context, self.namespace).start()
        self.relay = Relay(context, self.namespace)
        self._spinners = [Spinner(self.relay)]
        given = scene.node_parameters("docking_node", {}) | parameters
        words = [word for topic in TOPICS for word in ("-r", f"{topic}:=heard/{topic}")]
        self.docking = DockingNode(cli_args=["--ros-args", *words], **options(context, self.namespace, **given))
        self._spinners.append(Spinner(self.docking))
        self.client = ChargerClient(self.namespace, context)
        self.states: list[DockingState] = []
        self.client.node.create_subscription(DockingState, "docking_state", self.states.append, LATCHED)
        assert self.client.wait_until_ready(DEADLINE)
        wait_until(lambda: self.states, "docking_state")

    @property
    def servos(self) -> Any:
        return self._mocks.node("mock_servo_node")

    @property
    def pads(self) -> Any:
        return self._mocks.node("mock_tactile_node")

    @property
    def is_closed(self) -> bool:
        return bool(self.pads.contactor_closed)

    @property
    def code(self) -> int:
        return int(self.states[-1].error_code)

    def nodes(self) -> list[Node]:
        """Return all nodes of the charger."""
        return [*(running.node for running in self._mocks.nodes), self.docking, self.relay]

    def is_idle(self) -> bool:
        return bool(self.states[-1].state == DockingState.STATE_IDLE)

    def dock(self, on_progress: Callable[[Progress], None] | None = None, **request: Any) -> Outcome:
        return self.client.dock(DockRequest(PLACE, **request), on_progress, deadline=DEADLINE)

    def charge(self) -> None:
        dock_at_last(self.client, DockRequest(PLACE))
        assert self.is_closed

    def opens_after(self) -> float:
        """Return how long (s) the contactor stays closed from now on."""
        start = time.monotonic()
        wait_until(lambda: not self.is_closed, "an open contactor")
        return time.monotonic() - start

    def heal(self) -> None:
        """End all distortions, wait until running goals have ended, and bring everything back to rest."""
        self.relay.distort.clear()
        self.servos.reboot()
        wait_until(lambda: self.client.undock(deadline=DEADLINE).success, "the arm back home")

    def close(self) -> None:
        for spinner in reversed(self._spinners):
            spinner.close()
        self.client.close()
        self._mocks.close()


class Defects:
    """Collects what docking_node logs as its own defects."""

    def __init__(self, hostile: Hostile) -> None:
        self.texts: list[str] = []
        self._lock = threading.Lock()
        logger = hostile.docking.get_logger()
        error = logger.error

        def note(text: str, *words: Any, **options: Any) -> Any:
            with self._lock:
                self.texts.append(text)
            return error(text, *words, **options)

        logger.error = note  # type: ignore[method-assign]
        hostile.docking.get_logger = lambda: logger  # type: ignore[method-assign]
