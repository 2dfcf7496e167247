# SPDX-License-Identifier: Apache-2.0
"""Messages published as bytes equal messages published the usual way."""

from __future__ import annotations

import time
from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from deltacharger.msg import ServoState, TactileFrame
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.time import Time

from deltacharger_core.host_clock import HostClock
from deltacharger_driver.board.tactile_node import SamplePublishers
from deltacharger_driver.servos.servo_node_io import StatePublishers
from deltacharger_ros import flat_messages
from deltacharger_ros.flat_messages import FlatPublisher, Stamps

from ..chargers import Spin, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros

FIELDS = ("position", "voltage", "hardware_error", "valid")
ROWS = (
    array("d", [1.5, float("nan"), -float("inf")]),
    array("f", [12.25, 0.0, 11.5]),
    bytes([0, 32, 255]),
    bytes([True, False, True]),
)


def state() -> ServoState:
    zeros = array("d", [0.0] * 3)
    message = ServoState(name=["a", "bc", "def"], position=zeros, velocity=zeros, current=zeros)
    message.voltage = array("f", [0.0] * 3)
    message.hardware_error, message.valid = array("B", bytes(3)), [False] * 3
    message.header.frame_id = "charger_base"
    return message


class Kept:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.last: Any = None

    def publish(self, message: Any) -> None:
        self.last = message


def published(fields: tuple[str, ...] = FIELDS, rows: tuple[Any, ...] = ROWS, flat: bool = True) -> ServoState:
    kept: Any = Kept()
    publisher = FlatPublisher(kept, state(), fields, Stamps(Clock(clock_type=ClockType.SYSTEM_TIME)))
    assert publisher.is_flat is flat
    publisher.publish(time.monotonic(), *rows)
    assert isinstance(kept.last, bytes) is flat
    return deserialize_message(kept.last, ServoState) if flat else kept.last


def is_as_ordered(message: ServoState) -> bool:
    np.testing.assert_array_equal(message.position, ROWS[0])
    return (
        list(message.voltage) == list(ROWS[1])
        and bytes(message.hardware_error) == ROWS[2]
        and list(message.valid) == [True, False, True]
        and (message.header.frame_id, list(message.name)) == ("charger_base", ["a", "bc", "def"])
        and abs(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 - time.time()) < 5.0
    )


def test_changed_numbers_and_constant_fields_arrive_in_any_order() -> None:
    assert is_as_ordered(published())
    assert is_as_ordered(published(FIELDS[::-1], ROWS[::-1]))


def test_a_message_does_not_affect_the_next() -> None:
    kept: Any = Kept()
    publisher = FlatPublisher(kept, state(), FIELDS, Stamps(Clock(clock_type=ClockType.SYSTEM_TIME)))
    publisher.publish(0.0, array("d", [9.0] * 3), array("f", [9.0] * 3), b"\xff" * 3, b"\1" * 3)
    publisher.publish(time.monotonic(), *ROWS)
    assert is_as_ordered(deserialize_message(kept.last, ServoState))


@pytest.mark.parametrize("spoil", [lambda data: data[::-1], lambda data: bytes(byte ^ 0xA5 for byte in data)])
def test_a_middleware_with_another_format_gets_usual_messages(spoil: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    serialise = flat_messages.serialize_message
    monkeypatch.setattr(flat_messages, "serialize_message", lambda message: spoil(serialise(message)))
    assert is_as_ordered(published(flat=False))


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="different structures"):
        published(rows=(array("d", [1.0] * 4), *ROWS[1:]))


@pytest.fixture
def node(context: Any, namespace: str) -> Iterator[Node]:
    node = Node("subject", **options(context, namespace))
    yield node
    node.destroy_node()


def test_the_drivers_frequent_messages_are_flat(node: Node) -> None:
    states = StatePublishers(node, QoSProfile(depth=1), 1.4, "charger_base")
    samples = SamplePublishers(node, QoSProfile(depth=1), 0.0024, "end_effector")
    publishers = [*vars(states).values(), *vars(samples).values()]
    assert [each.is_flat for each in publishers if isinstance(each, FlatPublisher)] == [True] * 4


@pytest.mark.version
def test_a_subscriber_receives_it(node: Node, spin: Spin) -> None:
    received: list[TactileFrame] = []
    node.create_subscription(TactileFrame, "frame", received.append, 1)
    topic = node.create_publisher(TactileFrame, "frame", 1)
    taxels = array("f", bytes(400))
    prototype = TactileFrame(rows=10, columns=10, pitch=0.0024, left=taxels, right=taxels)
    publisher = FlatPublisher(topic, prototype, ("sequence", "left", "tared"), Stamps(node.get_clock()))
    forces = np.linspace(0.0, 9.0, 100, dtype=np.float32)
    spin(node)
    wait_until(topic.get_subscription_count, "discovery")
    publisher.publish(time.monotonic(), array("Q", [2**40 + 7]), forces, b"\1")
    wait_until(lambda: received, "the frame")
    frame = received[0]
    assert (frame.sequence, frame.tared, frame.rows) == (2**40 + 7, True, 10)
    np.testing.assert_array_equal(frame.left, forces)
    assert not any(frame.right)


@pytest.mark.parametrize("step", [-5.0, 5.0])
def test_stamps_follow_a_step_of_the_computers_clock_at_once(step: float) -> None:
    shown = [1.79e9]  # s, the computer's clock
    stamps = Stamps(Clock(clock_type=ClockType.SYSTEM_TIME), HostClock(lambda: round(1e9 * shown[0]), lambda: 10**11))
    assert stamps.convert(99.99) == (1_789_999_999, 990_000_000)
    shown[0] += step
    assert stamps.convert(99.99) == (1_789_999_999 + step, 990_000_000)


def test_a_clock_that_follows_a_simulator_is_read_for_every_stamp() -> None:
    rate, clock = 0.5, ROSClock()
    stamps = Stamps(clock)
    clock._set_ros_time_is_active(True)
    begun = time.monotonic()
    for passed in (0.0, 0.01, 0.02, 5.0, 4.0):
        clock.set_ros_time_override(Time(nanoseconds=int(1e9 * (100.0 + rate * passed))))
        sec, nanosec = stamps.convert(now := time.monotonic())
        spent = time.monotonic() - now
        assert sec + 1e-9 * nanosec == pytest.approx(100.0 + rate * passed, abs=spent + 1e-3)
    clock.set_ros_time_override(Time(nanoseconds=0))
    assert stamps.convert(begun) == (0, 0), "before the first /clock there is no time"
