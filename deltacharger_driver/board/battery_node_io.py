# SPDX-License-Identifier: Apache-2.0
"""What tactile_node tells of both batteries in the standard form: battery and target_battery."""

from __future__ import annotations

import math
import time

from rclpy.node import Node
from sensor_msgs.msg import BatteryState

from deltacharger_core.frames import CHARGER_BASE, END_EFFECTOR, FrameParameters
from deltacharger_core.machine import ZERO_CURRENT
from deltacharger_driver.board.samples import PowerSample
from deltacharger_ros.flat_messages import Stamps
from deltacharger_ros.qos import LATEST

PERIOD = 1.0
"""s between two messages of a battery."""
_PRESENT = 6.0  # V, either way; a probe puts 5 V at most across what is no battery
_FIELDS = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage")


class BatteryPublishers:
    """Publishes what the power stage measures of its own battery and of the target's; the rest is unknown, NaN.

    Args:
        node: the publisher.
        frames: how the charger's frames are named.
    """

    def __init__(self, node: Node, frames: FrameParameters) -> None:
        self._stamps = Stamps(node.get_clock())
        self._told = [
            (node.create_publisher(BatteryState, topic, LATEST), read, frames.named(frame))
            for topic, read, frame in (
                ("battery", own_battery, CHARGER_BASE),
                ("target_battery", target_battery, END_EFFECTOR),
            )
        ]

    def publish(self, sample: PowerSample | None) -> None:
        """Publish both; None = nothing is known now."""
        stamp = self._stamps.convert(time.monotonic() if sample is None else sample.time)
        for publisher, read, frame in self._told:
            message = read(sample)
            message.header.frame_id = frame
            message.header.stamp.sec, message.header.stamp.nanosec = stamp
            publisher.publish(message)


def own_battery(sample: PowerSample | None) -> BatteryState:
    """Return the charger's battery, of which the current (A) alone is not measured: it feeds servos and computer, too.

    That it discharges is known while it charges a target. Whether the robot is being charged itself is not.
    """
    message = _battery("charger", math.nan if sample is None else sample.power.battery_voltage)
    if message.present and sample is not None and sample.power.charge_current >= ZERO_CURRENT:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return message


def target_battery(sample: PowerSample | None) -> BatteryState:
    """Return the target's battery as the charge circuit sees it: V and A into it while docked, else nothing.

    The voltage is that between the electrodes: while current flows, the battery's own and what its wires take.
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
    """Return what a current (A, positive into the battery) makes of it."""
    if current >= ZERO_CURRENT:
        return int(BatteryState.POWER_SUPPLY_STATUS_CHARGING)
    if current <= -ZERO_CURRENT:
        return int(BatteryState.POWER_SUPPLY_STATUS_DISCHARGING)
    return int(BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING)


def _battery(location: str, voltage: float) -> BatteryState:
    """Return a battery of which nothing but the voltage (V) is known."""
    message = BatteryState(location=location, **dict.fromkeys(_FIELDS, math.nan))
    message.voltage = voltage
    message.present = abs(voltage) >= _PRESENT
    return message
