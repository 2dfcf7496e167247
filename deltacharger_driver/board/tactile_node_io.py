# SPDX-License-Identifier: Apache-2.0
"""ROS interface of tactile_node: tactile_frame and charger_power from samples, limits from a request."""

from __future__ import annotations

from array import array

from deltacharger.msg import ChargerPower, TactileFrame
from deltacharger.srv import SetContactor
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from deltacharger_core.charge_port import ChargeLimits
from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_driver.board.samples import PowerSample, TactileSample
from deltacharger_ros.clock import Stamps


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
        pitch: distance between neighbouring taxels, m.
        frame_id: full name of end_effector.
    """

    def __init__(self, node: Node, qos: QoSProfile, pitch: float, frame_id: str) -> None:
        self._stamps = Stamps(node.get_clock())
        self._frame = TactileFrame(rows=ROWS, columns=COLUMNS, pitch=pitch)
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
