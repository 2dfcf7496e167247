# SPDX-License-Identifier: Apache-2.0
"""One cable for servos and pads: bytes pass the board unchanged, and faults behind it are reported."""

from __future__ import annotations

import random
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from deltacharger.msg import ServoState
from rclpy.node import Node
from std_srvs.srv import SetBool

from deltacharger_core import runtime
from deltacharger_core.environment import domain
from deltacharger_core.machine import ChargeLimits
from deltacharger_driver.board.protocol import LONGEST_SERVO, PacketType
from deltacharger_driver.board.tactile_node import TactileNode
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.packets import Packet, PacketDecoder, encode_packet
from deltacharger_driver.ports import open_serial
from deltacharger_driver.servos import servo_node
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.registers import BusSettings
from deltacharger_driver.servos.servo_node import ServoNode
from deltacharger_ros.node_support import StartupError

from ..behind_board import BehindEmulator, BehindFirmware
from ..chargers import patience
from ..emulated_ports import Babbler
from ..marks import rest
from ..nodes import answer, options
from ..plants import BenchArm, BenchPlant
from ..quick import PATIENT_MARGIN
from ..waiting import host, wait_until

pytestmark = pytest.mark.ros

ANGLES, CURRENTS = (-0.7, -0.5, 0.2), (0.3, 0.3, 0.3)


@pytest.mark.parametrize("kind", [BehindEmulator, rest(BehindFirmware)])
def test_bytes_pass_unchanged(kind: type[BehindEmulator]) -> None:
    echo, source = Babbler(), random.Random(24)
    with kind(echo) as terminal, open_serial(terminal.path, 1_000_000) as line:
        for size in (1, 10, LONGEST_SERVO, LONGEST_SERVO + 1, 1000):
            sent, back = source.randbytes(size), bytearray()
            line.write(sent)
            wait_until(lambda back=back, size=size: back.extend(line.read(4096)) or len(back) >= size)
            assert back == sent
            assert echo.received.endswith(sent)
    assert not Path(terminal.path).is_symlink()


def test_a_host_that_does_not_use_the_bus_receives_nothing_from_it() -> None:
    class Noisy(Babbler):
        def poll(self, now: float) -> bytes:
            return b"\xff"

    board, decoder = BoardEmulator(BenchPlant(), servos=Noisy()), PacketDecoder()
    packets = decoder.feed(board.poll(0.0) + board.receive(encode_packet(Packet(PacketType.HELLO)), 0.1))
    packets += decoder.feed(board.poll(1.0))
    assert {PacketType(packet.type) for packet in packets} == {PacketType.HELLO, PacketType.ACK, PacketType.POWER}
    board.receive(encode_packet(Packet(PacketType.SERVO, b"\0")), 1.1)
    assert PacketType.SERVO in {packet.type for packet in decoder.feed(board.poll(1.2))}


def torque_registers(servos: ServoBusEmulator) -> list[int]:
    return [servos.servo(each).table.get("torque_enable") for each in (1, 2, 3)]


@pytest.fixture
def behind() -> Iterator[tuple[BehindEmulator, ServoBusEmulator, ServoBus]]:
    """Emulated servos behind an emulated board, and their bus with torque on."""
    emulator = ServoBusEmulator(BenchArm(ANGLES))
    with patience(), BehindEmulator(emulator) as terminal:
        emulator.line_speed = terminal.speed
        bus = ServoBus(BusSettings(terminal.path, reply_margin=0.1))
        bus.open()
        bus.enable_torque(CURRENTS)
        yield terminal, emulator, bus
        bus.close()


@pytest.mark.rest
def test_a_board_reset_during_a_packet_loses_some_cycles(behind: Any) -> None:
    terminal, emulator, bus = behind
    for _ in range(2):
        terminal.board.reboot(boot_time=0.3)
        wait_until(lambda: not bus.exchange(ANGLES, CURRENTS).complete)
        wait_until(lambda: bus.exchange(ANGLES, CURRENTS).complete)
    assert not terminal.board.contactor_commanded
    assert torque_registers(emulator) == [1, 1, 1]  # watchdogs protect


