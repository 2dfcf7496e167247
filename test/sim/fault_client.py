# SPDX-License-Identifier: Apache-2.0
"""A client that observes and commands the drivers of a charger under test, as docking_node and operator do."""

from __future__ import annotations

import math
import threading
import time
from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from deltacharger.srv import Probe, SetContactor
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..chargers import wait_until
from ..nodes import options

JOINTS = ("limb_0_arm_joint", "limb_1_arm_joint", "limb_2_arm_joint")
PATIENCE = 10.0  # s; far longer than any fault-free operation
_RENEWAL = 0.1  # s between renewals of the lease, as docking_node's
_LEASE = Duration(nanosec=250_000_000)
_FLOATS = ("position", "velocity", "current", "voltage", "temperature")


class FaultClient(Node):
    """Keeps the latest message of each topic, and renews a lease on the contactor in any case.

    Attributes:
        servo, frame, power: the latest messages; None before the first.
        received: number of messages received, by attribute.
        untrue: readings that are physically impossible and should have been NaN.
        statuses: of this charger's /diagnostics, with the time of arrival (s, monotonic).
    """

    def __init__(self, context: Context, namespace: str) -> None:
        super().__init__("fault_client", **options(context, namespace))
        self.servo: Any = None
        self.frame: Any = None
        self.power: Any = None
        self.received = {"servo": 0, "frame": 0, "power": 0}
        self.untrue: list[str] = []
        self.unknown_at: dict[int, float] = {}
        self.statuses: list[tuple[float, DiagnosticStatus]] = []
        latest = QoSProfile(depth=1)
        self.create_subscription(ServoState, "servo_state", self._on_servo, latest)
        self.create_subscription(TactileFrame, "tactile_frame", self._on_frame, qos_profile_sensor_data)
        self.create_subscription(ChargerPower, "charger_power", self._on_power, latest)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._trajectories = self.create_publisher(JointTrajectory, "joint_trajectory", latest)
        self.asked: dict[str, Any] = {
            "set_torque": self.create_client(SetBool, "set_torque"),
            "reboot_servos": self.create_client(Trigger, "reboot_servos"),
            "tare": self.create_client(Trigger, "tare"),
            "probe": self.create_client(Probe, "probe"),
            "set_contactor": self.create_client(SetContactor, "set_contactor"),
        }
        self._wanted = threading.Event()
        self._over = threading.Event()
        self._renewing = threading.Thread(target=self._renew, name="lease", daemon=True)
        self._renewing.start()

    def close(self) -> None:
        self._over.set()
        self._renewing.join()

    def is_connected(self) -> bool:
        ready = all(service.service_is_ready() for service in self.asked.values())
        count = None not in (self.servo, self.frame, self.power)
        return ready and count and bool(self._trajectories.get_subscription_count())

    def call(self, name: str, **fields: Any) -> Any:
        """Call a service and return its response."""
        service = self.asked[name]
        future = service.call_async(service.srv_type.Request(**fields))
        wait_until(future.done, f"an answer from {name}", PATIENCE)
        return future.result()

    def send(self, points: Sequence[tuple[float, Sequence[float]]], effort: float = math.nan) -> None:
        """Send (s, angles in rad) with the same torque bound (N·m) for every servo; NaN = none."""
        message = JointTrajectory(joint_names=list(JOINTS))
        bounds = [] if math.isnan(effort) else [effort] * 3
        for seconds, angles in points:
            point = JointTrajectoryPoint(positions=array("d", angles), effort=array("d", bounds))
            point.time_from_start = Duration(sec=int(seconds), nanosec=int(seconds % 1 * 1e9))
            message.points.append(point)
        self._trajectories.publish(message)

    def keep_closed(self) -> Any:
        """Close the contactor, and renew the lease from now on, even if it is refused."""
        answer = self.call("set_contactor", close=True, holder="fault_client", lease=_LEASE)
        if answer.success:
            self._wanted.set()
        return answer

    def stop_renewing(self) -> None:
        """Stop renewing the lease."""
        self._wanted.clear()

    def has_warned(self, part: str, words: Sequence[str], since: float) -> bool:
        """Whether `part` has published a warning with these words after `since`."""
        return any(
            when > since
            and status.name.endswith(part)
            and status.level > DiagnosticStatus.OK
            and all(word in status.message for word in words)
            for when, status in list(self.statuses)
        )

    def count(self, part: str, key: str) -> int:
        """Return the latest value of a counter of `part`; 0 if it was not published."""
        for _, status in reversed(list(self.statuses)):
            if status.name.endswith(part):
                return next((int(value.value) for value in status.values if value.key == key), 0)
        return 0

    def has_released_servos(self, since: float) -> bool:
        """Whether servo_node reported after `since` that it has released the servos, regardless of their own state."""
        states = [
            value.value
            for when, status in list(self.statuses)
            if when > since and status.name.endswith("servo bus")
            for value in status.values
            if value.key == "state"
        ]
        return bool(states) and states[-1] in ("torque off", "disconnected")

    def messages(self, since: float) -> list[str]:
        """Return the diagnostics after `since`, for the message of a failure."""
        messages = [(status.name, status.message) for when, status in list(self.statuses) if when > since]
        return [f"{name}: {message}" for name, message in dict.fromkeys(messages)]

    def _renew(self) -> None:
        service = self.asked["set_contactor"]
        request = SetContactor.Request(close=True, holder="fault_client", lease=_LEASE)
        while not self._over.wait(_RENEWAL):
            if self._wanted.is_set() and self.context.ok():
                service.call_async(request)

    def _on_servo(self, message: ServoState) -> None:
        columns = [getattr(message, name) for name in _FLOATS]
        for index, row in enumerate(zip(*columns, strict=True)):
            unknown = [math.isnan(value) for value in row]
            if all(unknown) and not message.valid[index]:
                self.unknown_at[index + 1] = time.monotonic()
            if any(unknown) and not (all(unknown) and not message.valid[index]):
                self.untrue.append(f"servo {index + 1}: {row}, valid {message.valid[index]}")
            if not any(unknown) and not (5.0 < row[3] < 16.0 and 20.0 < row[4] < 80.0 and abs(row[0]) < 1.5):
                self.untrue.append(f"servo {index + 1}: {row}")
        self.servo = message
        self.received["servo"] += 1

    def _on_frame(self, message: TactileFrame) -> None:
        if len(message.left) != 100 or len(message.right) != 100 or min(message.left) < 0.0:
            self.untrue.append(f"frame {message.sequence}")
        self.frame = message
        self.received["frame"] += 1

    def _on_power(self, message: ChargerPower) -> None:
        if not 22.0 < message.battery_voltage < 30.0:
            self.untrue.append(f"battery {message.battery_voltage} V")
        self.power = message
        self.received["power"] += 1

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        own = f"{self.get_namespace()}/".lstrip("/")
        self.statuses += [(now, status) for status in message.status if status.name.startswith(own)]

    def taxels(self) -> np.ndarray:
        """Return the 200 taxels of the latest frame, left first, N."""
        return np.concatenate((self.frame.left, self.frame.right))
