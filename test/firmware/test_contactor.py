# SPDX-License-Identifier: Apache-2.0
"""Heartbeat, probe and contactor on the firmware against docs/board-link.md, in simulated time."""

import itertools
import math
import struct
from collections.abc import Callable

import pytest

from deltacharger_core.machine import Port, port_of
from deltacharger_driver.board.protocol import AckError, BoardFault, PacketType, encode_close, probe_problem

from .bench import LIMITS, MS, Bench, S, acks

NewBench = Callable[..., Bench]
CLOSE, PROBE = (PacketType.CONTACTOR, encode_close(LIMITS)), (PacketType.PROBE, b"")


def test_the_heartbeats_deadline_is_exact_to_the_microsecond_whatever_else_the_host_sends(bench: Bench) -> None:
    bench.charge().beat(last=True)
    bench.send((PacketType.START, b""), PROBE, (PacketType.TARE, b""), CLOSE, (PacketType.PING, b"x" * 64))
    bench.run(100 * MS - 1)
    bench.check(contactor=1)
    bench.run(1)
    bench.check(contactor=0, fault=BoardFault.HEARTBEAT_LOST)


def test_a_heartbeat_after_its_deadline_during_a_sampling_is_too_late(bench: Bench) -> None:
    bench.charge().beat(last=True)
    bench.send((PacketType.START, b""))
    bench.run(90 * MS)
    bench.set("scan_time 12000")
    bench.jump(bench.now + 2 * MS)  # a frame is due, and ends 104 ms after the heartbeat
    bench.check(contactor=0)
    bench.beat()
    bench.check(fault=BoardFault.HEARTBEAT_LOST)


@pytest.mark.parametrize("period", [8 * MS, 20 * MS])
def test_a_slow_poll_opens_between_90_and_100_ms(new_bench: NewBench, period: int) -> None:
    """The time between two polls shortens the deadline, so that 100 ms hold at the pins, but never below 90 ms."""
    bench = new_bench(poll_period=period)
    bench.charge().beat(last=True)
    silent = bench.now
    bench.jump(silent + 90 * MS - 1)
    bench.check(contactor=1)
    bench.jump(silent + min(100 * MS, 90 * MS - 1 + period))
    bench.check(contactor=0, fault=BoardFault.HEARTBEAT_LOST)


def test_a_heartbeat_lost_during_precharge_also_opens(bench: Bench) -> None:
    bench.probe()
    bench.set("force output 0")
    bench.beat()
    assert bench.close_contactor() == 0
    bench.run(100 * MS)
    bench.check(precharge=0, fault=BoardFault.HEARTBEAT_LOST)


@pytest.mark.parametrize(("age", "error"), [(2 * S - 1, 0), (2 * S, 3)])
def test_a_probe_allows_a_close_for_two_seconds(bench: Bench, age: int, error: int) -> None:
    bench.send(PROBE)
    bench.run(150 * MS)
    assert len(acks(bench.packets)) == 1
    bench.run(age)
    bench.beat()
    assert bench.close_contactor() == error


@pytest.mark.parametrize("dead", [False, True])
def test_a_close_needs_a_last_probe_that_the_host_would_accept(bench: Bench, dead: bool) -> None:
    allowed = set()
    numbers = (math.nan, math.inf, -2.0, -1.0, -0.9, 0.0, 0.999, 1.0, 24.0, 1e30)
    for ohm, volt in itertools.product(numbers, numbers):
        bench.open()
        bench.set("probe none")
        bench.probe()  # good, and revoked by a bad one
        bench.set(f"probe {ohm} {volt}")
        assert bench.probe().error == 0
        bench.beat()
        good = not probe_problem(ohm, volt, dead)
        assert bench.close_contactor(LIMITS._replace(dead=dead)) == (AckError.DONE if good else AckError.INTERLOCK)
        bench.check(fault=0)
        if good:
            allowed.add(port_of(ohm, volt))
    assert allowed == ({Port.LIVE, Port.OPEN, Port.DEAD} if dead else {Port.LIVE})


def test_a_probe_that_never_ends_is_answered_in_time_and_allows_nothing(bench: Bench) -> None:
    bench.set(f"probe_time {2**32 - 1}")
    bench.send(PROBE)
    assert acks(bench.run(249 * MS)) == []
    (answer,) = acks(bench.run(1 * MS))
    assert answer.error == 0
    assert all(math.isnan(number) for number in struct.unpack("<ff", answer.data))
    bench.check(probe=0)
    bench.beat()
    assert bench.close_contactor() == AckError.INTERLOCK
