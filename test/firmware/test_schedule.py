# SPDX-License-Identifier: Apache-2.0
"""Sampling, device time and a slow wire, in simulated time."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest

from deltacharger_driver.board.payloads import decode_hello
from deltacharger_driver.board.protocol import FLAG_OVERRUN, PacketType

from .bench import MS, Bench, S, acks, tactile

NewBench = Callable[..., Bench]


def set_rate(bench: Bench, rate: float) -> None:
    assert bench.ask(PacketType.RATE, struct.pack("<f", rate)).error == 0


def instants(bench: Bench) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.array([packet.device_time_us for packet in tactile(bench.packets)])


def test_120_hz_does_not_drift_in_ten_minutes(new_bench: NewBench) -> None:
    bench = new_bench(format=1, noise=0)
    bench.send((PacketType.START, b""))
    for _ in range(60):
        bench.run(10 * S)
    times = instants(bench)
    assert len(times) == 10 * 60 * 120 + 1
    assert np.abs(times - np.arange(len(times)) * 1e6 / 120).max() < 1.001  # whole microseconds
    assert not any(packet.flags & FLAG_OVERRUN for packet in tactile(bench.packets))


@pytest.mark.parametrize("rate", [0.1, 0.7, 33.3, 59.94, 97.0, 240.0, 1000.0])
def test_every_rate_is_kept(new_bench: NewBench, rate: float) -> None:
    bench = new_bench(format=1, noise=0)
    set_rate(bench, rate)
    bench.send((PacketType.START, b""))
    for _ in range(10):
        bench.run(round(40 / rate * S))
    times = instants(bench)
    assert len(times) >= 400
    assert np.abs(times - np.arange(len(times)) * 1e6 / float(np.float32(rate))).max() < 1.5


def test_a_new_rate_continues_one_new_period_later(bench: Bench) -> None:
    bench.send((PacketType.START, b""))
    bench.run(100 * MS)
    set_rate(bench, 10.0)
    changed = bench.now
    bench.run(250 * MS)
    assert instants(bench)[-2:].tolist() == [changed + 100 * MS, changed + 200 * MS]


def test_starting_twice_changes_nothing_and_sequences_continue_over_a_stop(bench: Bench) -> None:
    bench.send((PacketType.START, b""))
    bench.run(50 * MS)
    bench.send((PacketType.START, b""))
    bench.run(50 * MS)
    assert np.diff(instants(bench)) == pytest.approx(1e6 / 120, abs=1.0)
    assert bench.ask(PacketType.STOP).error == 0
    assert tactile(bench.run(100 * MS)) == []
    bench.send((PacketType.START, b""))
    bench.run(20 * MS)
    sequences = [packet.sequence for packet in tactile(bench.packets)]
    assert sequences == list(range(len(sequences)))


def test_power_is_sent_at_20_hz_under_any_load(bench: Bench) -> None:
    bench.send((PacketType.START, b""))
    bench.run(10 * S)
    times = [packet.device_time_us for packet in bench.packets if packet.type == PacketType.POWER]
    assert times == [50 * MS * (index + 1) for index in range(200)]


def test_missed_instants_are_missing_numbers_and_an_overrun(bench: Bench) -> None:
    """The emulator sends late samplings; a real board cannot sample the past."""
    bench.send((PacketType.START, b""))
    bench.run(100 * MS)
    last = tactile(bench.packets)[-1]
    late = tactile(bench.jump(bench.now + 100 * MS))
    assert len(late) == 1
    assert late[0].flags & FLAG_OVERRUN
    assert late[0].device_time_us == bench.now  # the sampling time, not the due time
    assert late[0].sequence - last.sequence == 12
    assert bench.state("missed") == 11
    following = tactile(bench.run(50 * MS))
    assert not any(packet.flags & FLAG_OVERRUN for packet in following)
    grid = np.array([packet.device_time_us for packet in following]) * 120 / 1e6
    assert np.abs(grid - np.rint(grid)).max() < 1e-3  # the schedule itself did not move


def test_an_instant_that_has_just_come_is_sampled_only_once(bench: Bench) -> None:
    bench.send((PacketType.START, b""))
    bench.run(0)
    (frame,) = tactile(bench.jump(16666))  # the second of two instants, 16666.67 us, has just begun
    assert (frame.sequence, frame.flags) == (2, FLAG_OVERRUN)
    (frame,) = tactile(bench.run(8334))
    assert (frame.sequence, frame.flags) == (3, 0)


def test_device_time_survives_the_counters_wrap(new_bench: NewBench) -> None:
    bench = new_bench(start=2**32 - 300 * MS)
    bench.send((PacketType.START, b""))
    bench.charge()
    assert instants(bench)[-1] > 600 * MS
    assert np.diff(instants(bench)) == pytest.approx(1e6 / 120, abs=1.0)
    assert bench.power().contactor_closed
    first = decode_hello(bench.packets[0].payload)
    assert bench.packets[0].device_time_us == 0
    assert first.rate == 120.0


def test_device_time_continues_beyond_32_bits(new_bench: NewBench) -> None:
    bench = new_bench(noise=0)
    for minutes in (30, 60):
        bench.jump(minutes * 60 * S)
    bench.jump(2**32 + 5)
    assert bench.packets[-1].device_time_us == 2**32 + 5


def test_a_counter_that_steps_back_changes_neither_time_nor_contactor(bench: Bench) -> None:
    """The OpenCM core's micros() can step back by a millisecond if its tick interrupts it."""
    bench.charge()
    before = bench.now
    bench.jump(before - 1 * MS)
    bench.run(200 * MS)
    assert bench.state("fault") == 0
    times = [packet.device_time_us for packet in bench.packets]
    assert times == sorted(times)
    assert times[-1] <= bench.now


