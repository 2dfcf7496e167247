# SPDX-License-Identifier: Apache-2.0
"""One cable for servos and pads: bytes pass the board unchanged, and faults behind it are reported."""

from __future__ import annotations

import contextlib
import math
import random
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from deltacharger.msg import ServoState
from rclpy.node import Node
from std_srvs.srv import SetBool

from deltacharger_core import runtime
from deltacharger_core.environment import domain
from deltacharger_driver.board import contactor_guard
from deltacharger_driver.board.keeper import BoardKeeper
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.pass_through import PassThrough
from deltacharger_driver.board.protocol import LONGEST_SERVO, Packet, PacketDecoder, PacketType, encode_packet
from deltacharger_driver.board.tactile_node import TactileNode
from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.serial_open import open_serial
from deltacharger_driver.servos import servo_node
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.servo_node import ServoNode
from deltacharger_driver.servos.snapshot import BusSettings
from deltacharger_ros.node_support import StartupError

from ..behind_board import BehindEmulator
from ..nodes import call, options
from ..waiting import DEADLINE, host, wait_until

pytestmark = pytest.mark.ros

ANGLES, CURRENTS = (-0.7, -0.5, 0.2), (0.3, 0.3, 0.3)


class Echo:
    """A device on the bus that returns received bytes, and records them."""

    def __init__(self) -> None:
        self.received = b""

    def receive(self, data: bytes, now: float) -> bytes:
        self.received += data
        return data

    def poll(self, now: float) -> bytes:
        return b""

    def next_event(self, now: float) -> float:
        return math.inf


def test_bytes_pass_unchanged(tmp_path: Path) -> None:
    echo, back = Echo(), b""
    tmp_path.chmod(0o700)
    with PseudoTerminal(BoardEmulator(BenchPlant(), servos=echo)) as cable:
        link = BoardLink(cable.path, on_servo=lambda data: port.take(data))
        port = PassThrough(link, tmp_path / "servos")
        assert link.open().carries_servos
        port.open()
        with open_serial(str(port.path), 1_000_000) as line:
            source = random.Random(24)
            for size in (1, 10, LONGEST_SERVO, LONGEST_SERVO + 1, 1000):
                sent = source.randbytes(size)
                line.write(sent)
                back = b""

                def came(sent: bytes = sent) -> bool:
                    nonlocal back
                    back += line.read(4096)
                    return len(back) >= len(sent)

                wait_until(came)
                assert back == sent
                assert echo.received.endswith(sent)
        port.close()
        assert not port.path.is_symlink()
        link.close()


def test_a_host_that_does_not_use_the_bus_receives_nothing_from_it() -> None:
    class Noisy(Echo):
        def poll(self, now: float) -> bytes:
            return b"\xff"

    board, decoder = BoardEmulator(BenchPlant(), servos=Noisy()), PacketDecoder()
    packets = decoder.feed(board.poll(0.0) + board.receive(encode_packet(Packet(PacketType.HELLO)), 0.1))
    packets += decoder.feed(board.poll(1.0))
    assert {PacketType(packet.type) for packet in packets} == {PacketType.HELLO, PacketType.ACK, PacketType.POWER}
    board.receive(encode_packet(Packet(PacketType.SERVO, b"\0")), 1.1)
    assert PacketType.SERVO in {packet.type for packet in decoder.feed(board.poll(1.2))}


@pytest.mark.parametrize("type", [PacketType.SERVO, PacketType.SERVO_SPEED])
def test_a_board_without_the_bus_refuses_its_packets(type: PacketType) -> None:
    board, decoder = BoardEmulator(BenchPlant()), PacketDecoder()
    board.poll(0.0)
    decoder.feed(board.receive(encode_packet(Packet(type, bytes(4))), 0.1))
    assert board.unknown_types == 1


@pytest.fixture
def behind() -> Iterator[tuple[BehindEmulator, ServoBusEmulator, ServoBus]]:
    """Emulated servos behind an emulated board, and their bus with torque on."""
    emulator = ServoBusEmulator(BenchArm(ANGLES))
    with BehindEmulator(emulator) as terminal:
        emulator.line_speed = terminal.speed
        bus = ServoBus(BusSettings(terminal.path, reply_margin=0.1))
        bus.open()
        bus.enable_torque(CURRENTS)
        yield terminal, emulator, bus
        bus.close()


@pytest.mark.rest
def test_a_late_answer_is_not_taken_for_the_next_request(behind: Any) -> None:
    """The delay exceeds the timeout, so that each answer arrives at the next request."""
    _, emulator, bus = behind
    emulator.faults.delay = 0.15
    seen = [bus.read() for _ in range(10)]
    emulator.faults.delay = 0.0
    for snapshot in seen:
        for angle, valid, truth in zip(snapshot.angle, snapshot.valid, ANGLES, strict=True):
            assert math.isnan(angle) if not valid else angle == pytest.approx(truth, abs=0.01)
    wait_until(lambda: bus.read().complete)


