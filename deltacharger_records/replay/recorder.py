# SPDX-License-Identifier: Apache-2.0
"""Record a charger's topics during a docking for the picture."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from deltacharger.msg import ChargerPower, DockingDecision, DockingState, Misalignment, ServoState, TactileFrame
from rclpy.context import Context
from sensor_msgs.msg import Image

from deltacharger_records.node_parameters import ParameterReader, known_settings
from deltacharger_records.replay.run_builder import RunBuilder
from deltacharger_records.replay.run_record import Run
from deltacharger_ros import qos
from deltacharger_ros.clock import steady_timer
from deltacharger_ros.guest import Guest
from deltacharger_ros.outcomes import Outcome, Progress

_ASK = 0.1  # s between attempts to read docking_node's parameters
_PATIENCE = 3.0  # s to wait for them


class Recorder(Guest):
    """Fill a `Run` from servo_state, docking_state, docking_decision, tactile_frame, misalignment, charger_power, the
    detector's annotated image and action feedback.

    Positions and forces use docking_node's own geometry and gravity, read at the beginning.

    Args:
        context: a running rclpy context.
        namespace: of the charger.

    Attributes:
        run: recorded so far; time 0 is the recorder's start.
    """

    def __init__(self, context: Context, namespace: str = "") -> None:
        super().__init__("charger_recorder", context, namespace)
        self.run = Run()
        self._build = RunBuilder(self.run, None)
        self._lock = threading.Lock()
        self._began = time.monotonic()
        self._done = False
        node, build = self.node, self._build
        node.create_subscription(ServoState, "servo_state", self._taker(build.servo_state), qos.LATEST)
        node.create_subscription(DockingState, "docking_state", self._taker(build.docking_state), qos.STATE)
        node.create_subscription(DockingDecision, "docking_decision", self._taker(build.decision), qos.DEFAULT_DEPTH)
        node.create_subscription(TactileFrame, "tactile_frame", self._taker(build.tactile_frame), qos.SENSOR)
        node.create_subscription(Misalignment, "misalignment", self._taker(build.misalignment), qos.DEFAULT_DEPTH)
        node.create_subscription(ChargerPower, "charger_power", self._taker(build.power), qos.LATEST)
        node.create_subscription(Image, "electrode_detection/image", self._on_image, qos.SENSOR)
        self._parameters = ParameterReader(node, "docking_node")
        self._asking = steady_timer(node, _ASK, self._ask)
        self.serve()

    def force(self) -> float:
        """Return the newest contact force along z on the target (N); NaN = not measured."""
        with self._lock:
            return self.run.motion.last("force")

    def on_progress(self, progress: Progress) -> None:
        """Take one feedback message of the action."""
        now = self._now()
        with self._lock:
            self.run.contact.add(now, progress.contact_current)
            if not self._done:
                self._build.enter(now, progress.phase)
            if not math.isnan(progress.horizontal):
                self.run.decided.add(now, progress.horizontal, progress.vertical, progress.angle)

    def finish(self, outcome: Outcome) -> None:
        """Store the outcome and stop recording."""
        with self._lock:
            self.run.outcome = outcome
            self._done = True

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
            self._build.settings = self._build.settings or settings

    def _now(self) -> float:
        return time.monotonic() - self._began

    def _taker(self, take: Callable[[float, Any], None]) -> Callable[[Any], None]:
        """Return a callback that passes messages to `take` until the end."""

        def on_message(message: Any) -> None:
            if not self._done:
                now = self._now()
                with self._lock:
                    take(now, message)

        return on_message

    def _on_image(self, message: Image) -> None:
        from deltacharger_vision.cameras.ros_images import color_array

        seen = color_array(message)
        with self._lock:
            self.run.seen = seen