def test_a_blocked_wire_drops_tactile_first_and_answers_last(bench: Bench) -> None:
    bench.send((PacketType.START, b""))
    bench.run(100 * MS)
    last = tactile(bench.packets)[-1]
    bench.set("baud 1")
    answers = []
    for _ in range(15):
        bench.send((PacketType.START, b""))
        answers.append(bench._sequence)
        bench.run(200 * MS)
    state = bench.host.state()
    assert state["dropped_tactile"] > 300
    assert state["dropped_power"] > 30
    assert state["dropped_answers"] == 0
    bench.set("baud 0")
    freed = bench.run(50 * MS)
    assert [(ack.error, ack.sequence) for ack in acks(freed)] == [(0, sequence) for sequence in answers]
    frames = tactile(freed)
    sequences = [last.sequence, *(packet.sequence for packet in frames)]
    assert sum(np.diff(sequences) - 1) == state["dropped_tactile"]
    assert [bool(p.flags & FLAG_OVERRUN) for p in frames] == (np.diff(sequences) > 1).tolist()


def test_a_wire_blocked_for_ever_does_not_stop_the_board(bench: Bench) -> None:
    bench.charge()
    bench.set("baud 1")
    for _ in range(40):
        bench.send((PacketType.PING, bytes(64)))
        bench.run(20 * MS)
    assert bench.state("dropped_answers") > 10
    assert bench.state("commanded") == 1  # heartbeats are still received
    bench.beating = False
    bench.run(101 * MS)
    assert bench.state("contactor") == 0


@pytest.mark.parametrize(("sample_format", "rate", "baud"), [(3, 1000.0, 1_000_000), (2, 120.0, 115_200)])
def test_a_stream_too_fast_for_the_wire_is_thinned_and_flagged(
    new_bench: NewBench, sample_format: int, rate: float, baud: int
) -> None:
    bench = new_bench(format=sample_format, baud=baud)
    set_rate(bench, rate)
    bench.send((PacketType.START, b""))
    packets = bench.run(5 * S)
    frames = tactile(packets)
    sequences = [packet.sequence for packet in frames]
    assert [bool(p.flags & FLAG_OVERRUN) for p in frames[1:]] == (np.diff(sequences) > 1).tolist()
    carried = sum({2: 324, 3: 424}[sample_format] for _ in frames) * 10 / baud
    assert carried == pytest.approx(5.0, rel=0.07)  # the wire is full, except for POWER and short pauses
    assert sum(packet.type == PacketType.POWER for packet in packets) == pytest.approx(100, abs=3)
    latencies = []
    for _ in range(20):
        bench.send((PacketType.STOP, b""), (PacketType.START, b""))
        asked = bench.now
        while not acks(bench.run(1 * MS)):
            assert bench.now - asked < 200 * MS
        latencies.append(bench.now - asked)
        bench.run(37 * MS)
    ring = 1536 * 10 * S / baud
    assert max(latencies) <= ring + 2 * MS


def test_at_1_mbaud_120_hz_in_u16_loses_nothing(new_bench: NewBench) -> None:
    bench = new_bench(format=3, baud=1_000_000, scan_time=2000)
    bench.send((PacketType.START, b""))
    frames = tactile(bench.run(20 * S))
    assert [packet.sequence for packet in frames] == list(range(len(frames)))
    assert len(frames) == pytest.approx(2400, abs=1)
    assert bench.state("dropped_tactile") == bench.state("missed") == 0