@pytest.mark.rest
@pytest.mark.parametrize("end", ["the lease", "the heartbeat"])
def test_the_contactor_keeps_its_limits_under_continuous_servo_traffic(behind: Any, end: str) -> None:
    terminal, _, bus = behind
    keeper, plant = terminal._keeper, terminal.plant
    cycles, over = list[bool](), threading.Event()

    def hold() -> float:
        """Hold the lease, end it, and return how long the contactor then took to open."""
        wait_until(lambda: len(cycles) > 100)
        keeper.guard.probe()
        for _ in range(10):
            keeper.guard.close("test", 0.25, limits=ChargeLimits(10.0, 29.4))
            time.sleep(0.05)  # the holder's pace
        keeper.guard.close("test", 0.25, limits=ChargeLimits(10.0, 29.4))
        ended = time.monotonic()
        assert plant.read_power().closed
        if end == "the heartbeat":
            keeper.link.stop_heartbeat()
        wait_until(lambda: not plant.read_power().closed)
        over.set()
        return time.monotonic() - ended

    plant.press(20.0)
    with ThreadPoolExecutor(1) as pool:
        held = pool.submit(hold)
        while not over.is_set() and not held.done():
            cycles.append(bus.exchange(ANGLES, CURRENTS).complete)
            time.sleep(0.002)  # servo_node pauses longer
    assert sum(cycles) > 0.9 * len(cycles)
    assert held.result() < host(0.1 if end == "the heartbeat" else 0.35)


@pytest.mark.witness
def test_both_nodes_on_one_cable(context: Any, namespace: str, spin: Any, one_cable: str) -> None:
    spin(TactileNode(**options(context, namespace, port=one_cable)))
    node = spin(ServoNode(**options(context, namespace, port="board", rate=60.0, reply_margin=PATIENT_MARGIN)))
    states: list[ServoState] = []
    node.create_subscription(ServoState, "servo_state", states.append, 10)
    wait_until(lambda: len(states) > 60)
    assert all(list(state.valid) == [True] * 3 for state in states[-30:])
    assert runtime.servos(domain(), namespace).is_symlink()


@pytest.mark.rest
def test_both_nodes_stopped_at_once_leave_the_servos_without_torque(
    context: Any, namespace: str, spin: Any, start: Any, servos: ServoBusEmulator, one_cable: str
) -> None:
    """tactile_node passes on the last packets of servo_node."""
    client, states = spin(Node("client", **options(context, namespace))), list[ServoState]()
    torque = client.create_client(SetBool, "set_torque")
    client.create_subscription(ServoState, "servo_state", states.append, 10)  # heard after the client is known, too
    nodes = [
        start(
            *(sys.executable, "-m", f"deltacharger_driver.{module}", "--ros-args"),
            *("-r", f"__ns:=/{namespace}", "-p", f"port:={port}", *more),
        )
        for module, port, *more in (
            ("board.tactile_node", one_cable),
            ("servos.servo_node", "board", "-p", f"reply_margin:={PATIENT_MARGIN}"),
        )
    ]
    nodes[1].wait_until(lambda: states and torque.service_is_ready(), "set_torque")
    torque_on = torque.call_async(SetBool.Request(data=True))
    nodes[1].wait_until(torque_on.done, "an answer of set_torque")
    assert answer(torque_on).success
    assert torque_registers(servos) == [1, 1, 1]
    for node in nodes:
        node.process.send_signal(signal.SIGTERM)
    assert [node.end() for node in nodes] == [0, 0]
    assert torque_registers(servos) == [0, 0, 0]


def test_missing_servos_behind_the_board_are_reported(
    context: Any, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(servo_node, "_BOARD_TIMEOUT", 0.1)
    with pytest.raises(StartupError, match="no servos"):
        ServoNode(**options(context, namespace, port="board"))
