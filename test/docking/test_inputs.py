# SPDX-License-Identifier: Apache-2.0
"""What docking takes for new, from given clocks: a wrong message counts as missing, and no clock makes old data fresh.

Ages decide in the machine: test_machine_faults. Here no node runs; test_docking_node has one wrong message on a topic.
An estimate must come from frames that were sampled after the request, each once, half of them received by docking.
"""

import math
from array import array
from collections.abc import Callable
from typing import Any

import pytest
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from rclpy.clock import ROSClock
from rclpy.duration import Duration
from rclpy.time import Time

from deltacharger_core import machine, real_time
from deltacharger_docking import clearance, observation
from deltacharger_docking.ros.inputs import FrameCheck, Heard

NAN, INF = math.nan, math.inf
TICK = 0.01  # s
TOPICS = {ServoState: "servo", TactileFrame: "tactile", ChargerPower: "power"}
COLUMNS = [name for name in ServoState.get_fields_and_field_types() if name != "header"]
Distortion = Callable[[Any], Any]


class Bench:
    """Three publishers and docking's ear, on clocks that the test moves.

    Args:
        stamps: s.
        simulated: whether stamps show /clock; else the computer's clock.

    Attributes:
        stamps: s, the clock of all stamps; follows the test's time at `rate`.
        distort: what happens to messages of a class; None as its answer = no message.
    """

    def __init__(self, stamps: float = 1000.0, simulated: bool = True) -> None:
        self.stamps, self.rate, self._now = stamps, 1.0, 50.0
        self.distort: dict[type[Any], Distortion] = {}
        self._clock = ROSClock()
        self._clock._set_ros_time_is_active(simulated)
        self.heard = Heard(
            self._clock, real_time.HostClock(lambda: round(1e9 * self.stamps), lambda: round(1e9 * self._now))
        )
        self._sequence = 0

    def run(self, seconds: float) -> observation.Observation:
        """Let time pass, with a message of each topic in every tick; return the last observation."""
        for _ in range(round(seconds / TICK)):
            self._now += TICK
            self.stamps += self.rate * TICK
            self._clock.set_ros_time_override(Time(nanoseconds=round(1e9 * self.stamps)))
            self._sequence += 1
            for kind in TOPICS:
                message = self.distort.get(kind, lambda message: message)(self._message(kind))
                if message is None:
                    continue
                self.heard.hear(message)
            seen = self.heard.observation()
        return seen

    def _message(self, kind: type[Any]) -> Any:
        if kind is ServoState:
            message = ServoState(name=list(machine.JOINTS), position=[0.1, 0.2, 0.3], current=[0.4, 0.5, 0.6])
            message.velocity, message.hardware_error = [0.0] * 3, [0] * 3
            message.torque_enabled, message.valid = [True] * 3, [True] * 3
            message.thermal_reserve, message.stray = [INF] * 3, [0] * 3
        elif kind is TactileFrame:
            message = TactileFrame(rows=10, columns=10, left=[0.0] * 99 + [9.0], right=[0.0] * 100, tared=True)
            message.sequence = self._sequence
        else:
            message = ChargerPower(contactor_closed=True, charge_current=8.0, target_voltage=24.0, battery_voltage=26.0)
        message.header.stamp = Time(nanoseconds=round(1e9 * self.stamps)).to_msg()
        return message


def age(seen: observation.Observation, kind: type[Any]) -> float:
    """Return the age of the newest message of a class, s."""
    return float(getattr(seen, f"{TOPICS[kind]}_age"))


def put(**fields: Any) -> Distortion:
    """Set fields of a message; lists of numbers become arrays."""

    def distort(message: Any) -> Any:
        for name, value in fields.items():
            kept = getattr(message, name)
            setattr(message, name, array(kept.typecode, value) if isinstance(kept, array) else value)
        return message

    return distort


def rows(*indices: int, names: list[str] = COLUMNS) -> Distortion:
    """Leave these servos in these fields, in this order."""

    def distort(message: Any) -> Any:
        for name in names:
            kept = getattr(message, name)
            if len(kept):
                row = [kept[index] for index in indices]
                setattr(message, name, array(kept.typecode, row) if isinstance(kept, array) else row)
        return message

    return distort


