# SPDX-License-Identifier: Apache-2.0
"""Talk to emulated servos and an emulated board, as to real ones.

The vendor's dynamixel-sdk pings three emulated MX-64 and turns the first one by 10°. Then the driver's `BoardLink`
tares the emulated board, reads tactile frames for one second and looks at the port between the electrodes. The same
calls work on real ports, where the arm moves; only `bench` belongs to the emulator.
"""

from __future__ import annotations

import time
from typing import Any

from dynamixel_sdk import PacketHandler, PortHandler

from deltacharger_core.machine import port_of
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.emulators.bench import BenchArm, BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.ports import PseudoTerminal

TORQUE_ENABLE, GOAL_POSITION, PRESENT_POSITION = 64, 116, 132  # registers of an MX-64
TEN_DEGREES = 114  # counts of 4096 a turn


def talk_to_servos() -> None:
    with PseudoTerminal(ServoBusEmulator(BenchArm())) as cable:
        print(f"servos on {cable.path}")
        port, packets = PortHandler(cable.path), PacketHandler(2.0)
        port.setBaudRate(1_000_000)  # this opens it too
        for servo in (1, 2, 3):
            model, _, _ = packets.ping(port, servo)
            print(f"  servo {servo} answers: model {model}")
        before, _, _ = packets.read4ByteTxRx(port, 1, PRESENT_POSITION)
        packets.write1ByteTxRx(port, 1, TORQUE_ENABLE, 1)
        packets.write4ByteTxRx(port, 1, GOAL_POSITION, before + TEN_DEGREES)
        end, after = time.monotonic() + 10.0, before
        while abs(after - before - TEN_DEGREES) > 3 and time.monotonic() < end:
            after, _, _ = packets.read4ByteTxRx(port, 1, PRESENT_POSITION)
        print(f"  servo 1 moved by {360.0 * (after - before) / 4096:.0f}°")
        packets.write1ByteTxRx(port, 1, TORQUE_ENABLE, 0)
        port.closePort()


def talk_to_the_board() -> None:
    bench = BenchPlant()  # two pads, a battery and a target, without geometry
    frames: list[Any] = []
    with PseudoTerminal(BoardEmulator(bench)) as cable, BoardLink(cable.path, on_tactile=frames.append) as link:
        hello = link.hello()
        print(f"board on {cable.path}: {hello.rows}x{hello.columns} taxels at {hello.rate:.0f} Hz")
        link.tare()
        bench.press(8.0)  # N on each pad
        link.start()
        time.sleep(1.0)
        link.stop()
        print("  {} frames, left {:.1f} N, right {:.1f} N".format(len(frames), *frames[-1].pads.sum(axis=(1, 2))))
        found = link.probe()
        print(f"  {port_of(found.resistance, found.target_voltage).name} port, {found.target_voltage:.1f} V")


talk_to_servos()
talk_to_the_board()
