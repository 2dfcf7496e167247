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
        latest = QoSProfile(depth=1)
        sampled = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._topics = {
            ServoState: LatestMessage(node, ServoState, "servo_state", latest),
            TactileFrame: LatestMessage(node, TactileFrame, "tactile_frame", sampled),
            ChargerPower: LatestMessage(node, ChargerPower, "charger_power", latest),
        }
        self._heard: dict[type[Any], Any] = {}  # the latest of each
        self._measured = dict.fromkeys(self._topics, -math.inf)  # and when, s

    def wait(self, timeout: float) -> None:
        """Wait for the next servo_state, at most `timeout` s; for the one thread that steps."""
        self._topics[ServoState].wait(timeout)

    def rest(self) -> None:
        """Let servo_state wake nobody until the next `wait`."""
        self._topics[ServoState].rest()

    def observation(self, replies: tuple[Reply, ...] = (), contactor_refusal: str = "") -> Observation:
        """Return what is known now; from any thread."""
        with self._lock:
            for kind, topic in self._topics.items():
                if (message := topic.take()) is not None:
                    self._hear(kind, message)
            return self._compose(replies, contactor_refusal)

    def _hear(self, kind: type[Any], message: Any) -> None:
        """Keep what was measured anew, by when that was: stale data are not fresh because they came or came again."""
        known = self._heard.get(kind)
        if kind is ServoState:
            message = _in_order(message)
        if message is None or (known is not None and message.header.stamp == known.header.stamp):
            return
        if kind is not ServoState or all(message.valid):
            age = (self._clock.now() - Time.from_msg(message.header.stamp)).nanoseconds * 1e-9
            self._measured[kind] = time.monotonic() - max(age, 0.0)
        self._heard[kind] = message

    def _compose(self, replies: tuple[Reply, ...], contactor_refusal: str) -> Observation:
        now = time.monotonic()
        servo, tactile, power = (self._heard.get(kind) for kind in self._topics)
        values: dict[str, Any] = {"time": now, "replies": replies, "contactor_refusal": contactor_refusal}
        ages = (now - measured for measured in self._measured.values())
        values.update(zip(("servo_age", "tactile_age", "power_age"), ages, strict=True))
        if servo is not None:
            reserve = list(servo.thermal_reserve) or [math.inf]
            values.update(
                angles=tuple(servo.position),
                currents=tuple(servo.current),
                servos_valid=all(servo.valid),
                hardware_error=int(np.bitwise_or.reduce(np.array(servo.hardware_error, dtype=np.uint8))),
                torque_enabled=all(servo.torque_enabled),
                thermal_reserve=min(reserve),
            )
        if tactile is not None:
            values.update(tactile_contact=_touches(tactile), tared=tactile.tared)
        if power is not None:
            values.update(
                contactor_closed=power.contactor_closed,
                charge_current=power.charge_current,
                target_voltage=power.target_voltage,
                power_fault=power.fault,
            )
        return Observation(**values)


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
