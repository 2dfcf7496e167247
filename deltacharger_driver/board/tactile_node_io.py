# SPDX-License-Identifier: Apache-2.0
"""ROS interface of tactile_node: frames, power stage and batteries from samples, limits from a request."""

from __future__ import annotations

import math
import time
from array import array

from deltacharger.msg import ChargerPower, TactileFrame
from deltacharger.srv import SetContactor
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState

from deltacharger_core.frames import CHARGER_BASE, END_EFFECTOR, FrameParameters
from deltacharger_core.machine import COLUMNS, ROWS, ZERO_CURRENT, ChargeLimits
from deltacharger_driver.board.protocol import PowerSample, TactileSample
from deltacharger_ros.clock import Stamps
from deltacharger_ros.qos import LATEST

BATTERY_PERIOD = 1.0
"""s between two messages of the batteries."""
_PITCH = 0.0024  # m between neighbouring taxels
_PRESENT = 6.0  # V, either polarity; without a battery the probe causes 5 V at most
_FIELDS = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage")


def limits_of(request: SetContactor.Request) -> ChargeLimits:
    """Return the limits that a request to close gives; all 0 in an old client's."""
    return ChargeLimits(
        request.current_max, request.voltage_max, request.dead_port, request.start_time, request.gap_time
    )


class SamplePublishers:
    """Publishes from the link's reader thread only.

    Args:
        node: the publisher.
        qos: of charger_power.
        frame_id: full name of end_effector.
    """

    def __init__(self, node: Node, qos: QoSProfile, frame_id: str) -> None:
        self._stamps = Stamps(node.get_clock())
        self._frame = TactileFrame(rows=ROWS, columns=COLUMNS, pitch=_PITCH)
        self._power = ChargerPower()
        self._frame.header.frame_id = self._power.header.frame_id = frame_id
        self._frames = node.create_publisher(TactileFrame, "tactile_frame", qos_profile_sensor_data)
        self._powers = node.create_publisher(ChargerPower, "charger_power", qos)

    def frame(self, sample: TactileSample) -> None:
        """Publish a tactile frame."""
        message = self._frame
        message.header.stamp = self._stamps.at(sample.time)
        message.sequence, message.device_time_us, message.tared = sample.sequence, sample.device_time_us, sample.tared
        # rclpy would check each of the taxels of a numpy array
        message.left, message.right = (array("f", pad.tobytes()) for pad in sample.pads)
        self._frames.publish(message)

    def power(self, sample: PowerSample, probe_resistance: float, probe_age: float, stage: tuple[bool, float]) -> None:
        """Publish the power stage with the last probe's ohm (NaN = none) and age in s (inf = none or void).

        `stage` is its `steps_up` and `stage_voltage` (V) as in `Hello`.
        """
        message, power = self._power, sample.power
        message.header.stamp = self._stamps.at(sample.time)
        message.contactor_closed, message.fault = power.contactor_closed, power.fault
        message.battery_voltage, message.target_voltage = power.battery_voltage, power.target_voltage
        message.charge_current, message.charge_current_least = power.charge_current, power.least_current
        message.probe_resistance, message.probe_age = probe_resistance, probe_age
        message.stage_steps_up, message.stage_voltage = stage
        self._powers.publish(message)


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