def stamped(by: float = 0.0, **fixed: int) -> Distortion:
    """Shift a stamp by seconds, or fix its fields."""

    def distort(message: Any) -> Any:
        stamp = message.header.stamp
        message.header.stamp = (Time.from_msg(stamp) + Duration(seconds=by)).to_msg()
        for name, value in fixed.items():
            setattr(message.header.stamp, name, value)
        return message

    return distort


STAMPS: dict[str, Distortion] = {
    "before 1970": stamped(sec=-5),
    "four seconds of nanoseconds": stamped(nanosec=4_000_000_000),
    "ahead": stamped(1.0),
    "backwards": stamped(-1.0),
}
WRONG: dict[type[Any], dict[str, Distortion]] = {
    ServoState: {
        "two positions": rows(0, 1, names=["position"]),
        "no currents": rows(names=["current"]),
        "other names": put(name=["a", "b", "c"]),
        "another order": put(name=list(machine.JOINTS[::-1])),
        "endless angles": put(position=[INF, 0.0, 0.0]),
        "not valid": put(valid=[True, False, True]),
    },
    TactileFrame: {
        "no taxels": put(left=[], right=[]),
        "another shape": put(rows=255, columns=255),
        "endless taxels": put(left=[INF] * 100),
    },
    ChargerPower: {},
}
CASES = [
    pytest.param(kind, distort, id=f"{TOPICS[kind]}: {name}")
    for kind, own in WRONG.items()
    for name, distort in (own | STAMPS).items()
]


@pytest.mark.parametrize(("kind", "distort"), CASES)
def test_a_wrong_message_counts_as_missing_and_affects_no_right_one(kind: type[Any], distort: Distortion) -> None:
    bench = Bench()
    good = bench.run(0.1)
    bench.distort[kind] = distort
    seen = bench.run(0.5)
    assert age(seen, kind) == pytest.approx(0.5, abs=0.02)
    assert all(age(seen, other) < 0.02 for other in TOPICS if other is not kind)
    assert seen.angles == good.angles
    assert seen.servos_valid is (distort is not WRONG[ServoState]["not valid"])
    assert bench.heard.refused >= 50 or not seen.servos_valid
    turns = iter(range(1000))
    bench.distort[kind] = lambda message: distort(message) if next(turns) % 2 else message
    assert all(age(bench.run(TICK), kind) < 0.03 for _ in range(20)), "every second one is right"


def test_values_are_handed_on_as_measured() -> None:
    bench = Bench()
    seen = bench.run(0.1)
    assert (seen.angles, seen.currents) == ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
    assert all((seen.servos_valid, seen.torque_enabled, seen.tactile_contact, seen.tared, seen.contactor_closed))
    assert (seen.charge_current, seen.target_voltage, seen.battery_voltage) == (8.0, 24.0, 26.0)
    bench.distort = {
        ServoState: put(current=[NAN] * 3, hardware_error=[0, 32, 4], thermal_reserve=[INF, NAN, 60.0]),
        TactileFrame: put(left=[NAN] * 100, right=[NAN] * 100, tared=False),
        ChargerPower: put(charge_current=NAN, battery_voltage=NAN, fault=200),
    }
    seen = bench.run(TICK)
    assert all(map(math.isnan, (*seen.currents, seen.thermal_reserve, seen.charge_current, seen.battery_voltage)))
    assert (seen.hardware_error, seen.power_fault) == (36, 200)
    assert (seen.tactile_contact, seen.tared) == (False, False)


@pytest.mark.parametrize("kind", TOPICS)
def test_a_repeated_message_never_counts_as_new(kind: type[Any]) -> None:
    bench = Bench()
    kept: list[Any] = []
    bench.distort[kind] = lambda message: (kept.append(message), kept[0])[1]
    assert age(bench.run(1.0), kind) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("jump", [-60.0, -1.0, 1.0, 60.0])
