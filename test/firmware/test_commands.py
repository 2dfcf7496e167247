# SPDX-License-Identifier: Apache-2.0
"""Answers, tare and floods on the firmware, in simulated time; more of them in test_emulator_suite.py."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import numpy as np
import pytest

from deltacharger_driver.board.payloads import decode_samples
from deltacharger_driver.board.protocol import FLAG_TARED, PacketType

from .bench import MS, Bench, acks, tactile

NewBench = Callable[..., Bench]


def test_sequences_count_per_type_and_wrap(bench: Bench) -> None:
    for _ in range(70):
        bench.send(*[(PacketType.PING, b"")] * 1000)
    pings = [packet.sequence for packet in bench.packets if packet.type == PacketType.PING]
    assert pings == [index % 65536 for index in range(70_000)]


def frame(bench: Bench) -> tuple[int, np.ndarray[tuple[int, ...], np.dtype[np.float32]]]:
    """Flags and forces of the next frame."""
    bench.send((PacketType.START, b""))
    packet = tactile(bench.run(20 * MS))[-1]
    return packet.flags, np.ravel(decode_samples(packet.payload, packet.format))


def load(bench: Bench, forces: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    bench.set(f"pads {forces.astype('<f4').tobytes().hex()}")


def test_tare_averages_subtracts_and_clips(new_bench: NewBench) -> None:
    bench = new_bench(format=3, noise=0.1, offset=0)
    resting = np.linspace(0.0, 0.6, 200)
    load(bench, resting)
    assert bench.ask(PacketType.TARE, wait=27 * MS + 1 * MS).error == 0
    bench.set("noise 0")
    load(bench, resting + 2.0)
    flags, forces = frame(bench)
    assert flags == FLAG_TARED
    error = forces - 2.0
    assert np.abs(error).max() < 6 * 0.1 / math.sqrt(8)
    assert np.std(error) == pytest.approx(0.1 / math.sqrt(8), rel=0.3)
    load(bench, resting - 1.0)
    assert frame(bench)[1].max() == 0.0


@pytest.mark.parametrize(("force", "error"), [(0.999, 0), (1.001, 4)])
@pytest.mark.parametrize("offset", [0.3, -0.8])
def test_one_newton_on_one_taxel_is_contact(new_bench: NewBench, offset: float, force: float, error: int) -> None:
    bench = new_bench(noise=0, offset=offset)
    for tared in (False, True):
        forces = np.zeros(200)
        load(bench, forces)
        if tared:
            assert bench.ask(PacketType.TARE, wait=40 * MS).error == 0
        forces[157] = force
        load(bench, forces)
        assert bench.ask(PacketType.TARE, wait=40 * MS).error == error


def test_a_completely_dead_pad_can_be_tared(new_bench: NewBench) -> None:
    bench = new_bench(noise=0)
    forces = np.zeros(200)
    forces[100:] = np.nan
    load(bench, forces)
    assert bench.ask(PacketType.TARE, wait=40 * MS).error == 0


def test_a_second_tare_is_refused_while_one_runs_and_each_gets_its_answer(bench: Bench) -> None:
    packets = bench.send((PacketType.TARE, b""), (PacketType.TARE, b"")) + bench.run(40 * MS)
    assert [(ack.error, ack.sequence) for ack in acks(packets)] == [(4, 2), (0, 1)]


def test_the_heartbeat_still_counts_in_a_flood_of_garbage(bench: Bench) -> None:
    source = random.Random(5)
    bench.charge()
    for _ in range(30):
        garbage = source.randbytes(source.randrange(1, 60_000)) + b"\0"
        bench.host.sent(f"wire {garbage.hex()}")
        bench.run(20 * MS)
    assert bench.state("commanded") == 1
    assert bench.ask(PacketType.STOP).error == 0
