# SPDX-License-Identifier: Apache-2.0
"""Identification of devices on real pseudo-terminals, and swapped cables reported by the drivers."""

from __future__ import annotations

from collections.abc import Callable

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
from deltacharger_driver.servos.packets import status
from deltacharger_driver.servos.snapshot import BusSettings

from ..emulated_ports import Babbler, written


def test_servos_are_found_at_the_speed_of_each(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.set_speed(2, 1)
    found = identify(servo_port)
    assert found.kind == "servos"
    assert sorted((s.servo, s.speed, s.protocol, s.model) for s in found.servos) == [
        (1, 1_000_000, 2, 311),
        (2, 57600, 2, 311),
        (3, 1_000_000, 2, 311),
    ]
    assert "id 2 at 57600 bit/s" in found.details
    assert found.hello is None


@pytest.mark.parametrize("speeds", [(0, 1, 2), (3, 4, 5), (6, 6, 6)])
def test_every_speed_is_tried(servos: ServoBusEmulator, servo_port: str, speeds: tuple[int, ...]) -> None:
    for servo, speed in enumerate(speeds, 1):
        servos.set_speed(servo, speed)
    found = identify(servo_port)
    assert {s.servo for s in found.servos} == {1, 2, 3}
    assert len({s.speed for s in found.servos}) == len(set(speeds))
    assert len(SERVO_SPEEDS) == 7


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


def test_a_lost_reply_loses_no_servo(servos: ServoBusEmulator, servo_port: str) -> None:
    for servo in (1, 2, 3):
        servos.faults.next_reply("drop", servo)
    assert {(s.servo, s.garbled) for s in identify(servo_port).servos} == {(1, False), (2, False), (3, False)}


def test_identifying_writes_nothing(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.set_speed(2, 1)
    before = written(servos)
    assert len(identify(servo_port).servos) == 3
    assert written(servos) == before


def test_a_board_is_identified_without_changing_its_state(board_port: str) -> None:
    found = identify(board_port)
    assert (found.kind, found.version, found.servos) == ("board", 1, ())
    assert found.hello is not None
    assert (found.hello.rows, found.hello.columns) == (10, 10)
    with BoardLink(board_port) as link:
        assert link.counters.tactile == 0  # the stream was not started
        link.tare()


def test_a_board_of_another_version_is_a_board() -> None:
    packet = encode_packet(Packet(PacketType.POWER, bytes(16)), version=3)
    with PseudoTerminal(Babbler(packet)) as terminal:
        found = identify(terminal.path)
    assert (found.kind, found.version, found.hello) == ("board", 3, None)


@pytest.mark.parametrize(("answer", "kind"), [(b"", "silent"), (b"login: ", "other")])
def test_other_devices_are_reported(answer: bytes, kind: str) -> None:
    with PseudoTerminal(Babbler(answer)) as terminal:
        found = identify(terminal.path, speeds=(1_000_000, 57600))
    assert found.kind == kind
    assert found.servos == ()


@pytest.mark.parametrize("scan", [True, False])
def test_the_servo_driver_on_the_board_reports_swapped_cables(board_port: str, scan: bool) -> None:
    with pytest.raises(WrongDevice, match="swap the two cables") as caught:
        ServoBus(BusSettings(port=board_port)).open(scan)
    assert (caught.value.expected, caught.value.port) == ("the servos", board_port)
    assert isinstance(caught.value, ConnectionError)
    with BoardLink(board_port) as link:  # the port is free again
        link.ping()


@pytest.mark.parametrize("speed", [1, 3])
def test_the_board_driver_on_the_servos_reports_swapped_cables(
    servos: ServoBusEmulator, servo_port: str, speed: int
) -> None:
    for servo in (1, 2, 3):
        servos.set_speed(servo, speed)
    with pytest.raises(WrongDevice, match="swap the two cables") as caught:
        BoardLink(servo_port).open()
    assert caught.value.found == "the servos"
    assert identify(servo_port).kind == "servos"


@pytest.mark.parametrize(
    ("opened", "error"),
    [
        (lambda port: BoardLink(port).open(), NoAnswer),
        (lambda port: ServoBus(BusSettings(port=port)).open(scan=False), HandshakeError),
    ],
)
def test_silence_is_not_taken_for_swapped_cables(opened: Callable[[str], None], error: type[Exception]) -> None:
    with PseudoTerminal(Babbler(b"")) as terminal, pytest.raises(error):
        opened(terminal.path)


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
