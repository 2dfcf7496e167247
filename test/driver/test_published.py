# SPDX-License-Identifier: Apache-2.0
"""What the driver publishes is what it measured, field by field and message by message; batteries too."""

import math
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import BatteryState

from deltacharger_core.ros.messages import seconds
from deltacharger_driver.board import protocol, tactile_node
from deltacharger_driver.servos import bus, servo_node

pytestmark = [pytest.mark.ros, pytest.mark.version]


class Kept:
    """A node that keeps what is published, as its subscribers receive it."""

    def __init__(self) -> None:
        self.received: dict[str, list[Any]] = {}

    def get_clock(self) -> Clock:
        return Clock(clock_type=ClockType.SYSTEM_TIME)

    def create_publisher(self, kind: Any, name: str, qos: Any) -> Any:
        received = self.received.setdefault(name, [])
        return SimpleNamespace(
            publish=lambda message: received.append(deserialize_message(serialize_message(message), kind)),
            get_subscription_count=lambda: 1,
        )


def assert_same(message: Any, expected: Any, names: tuple[str, ...]) -> None:
    for name in names:
        np.testing.assert_array_equal(getattr(message, name), np.float32(getattr(expected, name)), name)


@pytest.fixture
def node() -> Any:
    return Kept()


def report(first: float) -> bus.ServoReport:
    numbers = np.arange(first, first + 30.0).astype(np.float32).reshape(10, 3)
    rows = [tuple(map(float, row)) for row in numbers[:6]]
    small = [tuple(map(int, row)) for row in numbers[6:8]]
    flags = (True, False, first > 0.0)
    found = bus.ServoReport(time.monotonic(), flags[::-1], *rows[:5], small[0], flags)  # type: ignore[arg-type]
    return found._replace(thermal_reserve=rows[5], stray=small[1])


def test_servo_state_and_joint_states_show_each_report(node: Any) -> None:
    publishers = servo_node.StatePublishers(node, QoSProfile(depth=1), "charger_base", "left_")
    unknown = report(5.0)._replace(angle=(math.nan, 0.0, 0.0))
    for each in (report(0.0), report(90.0), unknown):
        publishers.publish(each, 2.0)
        state = node.received["servo_state"][-1]
        assert state.header.frame_id == "charger_base"
        assert abs(seconds(state.header.stamp) - time.time()) < 5.0
        assert_same(state, each, ("velocity", "current", "voltage", "temperature", "thermal_reserve"))
        assert_same(state, each, ("hardware_error", "torque_enabled", "valid", "stray"))
        np.testing.assert_array_equal(state.position, each.angle)
    assert len(node.received["joint_states"]) == 2, "without all angles there is none"
    joint, shown = node.received["joint_states"][-1], report(90.0)
    assert (joint.name[0], list(joint.position)) == ("left_limb_0_arm_joint", list(shown.angle))
    assert list(joint.velocity) == list(shown.velocity)
    assert list(joint.effort) == [2.0 * current for current in shown.current]


def test_tactile_frame_and_charger_power_show_each_sample(node: Any) -> None:
    publishers = tactile_node.SamplePublishers(node, QoSProfile(depth=1), "end_effector")
    for number, tared in ((7, True), (2**40, False)):
        pads = np.arange(number % 97, number % 97 + 200, dtype=np.float32).reshape(2, 10, 10)
        pads[1, 3, 4] = math.nan
        sample = protocol.TactileSample(time.monotonic(), number, number + 1, pads, tared, overrun=False)
        publishers.frame(sample)
        frame = node.received["tactile_frame"][-1]
        assert (frame.rows, frame.columns, frame.header.frame_id) == (10, 10, "end_effector")
        assert (frame.sequence, frame.device_time_us, frame.tared) == (number, number + 1, tared)
        np.testing.assert_array_equal([frame.left, frame.right], pads.reshape(2, 100))
        power = protocol.Power(25.0, 24.0, math.nan, tared, 7 if tared else 0, -0.5)
        publishers.power(protocol.PowerSample(time.monotonic(), power), 470.0, math.inf, (not tared, 29.5))
        message = node.received["charger_power"][-1]
        assert_same(
            message, power, ("battery_voltage", "target_voltage", "charge_current", "contactor_closed", "fault")
        )
        assert (message.charge_current_least, message.probe_resistance, message.probe_age) == (-0.5, 470.0, math.inf)
        assert (message.stage_steps_up, message.stage_voltage) == (not tared, 29.5)


UNKNOWN = BatteryState.POWER_SUPPLY_STATUS_UNKNOWN
CHARGING = BatteryState.POWER_SUPPLY_STATUS_CHARGING
DISCHARGING = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
NOT_CHARGING = BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING
NAN = math.nan


def sample(
    battery: float = 26.0, target: float = 24.0, current: float = 0.0, closed: bool = False
) -> protocol.PowerSample:
    return protocol.PowerSample(1.0, protocol.Power(battery, target, current, closed, 0))


@pytest.mark.parametrize(
    ("power", "own", "target"),
    [
        (None, UNKNOWN, UNKNOWN),
        (sample(), UNKNOWN, NOT_CHARGING),
        (sample(current=10.0, closed=True), DISCHARGING, CHARGING),
        (sample(current=0.2, closed=True), UNKNOWN, NOT_CHARGING),
        (sample(current=-3.0, closed=True), UNKNOWN, DISCHARGING),
        (sample(current=NAN, closed=True), UNKNOWN, UNKNOWN),
        (sample(battery=NAN, current=10.0, closed=True), UNKNOWN, CHARGING),
    ],
)
def test_the_status_follows_the_measured_current(power: protocol.PowerSample | None, own: int, target: int) -> None:
    assert tactile_node.own_battery(power).power_supply_status == own
    assert tactile_node.target_battery(power).power_supply_status == target


def test_unmeasured_values_are_unknown() -> None:
    power = sample(current=10.0, closed=True)
    for battery in (tactile_node.own_battery(power), tactile_node.target_battery(power)):
        for name in ("temperature", "charge", "capacity", "design_capacity", "percentage"):
            assert math.isnan(getattr(battery, name)), name
        assert battery.power_supply_health == battery.power_supply_technology == UNKNOWN
    assert math.isnan(tactile_node.own_battery(power).current), "it feeds servos and computer, too"
