# SPDX-License-Identifier: Apache-2.0
"""Malformed messages: docking_node survives, opens the contactor, names the problem, and docks again afterwards.

They reach only docking_node; the mocks receive undistorted messages. A malformed message counts as missing: the age
grows, and the codes are those of a silent node.
"""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.msg import ServoState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_ros.messages import CODES
from deltacharger_scenes.scene import Scene

from ..chargers import wait_until
from ..marks import rest
from .hostile import Defects, Distortion, Hostile

pytestmark = pytest.mark.ros

NAN, INF = math.nan, math.inf
SERVO, PADS, POWER = "servo_state", "tactile_frame", "charger_power"
OPENS = 0.35 + 0.65  # s: the limit, plus margins for a busy computer and the longer limits in the mocks' scene
COLUMNS = [name for name in ServoState.get_fields_and_field_types() if name != "header"]


def put(**fields: Any) -> Distortion:
    """Return a function that sets fields of a message; lists of numbers become arrays."""

    def distort(message: Any) -> Any:
        for name, value in fields.items():
            kept = getattr(message, name)
            setattr(message, name, array(kept.typecode, value) if isinstance(kept, array) else value)
        return message

    return distort


def cut(length: int, *names: str) -> Distortion:
    """Return a function that cuts these fields, or all sequences of a ServoState, to a length."""

    def distort(message: Any) -> Any:
        for name in names or COLUMNS:
            setattr(message, name, getattr(message, name)[:length])
        return message

    return distort


def reorder(message: ServoState) -> ServoState:
    """Return the same servos in another order."""
    for name in COLUMNS:
        kept = getattr(message, name)
        row = [kept[index] for index in (2, 0, 1)]
        setattr(message, name, array(kept.typecode, row) if isinstance(kept, array) else row)
    return message


@pytest.fixture(scope="module")
def shared(quick_scene: Scene, context: Any) -> Iterator[Hostile]:
    hostile = Hostile(quick_scene, context)
    yield hostile
    hostile.close()


@pytest.fixture
def hostile(shared: Hostile) -> Iterator[Hostile]:
    """Every test begins with a charger that has undocked: this shows recovery."""
    shared.heal()
    yield shared
    shared.relay.distort.clear()


WRONG_SERVOS: dict[str, Distortion] = {
    "two positions": cut(2, "position"),
    "no currents": cut(0, "current"),
    "nothing at all": cut(0),
    "no validity": cut(0, "valid"),
    "no torque values": cut(0, "torque_enabled"),
    "four of each": lambda message: put(**{name: [*getattr(message, name)][:1] * 4 for name in COLUMNS})(message),
    "other names": put(name=["a", "b", "c"]),
    "one name twice": put(name=["limb_0_arm_joint", "limb_0_arm_joint", "limb_2_arm_joint"]),
    "NaN angles": put(position=[NAN] * 3),
    "endless angles": put(position=[INF, 0.0, 0.0]),
    "impossible angles": put(position=[1e308, 0.0, 0.0]),
    "NaN currents": put(current=[NAN] * 3),
    "endless currents": put(current=[INF, 0.0, 0.0]),
    "huge currents": put(current=[1e308] * 3),
}
WRONG_POWER: dict[str, Distortion] = {
    "NaN current": put(charge_current=NAN),
    "all NaN": put(charge_current=NAN, target_voltage=NAN, battery_voltage=NAN, probe_age=NAN, probe_resistance=NAN),
    "endless current": put(charge_current=INF),
    "unknown fault": put(fault=200),
}
WRONG_PADS: dict[str, Distortion] = {
    "not tared": put(tared=False),
    "no taxels": put(left=[], right=[]),
    "three taxels": put(left=[9.0] * 3, right=[]),
    "NaN taxels": put(left=[NAN] * 100, right=[NAN] * 100),
    "another shape": put(rows=255, columns=255),
}


