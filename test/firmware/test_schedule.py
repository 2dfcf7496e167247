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
    bench = new_bench(noise=0)
    set_rate(bench, rate)
    bench.send(START)
    for _ in range(10):
        bench.run(round(periods / 10 / rate * S))
    times = instants(bench.packets)
    assert len(times) >= periods
    assert np.abs(times - np.arange(len(times)) * 1e6 / float(np.float32(rate))).max() < 1.5  # whole microseconds
    assert not any(overruns(tactile(bench.packets)))


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
