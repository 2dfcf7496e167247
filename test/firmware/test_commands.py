# SPDX-License-Identifier: Apache-2.0
"""Answers, tare and floods on the firmware, in simulated time; more of them in test_emulator_suite.py."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable

import numpy as np
import pytest

from deltacharger_driver.board.payloads import decode_hello, decode_samples
from deltacharger_driver.board.protocol import FLAG_TARED, Packet, PacketType, encode_packet

from .bench import MS, Bench, S, acks, tactile

NewBench = Callable[..., Bench]

ANSWERS = [
    (PacketType.HELLO, b"", 0),
    (PacketType.START, b"", 0),
    (PacketType.STOP, b"", 0),
    (PacketType.RATE, struct.pack("<f", 0.1), 0),
    (PacketType.RATE, struct.pack("<f", 1000.0), 0),
    (PacketType.RATE, struct.pack("<f", 0.099), 1),
    (PacketType.RATE, struct.pack("<f", 1000.1), 1),
    (PacketType.RATE, struct.pack("<f", math.nan), 1),
    (PacketType.RATE, struct.pack("<f", -math.inf), 1),
    (PacketType.RATE, bytes(3), 1),
    (PacketType.CONTACTOR, b"\0", 0),
    (PacketType.CONTACTOR, b"\1", 3),
    (PacketType.CONTACTOR, b"\2", 1),
    (PacketType.CONTACTOR, b"", 1),
    (PacketType.CONTACTOR, b"\0\0", 1),
    *[(type, b"x", 1) for type in (3, 4, 5, 6, 11)],
    *[(type, payload, 2) for type in (0, 1, 2, 10, 13, 200, 255) for payload in (b"", bytes(440))],
]


@pytest.mark.parametrize(("type", "payload", "error"), ANSWERS)
def test_every_command_is_answered_once_with_its_number(bench: Bench, type: int, payload: bytes, error: int) -> None:
    for _ in range(3):
        assert bench.ask(type, payload).error == error
    assert acks(bench.run(300 * MS)) == []


def test_sequences_count_per_type_and_wrap(bench: Bench) -> None:
    for _ in range(70):
        bench.send(*[(PacketType.PING, b"")] * 1000)
    pings = [packet.sequence for packet in bench.packets if packet.type == PacketType.PING]
    assert pings == [index % 65536 for index in range(70_000)]


def test_a_boot_has_a_new_number_and_starts_anew(bench: Bench) -> None:
    boots = {decode_hello(bench.packets[0].payload).boot_id}
    for _ in range(20):
        bench.run(70 * MS)
        bench.host.sent(f"boot {bench.now}")
        (hello, ack) = bench.send((PacketType.HELLO, b""))
        assert (hello.sequence, ack.sequence) == (1, 0)
        assert hello.device_time_us == 0
        boots.add(decode_hello(hello.payload).boot_id)
    assert len(boots) == 21


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


def test_a_tare_replaces_the_last_one_and_a_boot_forgets_it(new_bench: NewBench) -> None:
    bench = new_bench(format=3, noise=0, offset=0.5)
    assert bench.ask(PacketType.TARE, wait=40 * MS).error == 0
    bench.set("offset 1.2")
    assert bench.ask(PacketType.TARE, wait=40 * MS).error == 0  # 0.7 N after the present tare
    bench.set("offset 2.0")
    assert frame(bench)[1] == pytest.approx(0.8, abs=1e-3)
    bench.host.sent(f"boot {bench.now}")
    flags, forces = frame(bench)
    assert flags == 0
    assert forces == pytest.approx(2.0, abs=1e-3)


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


def test_a_dead_taxel_neither_counts_as_contact_nor_spoils_its_neighbours(new_bench: NewBench) -> None:
    bench = new_bench(format=3, noise=0, offset=0.4)
    forces = np.zeros(200)
    forces[42] = 9.0
    load(bench, forces)
    bench.set("dead 0 4 2 1", "dead 1 0 0 1")
    assert bench.ask(PacketType.TARE, wait=40 * MS).error == 0
    _, tared = frame(bench)
    assert np.flatnonzero(np.isnan(tared)).tolist() == [42, 100]
    assert np.nanmax(tared) == 0.0


def test_a_whole_dead_pad_can_be_tared(new_bench: NewBench) -> None:
    bench = new_bench(noise=0)
    forces = np.zeros(200)
    forces[100:] = np.nan
    load(bench, forces)
    assert bench.ask(PacketType.TARE, wait=40 * MS).error == 0


def test_a_taxel_that_is_dead_for_part_of_the_tare_keeps_its_resting_value(new_bench: NewBench) -> None:
    bench = new_bench(format=3, noise=0, offset=0.4)
    bench.send((PacketType.TARE, b""))
    bench.run(10 * MS)
    bench.set("dead 0 0 0 1")
    bench.run(10 * MS)
    bench.set("dead 0 0 0 0")
    assert [ack.error for ack in acks(bench.run(10 * MS))] == [0]
    assert frame(bench)[1].max() == pytest.approx(0.0, abs=1e-3)


def test_a_second_tare_is_refused_while_one_runs_and_each_gets_its_answer(bench: Bench) -> None:
    packets = bench.send((PacketType.TARE, b""), (PacketType.TARE, b"")) + bench.run(40 * MS)
    assert [(ack.error, ack.sequence) for ack in acks(packets)] == [(4, 2), (0, 1)]


def test_a_flood_of_garbage_is_outlived_and_the_heartbeat_still_counts(bench: Bench) -> None:
    source = random.Random(5)
    bench.charge()
    for _ in range(30):
        garbage = source.randbytes(source.randrange(1, 60_000)) + b"\0"
        bench.host.sent(f"wire {garbage.hex()}")
        bench.run(20 * MS)
    assert bench.state("commanded") == 1
    assert bench.ask(PacketType.STOP).error == 0


def test_commands_cut_into_single_bytes_are_carried_out(bench: Bench) -> None:
    for byte in encode_packet(Packet(PacketType.START)):
        bench._hear(bench.host.sent(f"wire {byte:02x}"))
        bench.run(100)
    assert len(tactile(bench.run(1 * S))) == pytest.approx(120, abs=1)
