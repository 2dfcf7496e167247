# SPDX-License-Identifier: Apache-2.0
"""The device's clock: offset from the packets with the least delay; rising sequence numbers; rates."""

from __future__ import annotations

import random

import pytest

from deltacharger_core.real_time import RateMeter
from deltacharger_driver.board.receiver import DeviceClock, SequenceUnwrapper

from .virtual_line import Clock


@pytest.mark.parametrize("drift", [0.0, 100e-6, -100e-6])
def test_the_offset_is_found_under_jitter_and_drift(drift: float) -> None:
    clock, delay = DeviceClock(), random.Random(1)
    for number in range(12 * 120):
        true = number / 120.0
        received = true + 1234.5 + delay.expovariate(1.0 / 0.002)
        stamp = clock.update(true * (1.0 + drift), received)
        assert stamp <= received
        assert number < 600 or stamp == pytest.approx(true + 1234.5, abs=1e-3)
    clock.reset()
    assert clock.update(0.0, 6.5) == 6.5


def test_a_stalled_host_does_not_move_the_clock() -> None:
    clock = DeviceClock()
    for number in range(1200):
        late = 0.3 if 600 <= number < 640 else 0.0  # packets that waited in the kernel's buffer
        stamp = clock.update(number / 120.0, number / 120.0 + 50.0 + late)
        assert stamp == pytest.approx(number / 120.0 + 50.0, abs=1e-4)


def test_a_repeated_packet_is_not_a_frame_and_numbers_rise_beyond_16_bits() -> None:
    counter = SequenceUnwrapper()
    assert [counter.update(number % 65536) for number in range(0, 200_000, 30_000)] == list(range(0, 200_000, 30_000))
    counter = SequenceUnwrapper()
    assert [counter.update(n) for n in (5, 5, 6)] == [5, None, 6]
    assert (counter.lost, counter.duplicates) == (0, 1)


def test_a_reboot_continues_above_and_counts_missed_packets() -> None:
    counter = SequenceUnwrapper()
    counter.update(100)
    counter.reboot()
    assert [counter.update(n) for n in (2, 3)] == [103, 104]
    assert counter.lost == 2


def test_the_rate_counts_since_the_last_call() -> None:
    clock = Clock()
    meter = RateMeter(clock)
    for number in range(50):
        meter.count(late=number % 25 == 0)
    clock.now += 0.5
    assert meter.rate() == pytest.approx(100.0)
    clock.now += 2.0
    assert meter.rate() == 0.0
    meter.count()
    clock.now += 0.1
    assert meter.rate() == pytest.approx(10.0)
    assert meter.late == 2  # since the start
