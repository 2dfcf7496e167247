# SPDX-License-Identifier: Apache-2.0
"""Identification of devices on real pseudo-terminals, and swapped cables reported by the drivers."""

from __future__ import annotations

import pytest

from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.port import BoardPort
from deltacharger_driver.board.protocol import Packet, PacketType, encode_packet
from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.errors import HandshakeError, NoAnswer, WrongDevice
from deltacharger_driver.port_identity import SERVO_SPEEDS, find_servos, identify
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.mx64 import SPEEDS
from deltacharger_driver.servos.packets import status
from deltacharger_driver.servos.snapshot import BusSettings

from ..emulated_ports import Babbler, written
from ..marks import rest


@pytest.mark.parametrize("speeds", [(3, 1, 3), rest((0, 1, 2)), rest((4, 5, 6))])
def test_servos_are_found_at_the_speed_of_each(
    servos: ServoBusEmulator, servo_port: str, speeds: tuple[int, ...]
) -> None:
    for servo, speed in enumerate(speeds, 1):
        servos.set_speed(servo, speed)
    servos.faults.next_reply("drop", 1)  # a lost reply loses no servo
    before = written(servos)
    found = identify(servo_port)
    assert (found.kind, found.hello) == ("servos", None)
    assert {(s.servo, s.speed, s.protocol, s.model, s.garbled) for s in found.servos} == {
        (servo, SPEEDS[speed], 2, 311, False) for servo, speed in enumerate(speeds, 1)
    }
    assert all(f"id {servo}" in found.details for servo in (1, 2, 3))
    assert written(servos) == before
    assert set(SERVO_SPEEDS) == set(SPEEDS.values())


def test_old_firmware_is_found(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.use_protocol_1(3)
    found = identify(servo_port, speeds=(1_000_000,))
    assert [(s.servo, s.protocol) for s in found.servos] == [(1, 2), (2, 2), (3, 1)]
    assert "Protocol 1.0" in found.details


def test_two_servos_with_one_id_are_reported_as_garbled() -> None:
    with PseudoTerminal(ServoBusEmulator(BenchArm(), ids=(1, 2, 2))) as terminal:
        found = identify(terminal.path, speeds=(1_000_000,))
    assert [(s.servo, s.garbled) for s in found.servos if s.servo == 1] == [(1, False)]
    twins = [s for s in found.servos if s.servo == 2]
    assert len(twins) > 1 or twins[0].garbled


def test_a_board_is_identified_without_changing_its_state(board_port: str) -> None:
    found = identify(board_port)
    assert (found.kind, found.version, found.servos) == ("board", 1, ())
    assert found.hello is not None
    assert (found.hello.rows, found.hello.columns) == (10, 10)
    with BoardLink(board_port) as link:
        assert link.counters.tactile == 0  # the stream was not started
        link.tare()


@pytest.mark.parametrize(
    ("answer", "kind", "version"),
    [
        (encode_packet(Packet(PacketType.POWER, bytes(16)), version=3), "board", 3),
        (b"", "silent", None),
        (b"login: ", "other", None),
    ],
    ids=["a board of another version", "silence", "another device"],
)
def test_other_devices_are_reported(answer: bytes, kind: str, version: int | None) -> None:
    with PseudoTerminal(Babbler(answer)) as terminal:
        found = identify(terminal.path, speeds=(1_000_000,))
    assert (found.kind, found.version or None, found.hello, found.servos) == (kind, version, None, ())


def test_swapped_cables_are_reported_by_both_drivers(board_port: str, servo_port: str) -> None:
    with pytest.raises(WrongDevice, match="swap") as caught:
        ServoBus(BusSettings(port=board_port)).open(scan=False)
    assert (caught.value.expected, caught.value.port) == ("the servos", board_port)
    with BoardLink(board_port) as link:  # the port is free again
        link.ping()
    with pytest.raises(WrongDevice, match="swap") as caught:
        BoardLink(servo_port).open()
    assert caught.value.found == "the servos"


@pytest.mark.rest
def test_silence_is_not_taken_for_swapped_cables() -> None:
    with PseudoTerminal(Babbler(b"")) as terminal:
        with pytest.raises(NoAnswer):
            BoardLink(terminal.path).open()
        with pytest.raises(HandshakeError):
            ServoBus(BusSettings(port=terminal.path)).open(scan=False)


class Noisy(Babbler):
    """Servos whose replies are among other bytes, one of them damaged."""

    def __init__(self) -> None:
        good = status(7, 0, bytes((0x37, 0x01, 45)))
        damaged = bytearray(status(9, 0, bytes((0x37, 0x01, 45))))
        damaged[10] ^= 4
        super().__init__(b"\xff\xff\xfd" + good[:9] + b"\x17" + bytes(damaged) + good + b"\xff\xff\xfd\0")


def test_replies_among_noise_are_found_and_damaged_ones_are_not() -> None:
    with PseudoTerminal(Noisy()) as terminal:
        port = BoardPort(terminal.path, 1_000_000)
        try:
            found = find_servos(port, (1_000_000,), ids=())
        finally:
            port.close()
    assert [(s.servo, s.model, s.firmware) for s in found] == [(7, 311, 45)]
