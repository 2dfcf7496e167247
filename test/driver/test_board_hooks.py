# SPDX-License-Identifier: Apache-2.0
"""Test hooks of the emulated board: slow boots, late packets, and callbacks for samplings and heartbeats."""

from __future__ import annotations

import pytest

from deltacharger_driver.board.protocol import PacketType

from .board_bench import STEP, Bench, tactile


def test_a_booting_board_neither_receives_nor_sends() -> None:
    bench = Bench(hooks={"boot_time": 0.5})
    assert bench.run(0.4) == bench.send(PacketType.START) == bench.run(0.095) == []
    first = bench.run(0.1)[0]
    assert (first.type, first.device_time_us) == (PacketType.HELLO, 0)  # its clock starts with it


def test_a_reboot_first_opens_the_contactor_and_lasts_its_boot_time() -> None:
    bench = Bench().closed()
    bench.beating = False
    bench.board.reboot(0.25)
    assert bench.board.next_event(bench.now) == 0.0
    assert bench.run(STEP) == []
    assert not bench.plant.read_power().closed
    assert bench.board.next_event(bench.now) == pytest.approx(0.25)


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
    bench.run(1.0)
    assert [packet.sequence for packet in tactile(bench.packets)] == list(range(216))  # 1.8 s
    assert [packet.device_time_us for packet in bench.packets] == sorted(
        packet.device_time_us for packet in bench.packets
    )


def test_recorders_get_every_sampling_and_every_received_heartbeat() -> None:
    samples: list[tuple[int, float, float]] = []
    beats: list[float] = []
    bench = Bench(hooks={"on_sample": lambda *sample: samples.append(sample), "on_heartbeat": beats.append})
    bench.send(PacketType.START)
    started, bench.beating = bench.now, True
    frames = tactile(bench.run(1.0))
    assert [sequence for sequence, _, _ in samples][-len(frames) :] == [packet.sequence for packet in frames]
    for number, (_, nominal, real) in enumerate(samples):
        assert nominal == pytest.approx(started + number / 120.0, abs=1e-6)
        assert 0.0 <= real - nominal <= STEP + 1e-6
    assert len(beats) == 50
    bench.board.faults.deaf = True
    bench.run(0.1)
    assert len(beats) == 50
