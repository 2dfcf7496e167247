# SPDX-License-Identifier: Apache-2.0
"""The servos' bus behind the firmware: SERVO and SERVO_SPEED of docs/board-link.md, in simulated time."""

import struct
from collections.abc import Callable

import pytest

from deltacharger_driver.board.protocol import AckError, BoardFault, PacketType, decode_hello
from deltacharger_driver.packets import Packet

from .bench import MS, Bench

NewBench = Callable[..., Bench]
QUESTION = bytes.fromhex("fffffd0001030001194e")
SERVO = PacketType.SERVO


@pytest.fixture
def bench(new_bench: NewBench) -> Bench:
    """A freshly booted board with servos and an unlimited wire."""
    return new_bench(servos=1)


def bus(bench: Bench, sent: bytes = b"") -> bytes:
    """Receive bytes from the servos and return the bytes sent to them."""
    return bytes.fromhex(bench.host.command(f"bus {sent.hex()}").removeprefix("bus").strip())


def from_servos(packets: list[Packet]) -> list[bytes]:
    """Return the bytes from the servos that reached the host, packet by packet."""
    return [packet.payload for packet in packets if packet.type == SERVO]


def ask_servos(bench: Bench) -> None:
    """Send once from the host, so that the board passes bytes on."""
    bench.send((SERVO, QUESTION))
    assert bus(bench) == QUESTION


def answers(bench: Bench) -> None:
    """Ask, and receive an answer."""
    ask_servos(bench)
    bus(bench, b"answer")
    assert from_servos(bench.run(10 * MS)) == [b"answer"]


def set_speed(bench: Bench, speed: int) -> int:
    """Command a speed of the bus, bit/s, and return the error."""
    return bench.ask(PacketType.SERVO_SPEED, struct.pack("<I", speed)).error


@pytest.mark.parametrize("servos", [0, 1])
def test_hello_reports_the_bus_and_a_board_without_it_refuses_its_packets(new_bench: NewBench, servos: int) -> None:
    bench = new_bench(servos=servos)
    hellos = [p for p in bench.packets + bench.send((PacketType.HELLO, b"")) if p.type == PacketType.HELLO]
    assert {decode_hello(hello.payload).minor for hello in hellos} == {2 + servos}
    if servos:
        assert bench.send((SERVO, QUESTION)) == []
        assert from_servos(bench.run(50 * MS)) == []
        return
    for type, payload in ((SERVO, QUESTION), (PacketType.SERVO_SPEED, struct.pack("<I", 57600))):
        assert bench.ask(type, payload).error == AckError.UNKNOWN
    bench.check(unknown=2)


@pytest.mark.parametrize(("speed", "quiet"), [(4_500_000, 200), (57_600, 3472)])
def test_bytes_are_gathered_until_the_bus_is_quiet(bench: Bench, speed: int, quiet: int) -> None:
    """200 us, or 20 byte times if longer."""
    bench.check(servo_speed=1_000_000)
    assert set_speed(bench, speed) == 0
    bench.check(servo_speed=speed)
    ask_servos(bench)
    long = bytes(range(256))
    bus(bench, long)
    assert from_servos(bench.run(0)) == [long[:128], long[128:]], "a full packet does not wait"
    for piece in (b"an ", b"ans", b"wer"):
        bus(bench, piece)
        assert from_servos(bench.run(quiet - 1)) == []
    assert from_servos(bench.run(1)) == [b"an answer"]


def test_nothing_is_sent_before_the_first_servo_packet_of_a_boot(bench: Bench) -> None:
    def nothing_is_sent() -> bool:
        bus(bench, bytes(300))
        return from_servos(bench.run(100 * MS)) == []

    assert nothing_is_sent()
    assert set_speed(bench, 57_600) == 0
    bench.send((SERVO, b""), (SERVO, bytes(129)))  # both are invalid
    assert nothing_is_sent()
    answers(bench)
    bench.reboot()
    bench.check(servo_speed=1_000_000)
    assert nothing_is_sent()


def cycle(bench: Bench, answer: bytes) -> list[bytes]:
    """10 ms with a request of the host and the servos' answer."""
    bench.send((SERVO, QUESTION))
    bench.run(1 * MS)
    bus(bench, answer)
    return from_servos(bench.run(9 * MS))


def test_the_heartbeat_and_the_contactor_keep_their_deadlines_beside_a_busy_bus(new_bench: NewBench) -> None:
    bench = new_bench(servos=1, baud=1_000_000).charge()
    bench.send((PacketType.START, b""))
    for _ in range(100):
        cycle(bench, bytes(300))
    bench.check(contactor=1)
    bench.beat(last=True)
    for _ in range(9):
        cycle(bench, bytes(300))
    bench.send((SERVO, QUESTION))
    bus(bench, bytes(900))
    bench.run(10 * MS - 1)
    bench.check(contactor=1)
    bench.run(1)
    bench.check(contactor=0, fault=BoardFault.HEARTBEAT_LOST)