def test_an_idle_charger_tolerates_every_message_and_then_docks(hostile: Hostile) -> None:
    defects = Defects(hostile)
    for topic, table in ((SERVO, WRONG_SERVOS), (POWER, WRONG_POWER), (PADS, WRONG_PADS)):
        for distortion in table.values():
            hostile.relay.distort[topic] = distortion
            time.sleep(0.05)
        hostile.relay.distort.clear()
    assert defects.texts == []
    hostile.charge()


@pytest.mark.parametrize(("part", "does"), [("_machine", "step"), rest("_inputs", "observation")])
def test_an_internal_defect_opens_the_contactor_and_ends_with_a_code(
    hostile: Hostile, part: str, does: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Defects in its observations or in its decisions, at each call."""

    def fail(*words: Any) -> Any:
        raise RuntimeError("a defect")

    hostile.charge()
    with monkeypatch.context() as patch:
        patch.setattr(getattr(hostile.docking, part), does, fail)
        assert hostile.opens_after() < OPENS
        wait_until(lambda: not hostile.servos.torque_enabled, "no torque")
    hostile.heal()
    with monkeypatch.context() as patch:
        outcome = hostile.dock(lambda progress: patch.setattr(getattr(hostile.docking, part), does, fail))
        assert (outcome.error_name, outcome.success) == ("INTERNAL", False)
        wait_until(lambda: not hostile.servos.torque_enabled, "no torque")


def assert_ends_safely(hostile: Hostile, codes: set[str]) -> None:
    wait_until(lambda: hostile.code, "a code")
    assert CODES[hostile.code] in codes, hostile.states[-1].error_message
    assert hostile.states[-1].error_message
    wait_until(hostile.is_idle, "the way back or the stop")
    wait_until(lambda: not hostile.servos.torque_enabled, "no torque")
    assert not hostile.is_closed


@pytest.mark.parametrize("name", ["no currents", "impossible angles", rest("no torque values"), rest("other names")])
def test_invalid_servo_states_end_charging(hostile: Hostile, name: str) -> None:
    hostile.charge()
    hostile.relay.distort[SERVO] = WRONG_SERVOS[name]
    assert hostile.opens_after() < OPENS
    assert_ends_safely(hostile, {"SERVO_FAULT"})


@pytest.mark.parametrize("name", ["all NaN", rest("endless current"), rest("unknown fault")])
def test_invalid_power_messages_end_charging(hostile: Hostile, name: str) -> None:
    """A current that is reported for ever keeps the arm where it is, with its torque, until the report ends."""
    hostile.charge()
    hostile.relay.distort[POWER] = WRONG_POWER[name]
    assert hostile.opens_after() < OPENS
    wait_until(lambda: hostile.code, "a code")
    assert CODES[hostile.code] in {"POWER_STALE", "OVERCURRENT", "CONTACTOR_WELDED"}


@pytest.mark.parametrize("name", ["NaN taxels", rest("no taxels")])
def test_invalid_tactile_frames_never_dock(hostile: Hostile, name: str) -> None:
    """misalignment_node and the mock of tactile_node receive the true frames: this tests docking's own check."""
    hostile.relay.distort[PADS] = WRONG_PADS[name]
    outcome = hostile.dock()
    assert outcome.error_name in ("NO_TACTILE_CONTACT", "TACTILE_STALE"), outcome
    assert not hostile.is_closed


def test_servos_in_another_order_are_sorted_or_refused_but_never_confused(hostile: Hostile) -> None:
    """Judged by the arm's motion: confused limbs would carry it sideways."""
    hostile.servos._arm.angles[0] += 0.05  # no two limbs alike, so that a mistake shows
    hostile.relay.distort[SERVO] = reorder
    furthest = [0.0]

    def look(progress: Any) -> None:
        x, y, _ = hostile.servos.position
        furthest[0] = max(furthest[0], math.hypot(x, y))

    outcome = hostile.dock(look)
    assert outcome.success or outcome.error_name == "SERVO_FAULT", outcome
    assert furthest[0] < 0.02


@pytest.mark.parametrize("topic", [SERVO, rest(PADS), rest(POWER)])
def test_a_repeated_message_never_counts_as_new_even_from_the_future(hostile: Hostile, topic: str) -> None:
    """A publisher that hangs and repeats itself, stamped by a clock that was an hour ahead."""
    hostile.charge()
    kept: list[Any] = []

    def repeat(message: Any) -> Any:
        if not kept:
            message.header.stamp.sec += 3600
            kept.append(message)
        return kept[0]

    hostile.relay.distort[topic] = repeat
    if topic == PADS:
        time.sleep(2.0)  # charging continues by the estimates of misalignment_node; touch matters only on the way
        assert hostile.client.undock(deadline=60.0).success
        hostile.relay.distort[topic] = repeat
        assert hostile.dock().error_name == "TACTILE_STALE"
        return
    hostile.opens_after()
    wait_until(lambda: hostile.code, "a code")
    assert CODES[hostile.code] in {SERVO: {"SERVO_FAULT"}, POWER: {"POWER_STALE", "CONTACTOR_WELDED"}}[topic]


@pytest.mark.parametrize("seconds", [-3600, rest(3600), rest(1), rest(-(2**31))])
def test_servos_stamped_by_another_clock_never_dock(hostile: Hostile, seconds: int) -> None:
    """Data an hour old are stale; data with a future stamp may be; a zero stamp is invalid."""

    def shift(message: Any) -> Any:
        message.header.stamp.sec = max(message.header.stamp.sec + seconds, -(2**31))
        return message

    hostile.relay.distort[SERVO] = shift
    assert hostile.dock().error_name == "SERVO_FAULT"
    assert not hostile.is_closed


def stamped(seconds: int, nanoseconds: int) -> Distortion:
    def distort(message: Any) -> Any:
        message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
        return message

    return distort


def ahead(message: Any) -> Any:
    message.header.stamp.sec += 1
    return message


def backwards(message: Any) -> Any:
    message.header.stamp.sec -= 1
    return message


def swollen(message: Any) -> Any:
    message.header.frame_id = "x" * 100_000
    message.header.stamp.sec = -1
    return message


REFUSED = (
    stamped(-5, 0),
    stamped(-(2**31), 2**32 - 1),
    stamped(2**31 - 1, 2**32 - 1),
    stamped(5, 4_000_000_000),
    ahead,
    backwards,
    swollen,
)


@pytest.mark.parametrize(
    ("topic", "malformed"),
    [(SERVO, cut(2, "position")), rest(PADS, cut(3, "left")), rest(POWER, swollen)],
)
def test_refused_messages_are_counted_and_do_not_affect_valid_ones(
    hostile: Hostile, topic: str, malformed: Distortion
) -> None:
    """Every second message of a topic is wrong while the charger docks and charges: both continue."""
    defects, refused = Defects(hostile), hostile.docking._inputs.refused
    before, turns = refused.count, [0]
    wrong = (*REFUSED, malformed)

    def alternate(message: Any) -> Any:
        turns[0] += 1
        return wrong[turns[0] // 2 % len(wrong)](message) if turns[0] % 2 else message

    hostile.relay.distort[topic] = alternate
    hostile.charge()
    wait_until(lambda: refused.count - before > 3 * len(wrong), "a count")
    assert hostile.is_closed
    assert refused.last.startswith(topic)
    assert defects.texts == []


@pytest.mark.rest
def test_a_trajectory_with_an_invalid_stamp_ends_no_node(hostile: Hostile) -> None:
    publisher = hostile.client.node.create_publisher(JointTrajectory, "joint_trajectory", 1)
    wait_until(lambda: publisher.get_subscription_count() == 1, "the mock of servo_node")
    wrong = JointTrajectory(joint_names=list(JOINTS), points=[JointTrajectoryPoint(positions=[0.5] * 3)])
    publisher.publish(stamped(-5, 0)(wrong))
    assert publisher.wait_for_all_acked()
    hostile.client.node.destroy_publisher(publisher)
    wait_until(lambda: not hostile.states[-1].duplicate_sources, "no second source")
    hostile.charge()
