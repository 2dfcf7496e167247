# SPDX-License-Identifier: Apache-2.0
"""The emulated board against docs/board-link.md: packets, frames, boot. test_board_emulator_*.py have the rest."""

from __future__ import annotations

import math
import struct

import pytest

from deltacharger_driver.board.protocol import PacketType, Power, decode_hello, decode_power

from .board_bench import Bench, acks, tactile

COMMANDS = [
    *[(type, b"") for type in (PacketType.HELLO, PacketType.START, PacketType.STOP, PacketType.TARE, PacketType.PROBE)],
    (PacketType.RATE, struct.pack("<f", 60.0)),
    (PacketType.CONTACTOR, b"\0"),
    (PacketType.CONTACTOR, b"\1"),
]


@pytest.mark.parametrize(("flags", "format"), [(1, 0), (2, 0), (128, 0), (0, 1), (0, 2), (0, 200), (3, 3)])
def test_a_packet_with_flags_or_a_format_is_refused_as_a_bad_payload(flags: int, format: int) -> None:
    bench = Bench()
    for type, payload in COMMANDS:
        (ack,) = acks(bench.send(type, payload, flags=flags, format=format))
        assert (ack.type, ack.error, ack.sequence) == (type, 1, bench.sequence)
    assert bench.send(PacketType.PING, b"x", flags=flags, format=format) == []
    assert bench.send(PacketType.HEARTBEAT, flags=flags, format=format) == []
    assert {p.type for p in bench.run(0.5)} == {PacketType.POWER}
    (ack,) = acks(bench.send(PacketType.TACTILE, flags=flags, format=format))
    assert ack.error == 2  # of an unknown type nothing else is checked


def test_a_boot_resets_everything() -> None:
    bench = Bench().closed()
    bench.error(PacketType.CONTACTOR, b"\0")
    bench.send(PacketType.RATE, struct.pack("<f", 60.0))
    bench.send(PacketType.START)
    bench.error(PacketType.TARE, wait=0.1)
    bench.closed()
    first = decode_hello(bench.packets[0].payload)
    assert first[:7] == (1, 2, 10, 10, first.boot_id, 120.0, True)
    assert math.isnan(first.stage_voltage), "the board sets it"
    bench.board.reboot()
    packets = bench.run(0.2)
    assert packets[0].type == PacketType.HELLO
    assert (packets[0].sequence, packets[0].device_time_us) == (0, 0)
    hello = decode_hello(packets[0].payload)
    assert hello.boot_id != first.boot_id
    assert hello.rate == 120.0
    assert not tactile(packets)
    powers = [p for p in packets if p.type == PacketType.POWER]
    assert [p.sequence for p in powers] == list(range(len(powers)))
    assert powers[0].device_time_us == pytest.approx(50_000, abs=5000)
    assert decode_power(powers[0].payload) == Power(26.0, 24.0, 0.0, False, 0, 0.0)
    bench.run(0.02)
    assert bench.close() == 3
    bench.send(PacketType.START)
    frame = tactile(bench.run(0.1))[0]
    assert (frame.sequence, frame.flags) == (0, 0)
