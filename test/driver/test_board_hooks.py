# SPDX-License-Identifier: Apache-2.0
"""Test hooks of the emulated board: slow boots, late packets, and callbacks for samplings and heartbeats."""

from __future__ import annotations

import pytest

from deltacharger_driver.board.protocol import Packet, PacketType

from .board_bench import STEP, Bench


def types(packets: list[Packet]) -> list[int]:
    return [packet.type for packet in packets]


def test_a_booting_board_neither_receives_nor_sends() -> None:
    bench = Bench(hooks={"boot_time": 0.5})
    assert bench.run(0.4) == bench.send(PacketType.START) == bench.run(0.095) == []
    packets = bench.run(0.1)
    assert types(packets)[0] == PacketType.HELLO
    assert packets[0].device_time_us == 0  # its clock starts with it
    assert PacketType.ACK not in types(packets)
    assert PacketType.ACK in types(bench.send(PacketType.START))


def test_a_reboot_first_opens_the_contactor_and_lasts_its_boot_time() -> None:
    bench = Bench().closed()
    bench.beating = False
    bench.board.reboot(0.25)
    assert bench.board.next_event(bench.now) == 0.0
    assert bench.run(STEP) == []
    assert not bench.plant.read_power()[3]
    assert not bench.board.contactor_commanded
    assert bench.board.next_event(bench.now) == pytest.approx(0.25)
    assert bench.run(0.245) == []
    assert PacketType.HELLO in types(bench.run(0.01))


def test_a_late_wire_keeps_the_order_loses_nothing_and_wakes_the_server_when_due() -> None:
    bench = Bench()
    bench.send(PacketType.START)
    bench.run(0.5)
    bench.board.faults.delay = 0.1
    assert bench.send(PacketType.PING, b"x") == []
    assert 0.0 < bench.board.next_event(bench.now) < 0.1
    assert bench.run(0.1 - STEP) == []
    bench.run(0.2)
    bench.board.faults.delay = 0.0
    first = bench.run(1.0)
    sequences = [packet.sequence for packet in first if packet.type == PacketType.TACTILE]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    assert len(sequences) == pytest.approx(120 + 12, abs=2)  # delayed ones arrived too
    assert [packet.device_time_us for packet in first] == sorted(packet.device_time_us for packet in first)


def test_recorders_get_every_sampling_and_every_received_heartbeat() -> None:
    samples: list[tuple[int, float, float]] = []
    beats: list[float] = []
    bench = Bench(hooks={"on_sample": lambda *sample: samples.append(sample), "on_heartbeat": beats.append})
    bench.send(PacketType.START)
    started, bench.beating = bench.now, True
    frames = [packet for packet in bench.run(1.0) if packet.type == PacketType.TACTILE]
    assert [sequence for sequence, _, _ in samples][-len(frames) :] == [packet.sequence for packet in frames]
    for number, (_, nominal, real) in enumerate(samples):
        assert nominal == pytest.approx(started + number / 120.0, abs=1e-6)
        assert 0.0 <= real - nominal <= STEP + 1e-6
    assert len(beats) == 50
    bench.board.faults.deaf = True
    bench.run(0.1)
    assert len(beats) == 50