def test_after_a_jump_of_the_clock_old_and_new_are_told_apart_as_before(jump: float) -> None:
    bench = Bench(stamps=10_000.0)
    bench.run(0.5)
    bench.stamps += jump
    seen = bench.run(0.1)
    assert max(age(seen, kind) for kind in TOPICS) < 0.03
    assert ("went back" in seen.clock_problem) == (jump < 0.0)
    for kind in TOPICS:
        bench.distort[kind] = lambda message: None
    seen = bench.run(0.4)
    assert min(age(seen, kind) for kind in TOPICS) == pytest.approx(0.4, abs=0.02)


@pytest.mark.parametrize("step", [-3600.0, -0.2, 0.2, 3600.0])
def test_a_step_of_the_computers_clock_makes_no_message_old_or_fresh_and_is_told(step: float) -> None:
    bench = Bench(stamps=1.79e9, simulated=False)
    bench.run(0.5)
    bench.stamps += step
    bench.distort = dict.fromkeys(TOPICS, stamped(-step - 0.005))  # stamped before the step and received after it
    seen = bench.run(TICK)
    assert max(age(seen, kind) for kind in TOPICS) < TICK + 1e-3
    bench.distort = {}
    assert all(age(bench.run(TICK), kind) < 1e-3 for kind in TOPICS)
    assert not bench.heard.refused
    assert f"set {'forward' if step > 0.0 else 'back'} by {abs(step):.1f} s" in seen.clock_problem
    bench.distort = dict.fromkeys(TOPICS, lambda message: None)
    assert min(age(bench.run(0.4), kind) for kind in TOPICS) == pytest.approx(0.4, abs=0.02)
    assert not bench.run(10.0).clock_problem


@pytest.mark.parametrize("begins", [0.0, 1000.0], ids=["no time yet", "stopped"])
def test_while_the_clock_stands_still_nothing_is_new(begins: float) -> None:
    bench = Bench(stamps=begins)
    if begins:
        bench.run(0.5)
    bench.rate = 0.0
    seen = bench.run(0.5)
    assert min(age(seen, kind) for kind in TOPICS) >= 0.45
    assert "/clock" in seen.clock_problem
    bench.rate = 1.0
    seen = bench.run(0.1)
    assert max(age(seen, kind) for kind in TOPICS) < 0.03


PERIOD = 1.0 / 120.0  # s
ASKED = 100.0  # s
BEFORE = range(1000, 1120)  # sampled in the second before it
AFTER = range(1120, 1144)
FELT = clearance.MisalignmentEstimate(0.0, 0.01, 0.0, 1e-4, 0.0, 1e-4)


def frame_check(after: range = AFTER, before: range = BEFORE, every: int = 1) -> FrameCheck:
    """One that received a second of frames before ASKED, and every n-th frame after it."""
    found = FrameCheck()
    for frame in before:
        found.add(frame, ASKED - 0.15 - (before.stop - frame) * PERIOD)  # the arm has rested at least this long
    for frame in after[::every]:
        found.add(frame, ASKED + (frame - after.start) * PERIOD)
    return found


def is_believed(found: FrameCheck, *named: int) -> bool:
    reply = found.checked(observation.Reply(7, True, estimate=FELT, sequences=named, asked=ASKED))
    assert reply.number == 7
    assert reply.success == (reply.estimate is not None)
    assert reply.success or "not confirmed" in reply.message
    return reply.success


def test_frames_after_the_request_are_accepted_even_if_half_of_them_were_lost() -> None:
    assert is_believed(frame_check(), *AFTER)
    assert is_believed(frame_check(every=2), *AFTER)
    assert not is_believed(frame_check(every=3), *AFTER)


@pytest.mark.parametrize(
    ("named", "why"),
    [
        ((), "none"),
        (tuple(reversed(AFTER)), "backwards"),
        ((1119, *AFTER[1:]), "one from before"),
        (tuple(range(5000, 5024)), "never received"),
        ((*AFTER[:11], *range(5000, 5013)), "less than half received"),
    ],
)
def test_an_estimate_without_matching_frames_is_refused(named: tuple[int, ...], why: str) -> None:
    assert not is_believed(frame_check(), *named), why
