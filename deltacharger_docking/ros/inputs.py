# SPDX-License-Identifier: Apache-2.0
"""What docking hears: the latest of each topic as one observation. Part of docking_node."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import numpy as np
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time

from deltacharger_core.machine import CONTACT_FORCE, JOINTS
from deltacharger_docking.observation import Observation, Reply
from deltacharger_ros.on_demand import LatestMessage

_PER_SERVO = ("position", "current", "hardware_error", "torque_enabled", "valid")


class Inputs:
    """The latest of each topic, as one `Observation`.

    Topics are read when an observation is asked for: only the newest counts, and at rest that is seldom asked for.
    """

    def __init__(self, node: Node) -> None:
        self._clock = node.get_clock()
        self._lock = threading.Lock()
        self._servo: ServoState | None = None
        self._servo_time = -math.inf
        self._tactile: TactileFrame | None = None
        self._tactile_time = -math.inf
        self._power: ChargerPower | None = None
        self._power_time = -math.inf
        latest = QoSProfile(depth=1)
        sampled = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._servos = LatestMessage(node, ServoState, "servo_state", latest)
        self._topics = (
            (self._servos, self._on_servo),
            (LatestMessage(node, TactileFrame, "tactile_frame", sampled), self._on_tactile),
            (LatestMessage(node, ChargerPower, "charger_power", latest), self._on_power),
        )

    def wait(self, timeout: float) -> None:
        """Wait for the next servo_state, at most `timeout` s; for the one thread that steps."""
        self._servos.wait(timeout)

    def rest(self) -> None:
        """Let servo_state wake nobody until the next `wait`."""
        self._servos.rest()

    def _age_at_arrival(self, stamp: Any) -> float:
        """Return how long ago (s) the message was measured, so that a stale one is not fresh because it is new."""
        return max((self._clock.now() - Time.from_msg(stamp)).nanoseconds * 1e-9, 0.0)

    def _on_servo(self, message: ServoState) -> None:
        ordered = _in_order(message)
        if ordered is not None and _is_news(message, self._servo):
            if all(ordered.valid):
                self._servo_time = time.monotonic() - self._age_at_arrival(message.header.stamp)
            self._servo = ordered

    def _on_tactile(self, message: TactileFrame) -> None:
        if not _is_news(message, self._tactile):
            return
        self._tactile_time = time.monotonic() - self._age_at_arrival(message.header.stamp)
        self._tactile = message

    def _on_power(self, message: ChargerPower) -> None:
        if not _is_news(message, self._power):
            return
        self._power_time = time.monotonic() - self._age_at_arrival(message.header.stamp)
        self._power = message

    def observation(self, replies: tuple[Reply, ...] = (), contactor_refusal: str = "") -> Observation:
        """Return what is known now; from any thread."""
        with self._lock:
            for topic, receive in self._topics:
                if (message := topic.take()) is not None:
                    receive(message)
            return self._compose(replies, contactor_refusal)

    def _compose(self, replies: tuple[Reply, ...], contactor_refusal: str) -> Observation:
        now = time.monotonic()
        servo, tactile, power = self._servo, self._tactile, self._power
        values: dict[str, Any] = {"time": now, "replies": replies, "contactor_refusal": contactor_refusal}
        if servo is not None:
            reserve = list(servo.thermal_reserve) or [math.inf]
            values.update(
                angles=tuple(servo.position),
                currents=tuple(servo.current),
                servos_valid=all(servo.valid),
                servo_age=now - self._servo_time,
                hardware_error=int(np.bitwise_or.reduce(np.array(servo.hardware_error, dtype=np.uint8))),
                torque_enabled=all(servo.torque_enabled),
                thermal_reserve=min(reserve),
            )
        if tactile is not None:
            values.update(tactile_age=now - self._tactile_time, tactile_contact=_touches(tactile), tared=tactile.tared)
        if power is not None:
            values.update(
                power_age=now - self._power_time,
                contactor_closed=power.contactor_closed,
                charge_current=power.charge_current,
                target_voltage=power.target_voltage,
                power_fault=power.fault,
            )
        return Observation(**values)


def _is_news(message: Any, last: Any) -> bool:
    """Whether a message was measured anew; one that is only repeated must not look fresh, whatever its stamp says."""
    return last is None or message.header.stamp != last.header.stamp


def _in_order(message: ServoState) -> ServoState | None:
    """Return the servos in the order of the limbs; None where something is missing, foreign or impossible."""
    arrays = [getattr(message, name) for name in _PER_SERVO]
    if sorted(message.name) != sorted(JOINTS) or any(len(each) != len(JOINTS) for each in arrays):
        return None
    if any(abs(angle) > math.pi for angle in message.position):
        return None
    if list(message.name) == list(JOINTS):
        return message
    order = [list(message.name).index(name) for name in JOINTS]
    sorted_ = {name: [each[index] for index in order] for name, each in zip(_PER_SERVO, arrays, strict=True)}
    reserve = message.thermal_reserve
    return ServoState(header=message.header, name=list(JOINTS), thermal_reserve=reserve, **sorted_)


def _touches(frame: TactileFrame) -> bool:
    return any(float(np.nanmax(np.asarray(pad), initial=0.0)) >= CONTACT_FORCE for pad in (frame.left, frame.right))
