# SPDX-License-Identifier: Apache-2.0
"""Servos and board without hardware: emulators behind pseudo-terminals, used like the real devices.

First the vendor's dynamixel-sdk pings three emulated MX-64, switches on the first one, moves it by 10° and reads its
position; then one servo loses its supply and does not answer. Then the driver's `BoardLink` greets the emulated board,
tares it, counts the tactile frames of one second while both pads are pressed, and probes the circuit between the
electrodes. Prints each answer. With the paths of real ports, the code controls the robot.
"""

from __future__ import annotations

import threading
import time

from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.samples import TactileSample
from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal

TORQUE_ENABLE, GOAL_POSITION, PRESENT_POSITION = 64, 116, 132  # registers of an MX-64
TEN_DEGREES = 114  # counts, 4096 per turn


def talk_to_servos() -> None:
    emulator = ServoBusEmulator(BenchArm())
    with PseudoTerminal(emulator) as cable:
        print(f"servos on {cable.path}")
        port, packets = PortHandler(cable.path), PacketHandler(2.0)
        port.setBaudRate(1_000_000)  # this also opens the port
        for servo in (1, 2, 3):
            model, _, _ = packets.ping(port, servo)
            print(f"  servo {servo} answers: model {model}")
        before, _, _ = packets.read4ByteTxRx(port, 1, PRESENT_POSITION)
        packets.write1ByteTxRx(port, 1, TORQUE_ENABLE, 1)
        packets.write4ByteTxRx(port, 1, GOAL_POSITION, before + TEN_DEGREES)
        deadline = time.monotonic() + 10.0
        after = before
        while abs(after - before - TEN_DEGREES) > 3 and time.monotonic() < deadline:
            after, _, _ = packets.read4ByteTxRx(port, 1, PRESENT_POSITION)
        print(f"  servo 1 moved by {360.0 * (after - before) / 4096:.0f}°")
        packets.write1ByteTxRx(port, 1, TORQUE_ENABLE, 0)

        emulator.faults.missing = {2}
        _, result, _ = packets.ping(port, 2)
        print(f"  servo 2 without supply: {'answers' if result == COMM_SUCCESS else 'silent'}")
        port.closePort()


def talk_to_the_board() -> None:
    bench = BenchPlant()  # two pads, a battery and a target, without geometry
    frames: list[TactileSample] = []
    with PseudoTerminal(BoardEmulator(bench)) as cable, BoardLink(cable.path, on_tactile=frames.append) as link:
        hello = link.hello()
        print(f"board on {cable.path}: {hello.rows}x{hello.columns} taxels at {hello.rate:.0f} Hz")
        link.tare()
        bench.press(8.0)  # N on each pad
        link.start()
        threading.Event().wait(1.0)
        link.stop()
        left, right = frames[-1].pads.sum(axis=(1, 2))
        print(f"  {len(frames)} frames, left {left:.1f} N, right {right:.1f} N")
        probe = link.probe()
        print(f"  probe: {probe.resistance:.1f} Ω, target at {probe.target_voltage:.1f} V")


if __name__ == "__main__":
    talk_to_servos()
    talk_to_the_board()
