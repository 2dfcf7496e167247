# SPDX-License-Identifier: Apache-2.0
"""Topics battery and target_battery of tactile_node, as sensor_msgs/BatteryState."""

from __future__ import annotations

import math
import time

from rclpy.node import Node
from sensor_msgs.msg import BatteryState

from deltacharger_core.frames import CHARGER_BASE, END_EFFECTOR, FrameParameters
from deltacharger_core.machine import ZERO_CURRENT
from deltacharger_driver.board.samples import PowerSample
from deltacharger_ros.clock import Stamps
from deltacharger_ros.qos import LATEST

PERIOD = 1.0
"""Period of the messages, s."""
_PRESENT = 6.0  # V, either polarity; without a battery the probe causes 5 V at most
_FIELDS = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage")


class BatteryPublishers:
    """Publishes the power stage's measurements of both batteries; unknown fields are NaN.

    Args:
        node: the publisher.
        frames: names of the charger's frames.
    """

    def __init__(self, node: Node, frames: FrameParameters) -> None:
        self._stamps = Stamps(node.get_clock())
        self._publishers = [
            (node.create_publisher(BatteryState, topic, LATEST), read, frames.named(frame))
            for topic, read, frame in (
                ("battery", own_battery, CHARGER_BASE),
                ("target_battery", target_battery, END_EFFECTOR),
            )
        ]

    def publish(self, sample: PowerSample | None) -> None:
        """Publish both; None = no fresh sample."""
        stamp = self._stamps.at(time.monotonic() if sample is None else sample.time)
        for publisher, read, frame in self._publishers:
            message = read(sample)
            message.header.frame_id = frame
            message.header.stamp = stamp
            publisher.publish(message)


def own_battery(sample: PowerSample | None) -> BatteryState:
    """Return the charger's battery. Its current (A) is unknown: servos and computer draw from it too.

    It discharges while it charges a target. Otherwise its state is unknown: the robot may itself be on a charger.
    """
    message = _battery("charger", math.nan if sample is None else sample.power.battery_voltage)
    if message.present and sample is not None and sample.power.charge_current >= ZERO_CURRENT:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return message


def target_battery(sample: PowerSample | None) -> BatteryState:
    """Return the target's battery: V and A into it while docked, else NaN.

    The voltage is measured at the electrodes: while current flows, it includes the drop of the target's wires.
    """
    if sample is None:
        return _battery("target", math.nan)
    power = sample.power
    message = _battery("target", power.target_voltage)
    if message.present and math.isfinite(power.charge_current):
        message.current = power.charge_current
        message.power_supply_status = _status(power.charge_current)
    return message


def _status(current: float) -> int:
    """Return the charging status for a current, A, positive into the battery."""
    if current >= ZERO_CURRENT:
        return int(BatteryState.POWER_SUPPLY_STATUS_CHARGING)
    if current <= -ZERO_CURRENT:
        return int(BatteryState.POWER_SUPPLY_STATUS_DISCHARGING)
    return int(BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING)


def _battery(location: str, voltage: float) -> BatteryState:
    """Return a battery message with only the voltage (V) known."""
    message = BatteryState(location=location, **dict.fromkeys(_FIELDS, math.nan))
    message.voltage = voltage
    message.present = abs(voltage) >= _PRESENT
    return message
