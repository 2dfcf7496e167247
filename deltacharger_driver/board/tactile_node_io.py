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
from deltacharger_ros.flat_messages import FlatPublisher, Stamps

_FRAME_FIELDS = ("sequence", "device_time_us", "left", "right", "tared")
_POWER_FIELDS = (
    "contactor_closed",
    "battery_voltage",
    "target_voltage",
    "charge_current",
    "probe_resistance",
    "probe_age",
    "fault",
    "charge_current_least",
    "stage_steps_up",
    "stage_voltage",
)


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
        stamps = Stamps(node.get_clock())
        taxels = array("f", bytes(4 * ROWS * COLUMNS))
        frame = TactileFrame(rows=ROWS, columns=COLUMNS, pitch=pitch, left=taxels, right=taxels)
        power = ChargerPower()
        frame.header.frame_id = power.header.frame_id = frame_id
        frames = node.create_publisher(TactileFrame, "tactile_frame", qos_profile_sensor_data)
        powers = node.create_publisher(ChargerPower, "charger_power", qos)
        self._frames = FlatPublisher(frames, frame, _FRAME_FIELDS, stamps)
        self._powers = FlatPublisher(powers, power, _POWER_FIELDS, stamps)

    def frame(self, sample: TactileSample) -> None:
        """Publish a tactile frame."""
        self._frames.publish(
            sample.time,
            array("Q", (sample.sequence,)),
            array("Q", (sample.device_time_us,)),
            *sample.pads.reshape(2, -1),
            bytes((sample.tared,)),
        )

    def power(self, sample: PowerSample, probe_resistance: float, probe_age: float, stage: tuple[bool, float]) -> None:
        """Publish the power stage with the last probe's ohm (NaN = none) and age in s (inf = none or void).

        `stage` is its `steps_up` and `stage_voltage` (V) as in `Hello`.
        """
        power = sample.power
        measured = (power.battery_voltage, power.target_voltage, power.charge_current, probe_resistance, probe_age)
        self._powers.publish(
            sample.time,
            bytes((power.contactor_closed,)),
            *(array("f", (value,)) for value in measured),
            bytes((power.fault,)),
            array("f", (power.least_current,)),
            bytes(stage[:1]),
            array("f", stage[1:]),
        )
