"""What tactile_node says to ROS: tactile_frame and charger_power from samples. No message is built anew."""

from __future__ import annotations

import time
from array import array
from typing import Any

from deltacharger.msg import ChargerPower, TactileFrame
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from deltacharger_driver.board_protocol import COLUMNS, ROWS
from deltacharger_driver.board_samples import PowerSample, TactileSample

_FRAME = "end_effector"


class SamplePublishers:
    """Publishes from one thread, the link's reader.

    Args:
        node: the publisher.
        qos: of charger_power.
        pitch: distance between neighbouring taxels, m.
    """

    def __init__(self, node: Node, qos: QoSProfile, pitch: float) -> None:
        self._clock = node.get_clock()
        self._frames = node.create_publisher(TactileFrame, "tactile_frame", qos_profile_sensor_data)
        self._powers = node.create_publisher(ChargerPower, "charger_power", qos)
        self._frame = TactileFrame(rows=ROWS, columns=COLUMNS, pitch=pitch)
        self._power = ChargerPower()
        self._frame.header.frame_id = self._power.header.frame_id = _FRAME

    def frame(self, sample: TactileSample) -> None:
        """Publish a tactile frame."""
        message = self._frame
        self._stamp(message.header.stamp, sample.time)
        message.sequence = sample.sequence
        message.device_time_us = sample.device_time_us
        message.left = array("f", sample.left.tobytes())
        message.right = array("f", sample.right.tobytes())
        message.tared = sample.tared
        self._frames.publish(message)

    def power(self, sample: PowerSample, probe_resistance: float, probe_age: float) -> None:
        """Publish the power stage with the last probe's ohm (NaN = none) and age in s (inf = none that counts)."""
        message, power = self._power, sample.power
        self._stamp(message.header.stamp, sample.time)
        message.contactor_closed = power.contactor_closed
        message.battery_voltage = power.battery_voltage
        message.target_voltage = power.target_voltage
        message.charge_current = power.charge_current
        message.probe_resistance = probe_resistance
        message.probe_age = probe_age
        message.fault = power.fault
        self._powers.publish(message)

    def _stamp(self, stamp: Any, instant: float) -> None:
        """Translate a monotonic instant (s) to the node's clock."""
        nanoseconds = self._clock.now().nanoseconds - int((time.monotonic() - instant) * 1e9)
        stamp.sec, stamp.nanosec = divmod(max(nanoseconds, 0), 1_000_000_000)
