# SPDX-License-Identifier: Apache-2.0
"""Talk to emulated servos and an emulated board, as to real ones.

The vendor's dynamixel-sdk pings three emulated MX-64 and turns the first one by 10°. Then the driver's `BoardLink`
tares the emulated board, reads tactile frames for one second and looks at the port between the electrodes, which
touch nothing yet. The same calls work on real ports, where the arm moves.
"""

import time
from typing import Any

import numpy as np
from dynamixel_sdk import PacketHandler, PortHandler

from deltacharger_core.machine import port_of
from deltacharger_driver.board.link import BoardLink
from deltacharger_sim.charger import simulated_charger, simulation

TORQUE_ENABLE, GOAL_POSITION, PRESENT_POSITION = 64, 116, 132  # registers of an MX-64
TEN_DEGREES = 114  # counts of 4096 a turn


def talk_to_servos(path: str) -> None:
    print(f"servos on {path}")
    port, packets = PortHandler(path), PacketHandler(2.0)
    port.setBaudRate(1_000_000)  # this opens it too
    for servo in (1, 2, 3):
        model, _, _ = packets.ping(port, servo)
        print(f"  servo {servo} answers: model {model}")
    before, _, _ = packets.read4ByteTxRx(port, 1, PRESENT_POSITION)
    packets.write1ByteTxRx(port, 1, TORQUE_ENABLE, 1)
    packets.write4ByteTxRx(port, 1, GOAL_POSITION, before + TEN_DEGREES)
    end, after = time.monotonic() + 10.0, before
    while abs(after - before - TEN_DEGREES) > 20 and time.monotonic() < end:
        after, _, _ = packets.read4ByteTxRx(port, 1, PRESENT_POSITION)
    print(f"  servo 1 moved by {360.0 * (after - before) / 4096:.0f}°")
    packets.write1ByteTxRx(port, 1, TORQUE_ENABLE, 0)
    port.closePort()


def talk_to_the_board(path: str) -> None:
    frames: list[Any] = []
    with BoardLink(path, on_tactile=frames.append) as link:
        hello = link.hello()
        print(f"board on {path}: {hello.rows}x{hello.columns} taxels at {hello.rate:.0f} Hz")
        link.tare()
        link.start()
        time.sleep(1.0)
        link.stop()
        print(f"  {len(frames)} frames, at most {np.nanmax(frames[-1].pads):.1f} N a taxel")  # NaN is a dead taxel
        found = link.probe()
        print(f"  {port_of(found.resistance, found.target_voltage).name} port")


with simulated_charger.SimulatedCharger(simulation.Simulation()) as charger:
    talk_to_servos(charger.servo_port)
    talk_to_the_board(charger.board_port)
