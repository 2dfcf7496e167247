# SPDX-License-Identifier: Apache-2.0
"""BoardLink over a real pseudo-terminal and the emulated board."""

import math
import struct
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_driver import errors, packets, ports
from deltacharger_driver.board import protocol
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.receiver import BoardReceiver, BoardRequests
from deltacharger_sim.emulators.board import BoardEmulator

from ..chargers import patience
from ..emulated_ports import Babbler
from ..plants import BenchPlant
from ..waiting import wait_until

LIMITS = ChargeLimits(10.0, 29.4)


class Rig:
    """Board, cable and host."""

    def __init__(self, directory: Path) -> None:
        self.plant = BenchPlant()
        self.board = BoardEmulator(self.plant, seed=3)
        self.frames: list[protocol.TactileSample] = []
        self.powers: list[protocol.PowerSample] = []
        self.boots: list[float] = []
        self.cable = ports.PseudoTerminal(self.board, directory / "board").start()
        self.link = BoardLink(
            self.cable.path,
            on_tactile=self.frames.append,
            on_power=self.powers.append,
            on_boot=lambda: self.boots.append(time.monotonic()),
        )

    def stop(self) -> None:
        self.link.close()
        self.cable.stop()
        assert self.cable.error is None


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    with patience():
        rig = Rig(tmp_path)
        yield rig
        rig.stop()


@pytest.fixture
def link(rig: Rig) -> BoardLink:
    rig.link.open()
    return rig.link


def test_the_heartbeat_lasts_until_its_deadline(rig: Rig, link: BoardLink) -> None:
    assert link.counters.heartbeats == 0
    link.probe()
    with pytest.raises(protocol.CommandRefused, match="heartbeat"):
        link.contactor(True, LIMITS)
    until = time.monotonic() + 0.3
    link.keep_alive(until)
    link.contactor(True, LIMITS)
    wait_until(lambda: rig.board.fault)
    assert time.monotonic() > until
    assert rig.board.fault == protocol.BoardFault.HEARTBEAT_LOST
    assert link.counters.heartbeats <= 17
    link.contactor(False)
    wait_until(lambda: rig.powers[-1].power.fault == 0)


def test_a_command_with_a_lost_answer_is_repeated_and_a_repeated_close_succeeds(rig: Rig, link: BoardLink) -> None:
    rig.board.faults.inject("drop", 1, protocol.PacketType.ACK)
    link.start()
    assert link.counters.retries >= 1
    link.probe()
    link.keep_alive(math.inf)
    rig.board.faults.inject("drop", 1, protocol.PacketType.ACK)
    link.contactor(True, LIMITS)
    assert rig.board.contactor_commanded
    with pytest.raises(protocol.CommandRefused):
        link.contactor(True, LIMITS)


@pytest.mark.parametrize("announced", [True, False], ids=["HELLO", "HELLO lost"])
def test_a_board_that_boots_while_its_port_opens_dates_no_frame_back(announced: bool) -> None:
    board, decoder, frames = (
        BoardEmulator(BenchPlant(), seed=3),
        packets.PacketDecoder(),
        list[protocol.TactileSample](),
    )
    receiver = BoardReceiver(BoardRequests(), frames.append, None, lambda: None)

    def exchange(now: float, *commands: protocol.PacketType) -> None:
        sent = b"".join(packets.encode_packet(packets.Packet(command)) for command in commands)
        for packet in decoder.feed(board.receive(sent, now)):
            receiver.take_packet(packet, now)

    board.poll(10.0)  # the port is not open yet
    exchange(10.06)
    board.reboot()
    if announced:
        exchange(10.1)
    else:
        board.poll(10.1)
    exchange(10.2, protocol.PacketType.HELLO, protocol.PacketType.START)
    for tick in range(10):
        exchange(10.2 + tick / 120.0)
    assert [frame.time for frame in frames] == pytest.approx([10.2 + tick / 120.0 for tick in range(10)], abs=2e-3)
    assert receiver.counters.reboots == announced


def test_a_reboot_with_a_lost_hello_is_detected_by_the_clock() -> None:
    board, decoder, boots = BoardEmulator(BenchPlant(), seed=3), packets.PacketDecoder(), list[bool]()
    receiver = BoardReceiver(BoardRequests(), None, None, lambda: boots.append(True))
    for tick in range(200):
        if tick == 100:
            board.faults.inject("drop", 1, protocol.PacketType.HELLO)
            board.reboot()
        for packet in decoder.feed(board.poll(10.0 + 0.01 * tick)):
            receiver.take_packet(packet, 10.0 + 0.01 * tick)
    assert (receiver.counters.reboots, boots) == (1, [True])


def probe_until(rig: Rig, interrupt: Callable[[], object]) -> None:
    """Send a probe that gets no answer, interrupt the wait for it, and return when that ended."""
    rig.board.faults.deaf = True
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(rig.link.probe)
        wait_until(lambda: rig.link._requests._waiting, "a waiting probe")
        interrupt()
        rig.board.faults.deaf = False
        answer.result()


def test_a_reboot_and_an_unplugging_end_every_command_and_replugging_recovers(rig: Rig, link: BoardLink) -> None:
    link.start()
    wait_until(lambda: len(rig.frames) >= 10)
    with pytest.raises(protocol.BoardRebooted, match="PROBE"):
        probe_until(rig, rig.board.reboot)
    with pytest.raises(errors.PortGone):
        probe_until(rig, rig.cable.stop)
    assert rig.link.gone is not None
    with pytest.raises(errors.PortGone):
        link.start()
    link.close()
    last = rig.frames[-1].sequence
    rig.cable.start()
    link.open()
    link.start()
    before = len(rig.frames)
    wait_until(lambda: len(rig.frames) > before + 5)
    assert rig.frames[-1].sequence > last
    assert len(rig.boots) == 1


def hello(*head: int, version: int = 1) -> bytes:
    """Return a HELLO that begins with these bytes, and the ACK of the first one asked for."""
    ack = packets.Packet(protocol.PacketType.ACK, bytes((protocol.PacketType.HELLO, 0, 0, 0)))
    return packets.encode_packet(
        packets.Packet(protocol.PacketType.HELLO, bytes(head).ljust(16, b"\0") + struct.pack("<f", math.nan)), version
    ) + packets.encode_packet(ack, version)


@pytest.mark.parametrize(
    ("answer", "error", "words"),
    [
        (hello(version=2), protocol.BoardMismatch, "version 2"),
        (b"Welcome to minicom\r\n", protocol.BoardMismatch, "no intact packet.*swapped.*deltacharger doctor"),
        (b"", errors.NoAnswer, "HELLO.*swapped.*deltacharger doctor"),
        (hello(2, 1, 10, 10), protocol.BoardMismatch, r"version 2\.1"),
        (hello(1, 1, 10, 10), protocol.BoardMismatch, r"version 1\.1.*flash"),
        (hello(1, protocol.MINOR, 16, 8), protocol.BoardMismatch, "16 x 8"),
    ],
)
def test_an_incompatible_device_is_refused_with_the_reason(answer: bytes, error: type[Exception], words: str) -> None:
    puppet = Babbler(answer)
    with ports.PseudoTerminal(puppet) as cable, pytest.raises(error, match=words):
        BoardLink(cable.path).open()
    received = [packet.type for packet in packets.PacketDecoder().feed(puppet.received)]
    assert set(received) == {protocol.PacketType.HELLO}, "an incompatible board receives only HELLO"
    assert len(received) <= 3
