# SPDX-License-Identifier: Apache-2.0
"""Sampling, device time and a slow wire, in simulated time."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest

from deltacharger_driver.board.protocol import FLAG_OVERRUN, PacketType, decode_hello
from deltacharger_driver.packets import Packet

from ..marks import night
from .bench import MS, Bench, S, acks, tactile

NewBench = Callable[..., Bench]
START = (PacketType.START, b"")


def set_rate(bench: Bench, rate: float) -> None:
    assert bench.ask(PacketType.RATE, struct.pack("<f", rate)).error == 0


def instants(packets: list[Packet]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.array([packet.device_time_us for packet in tactile(packets)])


def overruns(frames: list[Packet]) -> list[bool]:
    return [bool(packet.flags & FLAG_OVERRUN) for packet in frames]


@pytest.mark.parametrize(
    ("rate", "periods"), [(120.0, 2400), night(120.0, 72_000), (0.1, 10), (0.7, 100), (59.94, 400), (1000.0, 400)]
)
def test_every_rate_is_kept_without_drift(new_bench: NewBench, rate: float, periods: int) -> None:
    bench = new_bench(format=1, noise=0)
    set_rate(bench, rate)
    bench.send(START)
    for _ in range(10):
        bench.run(round(periods / 10 / rate * S))
    times = instants(bench.packets)
    assert len(times) >= periods
    assert np.abs(times - np.arange(len(times)) * 1e6 / float(np.float32(rate))).max() < 1.5  # whole microseconds
    assert not any(overruns(tactile(bench.packets)))


def test_a_new_rate_continues_one_new_period_later(bench: Bench) -> None:
    bench.send(START)
    bench.run(100 * MS)
    set_rate(bench, 10.0)
    changed = bench.now
    bench.run(250 * MS)
    assert instants(bench.packets)[-2:].tolist() == [changed + 100 * MS, changed + 200 * MS]


def test_power_is_sent_at_20_hz_under_any_load(bench: Bench) -> None:
    bench.send(START)
    bench.run(10 * S)
    times = [packet.device_time_us for packet in bench.packets if packet.type == PacketType.POWER]
    assert times == [50 * MS * (index + 1) for index in range(200)]


def test_missed_instants_are_missing_numbers_and_an_overrun(bench: Bench) -> None:
    """The emulator sends late samplings; a real board cannot sample the past."""
    bench.send(START)
    bench.run(100 * MS)
    last = tactile(bench.packets)[-1]
    (late,) = tactile(bench.jump(bench.now + 100 * MS))
    assert (late.flags & FLAG_OVERRUN, late.sequence - last.sequence) == (FLAG_OVERRUN, 12)
    assert late.device_time_us == bench.now  # the sampling time, not the due time
    bench.check(missed=11)
    following = bench.run(50 * MS)
    assert not any(overruns(tactile(following)))
    grid = instants(following) * 120 / 1e6
    assert np.abs(grid - np.rint(grid)).max() < 1e-3  # the schedule itself did not move


def test_an_instant_that_has_just_come_is_sampled_only_once(bench: Bench) -> None:
    bench.send(START)
    bench.run(0)
    (frame,) = tactile(bench.jump(16666))  # the second of two instants, 16666.67 us, has just begun
    assert (frame.sequence, frame.flags) == (2, FLAG_OVERRUN)
    (frame,) = tactile(bench.run(8334))
    assert (frame.sequence, frame.flags) == (3, 0)


def test_device_time_survives_the_counters_wrap(new_bench: NewBench) -> None:
    bench = new_bench(start=2**32 - 300 * MS)
    bench.send(START)
    bench.charge()
    assert instants(bench.packets)[-1] > 600 * MS
    assert np.diff(instants(bench.packets)) == pytest.approx(1e6 / 120, abs=1.0)
    assert bench.power().contactor_closed
    assert (bench.packets[0].device_time_us, decode_hello(bench.packets[0].payload).rate) == (0, 120.0)
    for time in (1800 * S, 3600 * S, 2**32 + 5):  # beyond 32 bits
        bench.jump(2**32 - 300 * MS + time)
    assert bench.packets[-1].device_time_us == 2**32 + 5


def test_a_counter_that_steps_back_changes_neither_time_nor_contactor(bench: Bench) -> None:
    """The OpenCM core's micros() can step back by a millisecond if its tick interrupts it."""
    bench.charge()
    bench.jump(bench.now - 1 * MS)
    bench.run(200 * MS)
    bench.check(fault=0)
    times = [packet.device_time_us for packet in bench.packets]
    assert times == sorted(times)
    assert times[-1] <= bench.now


def test_a_blocked_wire_drops_tactile_first_and_answers_last(bench: Bench) -> None:
    bench.send(START)
    bench.run(100 * MS)
    last = tactile(bench.packets)[-1]
    bench.set("baud 1")
    answers = []
    for _ in range(15):
        bench.send(START)
        answers.append(bench._sequence)
        bench.run(200 * MS)
    state = bench.host.state()
    assert state["dropped_tactile"] > 300
    assert state["dropped_power"] > 30
    assert state["dropped_answers"] == 0
    bench.set("baud 0")
    freed = bench.run(50 * MS)
    assert [(ack.error, ack.sequence) for ack in acks(freed)] == [(0, sequence) for sequence in answers]
    lost = np.diff([last.sequence, *(packet.sequence for packet in tactile(freed))]) - 1
    assert sum(lost) == state["dropped_tactile"]
    assert overruns(tactile(freed)) == (lost > 0).tolist()


def test_a_wire_blocked_for_ever_does_not_stop_the_board(bench: Bench) -> None:
    bench.charge().set("baud 1")
    for _ in range(40):
        bench.send((PacketType.PING, bytes(64)))
        bench.run(20 * MS)
    assert bench.state("dropped_answers") > 10
    bench.check(commanded=1)  # heartbeats are still received
    bench.beating = False
    bench.run(101 * MS)
    bench.check(contactor=0)


@pytest.mark.parametrize(
    ("sample_format", "size", "rate", "baud"), [(3, 424, 1000.0, 1_000_000), (2, 324, 120.0, 115_200)]
)
def test_a_stream_too_fast_for_the_wire_is_thinned_and_flagged(
    new_bench: NewBench, sample_format: int, size: int, rate: float, baud: int
) -> None:
    bench = new_bench(format=sample_format, baud=baud)
    set_rate(bench, rate)
    bench.send(START)
    packets = bench.run(3 * S)
    frames = tactile(packets)
    assert overruns(frames[1:]) == (np.diff([packet.sequence for packet in frames]) > 1).tolist()
    powers = sum(packet.type == PacketType.POWER for packet in packets)
    assert powers == pytest.approx(60, abs=3)
    # The wire is full, except for short pauses.
    assert (len(frames) * size + powers * 43) * 10 / baud == pytest.approx(3.0, rel=0.07)
    for _ in range(10):
        bench.send((PacketType.STOP, b""), START)
        asked = bench.now
        while not acks(bench.run(1 * MS)):
            assert bench.now - asked <= 1536 * 10 * S / baud + 1 * MS, "longer than the ring of the wire takes"
        bench.run(37 * MS)
