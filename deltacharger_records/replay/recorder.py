# SPDX-License-Identifier: Apache-2.0
"""Record a charger's topics during a docking for the picture."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.context import Context
from sensor_msgs.msg import Image

from deltacharger_records.node_parameters import ParameterReader, known_settings
from deltacharger_records.recording.mcap_recording import TOPICS
from deltacharger_records.replay.run import Run, RunBuilder
from deltacharger_ros import qos
from deltacharger_ros.client import Guest
from deltacharger_ros.clock import steady_timer
from deltacharger_ros.outcomes import Outcome

_ASK = 0.1  # s between attempts to read docking_node's parameters
_PATIENCE = 3.0  # s to wait for them
_AT_REST = 1.0  # s for docking_state to follow the result


class Recorder(Guest):
    """Fill a `Run` from a running charger's topics and the detector's annotated image.

    Positions and forces use docking_node's own geometry and gravity, read at the beginning.

    Args:
        context: a running rclpy context.
        namespace: of the charger.

    Attributes:
        run: recorded so far; time 0 is the recorder's start until `finish`.
    """

    def __init__(self, context: Context, namespace: str = "") -> None:
        super().__init__("charger_recorder", context, namespace)
        self.run = Run()
        self._build = RunBuilder(self.run)
        self._lock = threading.Lock()
        self._began = time.monotonic()
        self._asked = self._done = False
        for topic in TOPICS:
            if topic.name in self._build.takers:
                self.node.create_subscription(topic.kind, topic.name, self._taker(topic.name), topic.qos)
        self.node.create_subscription(Image, "electrode_detection/image", self._on_image, qos.SENSOR)
        self._parameters = ParameterReader(self.node, "docking_node")
        self._asking = steady_timer(self.node, _ASK, self._ask)
        self.serve()

    def force(self) -> float:
        """Return the newest contact force along z on the target (N); NaN = not measured."""
        with self._lock:
            return self.run.motion.last("force")

    def finish(self, outcome: Outcome) -> None:
        """Store the outcome and stop recording, once docking_state tells that the docking is over."""
        self.wait(lambda: outcome.success or self._build.is_at_rest, _AT_REST)
        with self._lock:
            self._done = True
            self.run.results.append(outcome)
            self._build.complete()

    def _ask(self) -> None:
        """Read docking_node's parameters once available; without an answer, use the defaults."""
        if self._now() > _PATIENCE:
            self._asking.cancel()
            self._on_parameters({})
        elif self._parameters.is_ready():
            self._parameters.ask(self._on_parameters)

    def _on_parameters(self, values: dict[str, Any]) -> None:
        self._asking.cancel()
        try:
            settings = known_settings(values)
        except ValueError:  # of another version
            settings = known_settings({})
        with self._lock:
            if not self._asked:
                self._build.use(*settings)
            self._asked = True

    def _now(self) -> float:
        return time.monotonic() - self._began

    def _taker(self, topic: str) -> Callable[[Any], None]:
        """Return a callback that records the messages of a topic until the end."""

        def on_message(message: Any) -> None:
            now = self._now()
            with self._lock:
                if not self._done:
                    self._build.take(topic, now, message)

        return on_message

    def _on_image(self, message: Image) -> None:
        from deltacharger_vision.cameras.ros_formats import color_array

        seen = color_array(message)
        with self._lock:
            self.run.seen = seen
