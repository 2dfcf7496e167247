"""The recorder: listens to a charger's topics during a docking and keeps what the picture shows."""

from __future__ import annotations

import math
import threading
import time
import uuid
from types import TracebackType

import numpy as np
from deltacharger.msg import ChargerPower, DockingState, Misalignment, ServoState, TactileFrame
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import Image

from deltacharger_bringup import qos
from deltacharger_bringup.client import PHASES
from deltacharger_bringup.node_support import Spinner
from deltacharger_bringup.outcomes import Outcome, Progress
from deltacharger_bringup.run_record import Run
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.statics import GRAVITY, TORQUE_CONSTANT

_CONTACT = 1.0  # N on one taxel: what the package calls contact


class Recorder:
    """Fill a `Run` from servo_state, docking_state, tactile_frame, misalignment, charger_power, the detector's
    annotated image and action feedback.

    The contact force is computed here from servo_state (the arm's weight removed), without kinematics_node.

    Args:
        context: a running rclpy context.
        namespace: of the charger.

    Attributes:
        run: what was recorded so far; time 0 is when the recorder began.
    """

    def __init__(self, context: Context, namespace: str = "") -> None:
        self.run = Run()
        self._delta = ScalarDelta()
        self._lock = threading.Lock()
        self._began = time.monotonic()
        self._done = False
        node = Node(
            f"charger_recorder_{uuid.uuid4().hex[:8]}",
            context=context,
            namespace=namespace,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        node.create_subscription(ServoState, "servo_state", self._on_servo_state, qos.LATEST)
        node.create_subscription(DockingState, "docking_state", self._on_docking_state, qos.STATE)
        node.create_subscription(TactileFrame, "tactile_frame", self._on_tactile_frame, qos.SENSOR)
        node.create_subscription(Misalignment, "misalignment", self._on_misalignment, qos.DEFAULT_DEPTH)
        node.create_subscription(ChargerPower, "charger_power", self._on_power, qos.LATEST)
        node.create_subscription(Image, "electrode_detection/image", self._on_image, qos.SENSOR)
        self._spinner: Spinner | None = Spinner(node, 2)

    def close(self) -> None:
        """Stop listening. Safe to call twice."""
        if self._spinner is not None:
            self._spinner.close()
            self._spinner = None

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def force(self) -> float:
        """Return the newest contact force along z on the target (N); NaN = not measured."""
        with self._lock:
            return self.run.motion.last("force")

    def on_progress(self, progress: Progress) -> None:
        """Take one feedback message of the action."""
        now = self._now()
        with self._lock:
            self.run.contact.add(now, progress.contact_current)
            self._enter(now, progress.phase)
            if not math.isnan(progress.horizontal):
                self.run.decided.add(now, progress.horizontal, progress.vertical, progress.angle)

    def finish(self, outcome: Outcome) -> None:
        """Note how it ended and record no more."""
        with self._lock:
            self.run.outcome = outcome
            self._done = True

    def _now(self) -> float:
        return time.monotonic() - self._began

    def _enter(self, now: float, phase: str) -> None:
        if not self._done and (not self.run.phases or self.run.phases[-1][1] != phase):
            self.run.phases.append((now, phase))

    def _on_servo_state(self, message: ServoState) -> None:
        if self._done or len(message.position) != 3:
            return
        now = self._now()
        position = self._delta.forward(*message.position)
        force = current = math.nan
        if math.isfinite(position[2]) and len(message.current) == 3:
            held = self._delta.holding_torque(*position, GRAVITY)
            spare = [TORQUE_CONSTANT * current - hold for current, hold in zip(message.current, held, strict=True)]
            force = self._delta.force(*position, (spare[0], spare[1], spare[2]))[2]
            lever = self._delta.jacobian(*position)[6:9]  # dz/dangle of each servo
            current = force * sum(lever) / 3.0 / TORQUE_CONSTANT
        with self._lock:
            self.run.motion.add(now, position[2], force, current)

    def _on_docking_state(self, message: DockingState) -> None:
        with self._lock:
            self._enter(self._now(), PHASES.get(message.state, f"state {message.state}"))

    def _on_tactile_frame(self, message: TactileFrame) -> None:
        if self._done or not message.tared or message.rows * message.columns != len(message.left):
            return
        shape = (message.rows, message.columns)
        left = np.array(message.left, dtype=np.float64).reshape(shape)
        right = np.array(message.right, dtype=np.float64).reshape(shape)
        if np.isnan(left).all() or np.isnan(right).all() or max(np.nanmax(left), np.nanmax(right)) < _CONTACT:
            return
        with self._lock:
            self.run.frames = (left, right)

    def _on_misalignment(self, message: Misalignment) -> None:
        if self._done:
            return
        values = (message.horizontal, message.vertical, message.angle) if message.contact else (math.nan,) * 3
        with self._lock:
            self.run.felt.add(self._now(), *values)

    def _on_power(self, message: ChargerPower) -> None:
        if self._done:
            return
        with self._lock:
            self.run.power.add(self._now(), message.charge_current, float(message.contactor_closed))

    def _on_image(self, message: Image) -> None:
        from deltacharger_vision.ros_images import color_array

        seen = color_array(message.encoding, message.height, message.width, message.step, message.data)
        with self._lock:
            self.run.seen = seen