@pytest.mark.rest
def test_a_board_reset_during_a_packet_loses_some_cycles(behind: Any) -> None:
    terminal, emulator, bus = behind
    for _ in range(2):
        terminal.board.reboot(boot_time=0.3)
        wait_until(lambda: not bus.exchange(ANGLES, CURRENTS).complete)
        wait_until(lambda: bus.exchange(ANGLES, CURRENTS).complete)
    assert not terminal.board.contactor_commanded
    assert [emulator.servo(each).table.get("torque_enable") for each in (1, 2, 3)] == [1, 1, 1]  # watchdogs protect


@pytest.mark.rest
@pytest.mark.parametrize("end", ["the lease", "the heartbeat"])
def test_the_contactor_keeps_its_limits_under_continuous_servo_traffic(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str
) -> None:
    monkeypatch.setattr(contactor_guard, "STALE_FRAME", host(contactor_guard.STALE_FRAME))
    beats: list[float] = []
    plant, opened, cycles, over = BenchPlant(), list[float](), list[bool](), threading.Event()
    release = plant.open_contactor
    board = BoardEmulator(plant, servos=ServoBusEmulator(BenchArm(ANGLES)), on_heartbeat=beats.append)
    with (
        PseudoTerminal(board) as cable,
        contextlib.closing(
            BoardKeeper(cable.path, 1_000_000, 120.0, *[lambda *_: None] * 3, tmp_path / "servos")
        ) as keeper,
    ):
        keeper.start()
        wait_until(keeper.servos.path.exists)

        def ask() -> None:
            bus = ServoBus(BusSettings(str(keeper.servos.path)))
            bus.open()
            while not over.is_set():
                cycles.append(bus.exchange(ANGLES, CURRENTS).complete)
                time.sleep(0.002)  # servo_node pauses longer
            bus.close()

        asking = threading.Thread(target=ask)
        asking.start()
        plant.press(20.0)
        wait_until(lambda: len(cycles) > 100)
        keeper.guard.probe()
        keeper.guard.close("test", 0.25)
        plant.open_contactor = lambda ramp: (opened.append(time.monotonic()), release(ramp))  # type: ignore[method-assign]
        for _ in range(10):
            time.sleep(0.05)  # the holder's pace
            keeper.guard.close("test", 0.25)
        renewed = time.monotonic()
        assert not opened
        if end == "the heartbeat":
            keeper.link.stop_heartbeat()
        wait_until(lambda: opened)
        over.set()
        asking.join()
    assert sum(cycles) > 0.9 * len(cycles)
    assert opened[0] - beats[-1] < host(0.1)
    assert opened[0] - renewed < host(0.35)


@pytest.mark.witness
def test_both_nodes_on_one_cable(context: Any, namespace: str, spin: Any) -> None:
    servos = ServoBusEmulator(BenchArm(ANGLES))
    board = BoardEmulator(BenchPlant(), servos=servos)
    servos.line_speed = lambda: board.servos.speed
    with PseudoTerminal(board) as cable:
        spin(TactileNode(**options(context, namespace, port=cable.path)))
        node = spin(ServoNode(**options(context, namespace, port="board", rate=60.0)))
        states: list[ServoState] = []
        node.create_subscription(ServoState, "servo_state", states.append, 10)
        wait_until(lambda: len(states) > 60)
        assert all(list(state.valid) == [True] * 3 for state in states[-30:])
        assert runtime.servos(domain(), namespace).is_symlink()


@pytest.mark.rest
def test_both_nodes_stopped_at_once_leave_the_servos_without_torque(
    context: Any, namespace: str, spin: Any, start: Any
) -> None:
    """tactile_node passes on the last packets of servo_node."""
    arm = BenchArm(ANGLES)
    servos = ServoBusEmulator(arm)
    board = BoardEmulator(BenchPlant(), servos=servos)
    servos.line_speed = lambda: board.servos.speed
    client = spin(Node("client", **options(context, namespace)))
    torque = client.create_client(SetBool, "set_torque")
    with PseudoTerminal(board) as cable:
        nodes = [
            start(
                *(sys.executable, "-m", f"deltacharger_driver.{module}", "--ros-args"),
                *("-r", f"__ns:=/{namespace}", "-p", f"port:={port}"),
            )
            for module, port in (("board.tactile_node", cable.path), ("servos.servo_node", "board"))
        ]
        assert torque.wait_for_service(DEADLINE)
        assert call(torque, SetBool.Request(data=True)).success
        for node in nodes:
            node.process.send_signal(signal.SIGTERM)
        assert [node.end() for node in nodes] == [0, 0]
    assert arm.torque_enabled() == [False] * 3


def test_missing_servos_behind_the_board_are_reported(
    context: Any, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(servo_node, "_BOARD_TIMEOUT", 0.1)
    with pytest.raises(StartupError, match="no servos"):
        ServoNode(**options(context, namespace, port="board"))
