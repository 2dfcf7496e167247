# SPDX-License-Identifier: Apache-2.0
"""Performance of the driver while the charger charges beside a busy core, in one long run.

Each node of the simulated scene and the emulated hardware run in separate processes; another process spins at ordinary
priority. After docking the benchmark counts tactile frames and servo states, compares the stamp of each frame with the
sampling time of the emulated board, records the heartbeats that reach the board, and monitors contactor and CPU. If the
contactor opens without a command, this is counted and the charger docks again.

- Stamps are ROS time. They are converted to the monotonic clock of the emulator by the difference of both clocks at
  reception. Sampling time = due time of the board's timer, as in the packet. The delay of the emulator's real sampling
  is a separate figure.
- The gaps between heartbeats give the openings that other limits would cause: gaps longer than the limit per hour, and
  the upper bound of their rate with 95 % confidence (Poisson).

python lab/benchmarks/driver_long.py [--seconds 600] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import sys
import threading
import time
import tty
from array import array
from pathlib import Path
from time import monotonic
from typing import Any

import driver_processes as processes
import numpy as np
from driver_processes import CannotMeasure, CpuMeter
from driver_record import evaluate

from deltacharger_core import environment

environment.prepare()
environment.isolate()

SETTLE = 5.0  # s between docking and measuring
PERIOD = 0.5  # s between two checks of the contactor
LINE = 0.01  # s between two bytes that measure the delay of a pseudo-terminal
REPORT = 10.0  # s between two lines of progress
ATTEMPTS = 3  # to dock


def emulate(folder: Path) -> None:
    """Emulate the simulated scene's hardware and record it until stdin ends."""
    from deltacharger_bringup.scenes.scene import load_scene
    from deltacharger_driver.board.protocol import PacketType
    from deltacharger_driver.ports import PseudoTerminal
    from deltacharger_sim.emulators.board import BoardEmulator
    from deltacharger_sim.emulators.servo_bus import ServoBusEmulator
    from deltacharger_sim.world import SharedWorld

    processes.take_priority()
    scene = load_scene("simulated")
    assert scene.simulation is not None
    samples, beats, openings = array("d"), array("d"), array("d")

    class World(SharedWorld):
        def drive(self, outputs: Any) -> None:
            super().drive(outputs)
            if not outputs.contactor:
                openings.append(time.monotonic())

    class Recorded(BoardEmulator):
        def _heartbeat(self, packet: Any, now: float) -> None:
            super()._heartbeat(packet, now)
            beats.extend((now, self.contactor_commanded))

        def _queue(self, type: Any, time: float, *more: Any) -> None:
            if type is PacketType.TACTILE:
                samples.extend((self._sequences[type], time, monotonic()))
            super()._queue(type, time, *more)

    seed, plant = scene.simulation.seed, World(scene.simulation.build_world())
    board = Recorded(plant, seed=seed)
    record = {"samples": samples, "beats": beats, "openings": openings, "line": array("d")}
    threading.Thread(target=watch_line, args=(record["line"],), daemon=True).start()
    servos = ServoBusEmulator(plant, seed=seed)
    with PseudoTerminal(servos, folder / "servo") as cable, PseudoTerminal(board, folder / "board"):
        servos.line_speed = cable.speed
        processes.serve(
            {
                "look": lambda: {"closed": board.contactor_commanded, "fault": board.fault},
                "record": lambda: {name: values.tolist() for name, values in record.items()},
            }
        )


def watch_line(record: array[float]) -> None:
    """Record time and delay of bytes through a pseudo-terminal: a delay by the kernel that no real board has."""
    master, slave = os.openpty()
    tty.setraw(slave)
    for processor in itertools.cycle(sorted(os.sched_getaffinity(0))):  # each has workers of its own for that
        time.sleep(LINE)
        os.sched_setaffinity(0, {processor})  # of this thread
        sent = time.monotonic()
        os.write(master, b"x")
        os.read(slave, 1)
        now = time.monotonic()
        record.extend((now, now - sent))


class Listener:
    """Records all messages of the driver while `listening`.

    Attributes:
        frames: sequence, device time (us) and stamp (s, monotonic) of each tactile frame.
        states: stamp (s, monotonic) of each servo state.
        docking: the last docking_state.
        values: of /diagnostics, by the entry's name.
    """

    def __init__(self, node: Any) -> None:
        from deltacharger.msg import DockingState, ServoState, TactileFrame
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        from deltacharger_core.ros.qos import STATE

        self.listening = False
        self.docking = DockingState()
        self.frames, self.states = array("d"), array("d")
        self.values: dict[str, dict[str, str]] = {}
        patient = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)  # CPU time may be scarce
        node.create_subscription(TactileFrame, "tactile_frame", self._on_frame, patient)
        node.create_subscription(ServoState, "servo_state", self._on_state, QoSProfile(depth=500))
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        node.create_subscription(DockingState, "docking_state", lambda state: setattr(self, "docking", state), STATE)

    def _on_frame(self, message: Any) -> None:
        if self.listening:
            self.frames.extend((message.sequence, message.device_time_us, _monotonic(message.header.stamp)))

    def _on_state(self, message: Any) -> None:
        if self.listening:
            self.states.append(_monotonic(message.header.stamp))

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            self.values[status.name.rpartition(": ")[2]] = {value.key: value.value for value in status.values}

    def wait_until_idle(self) -> str:
        """Wait until docking_node is idle and return its last error."""
        end = time.monotonic() + processes.PATIENCE
        while self.docking.state != self.docking.STATE_IDLE and time.monotonic() < end:
            time.sleep(PERIOD)
        return str(self.docking.error_message)

    def counter(self, part: str, key: str) -> float:
        """Return a counter of /diagnostics; NaN if it is missing."""
        return float(self.values.get(part, {}).get(key, "nan"))


def _monotonic(stamp: Any) -> float:
    """Return a stamp on the monotonic clock, s, by the current difference of both clocks."""
    for _ in range(5):
        before, now, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if after - before < 10_000:  # else this thread was interrupted in between
            break
    return 1e-9 * float(stamp.sec * 1_000_000_000 + stamp.nanosec - now + (before + after) // 2)


class Watch:
    """Monitors the contactor during the run and prints progress."""

    def __init__(self, hardware: processes.Role, listener: Listener, seconds: float) -> None:
        self._hardware, self._listener, self._seconds = hardware, listener, seconds
        self.openings: list[dict[str, Any]] = []
        self.charged = 0.0  # s

    def run(self) -> None:
        """Check the contactor until the time is over; dock again if it opened."""
        began = checked = reported = time.monotonic()
        while time.monotonic() - began < self._seconds:
            time.sleep(PERIOD)
            state, now = self._hardware.ask("look"), time.monotonic()
            if state["closed"]:
                self.charged += now - checked
            else:
                why = self._listener.wait_until_idle()
                self.openings.append({"at": now - began, "fault": state["fault"], "message": why})
                processes.progress(f"contactor opened without command, fault {state['fault']}: {why}; docking again")
                try:
                    dock(self._listener)
                except CannotMeasure as error:
                    processes.progress(f"ending early: {error}")
                    return
            checked = time.monotonic()
            if now - reported >= REPORT:
                reported = now
                self._report(now - began)

    def _report(self, elapsed: float) -> None:
        frames = len(self._listener.frames) // 3
        lost = self._listener.frames[-3] - self._listener.frames[0] + 1 - frames if frames else 0
        processes.progress(
            f"{elapsed:.0f}/{self._seconds:.0f} s: {frames} frames, {lost:.0f} lost, "
            f"{len(self._listener.states)} servo states, {len(self.openings)} openings, load {os.getloadavg()[0]:.1f}"
        )


def dock(listener: Listener) -> None:
    """Dock and charge; try again after a failure, which is not measured here."""
    for left in reversed(range(ATTEMPTS)):
        try:
            listener.wait_until_idle()
            processes.charge()
            return
        except CannotMeasure as error:
            processes.progress(f"{error}; attempts left: {left}")
    raise CannotMeasure("the charger did not start to charge")


def run(seconds: float) -> dict[str, Any]:
    """Return the record of both sides."""
    import rclpy

    from deltacharger_bringup.scenes.scene import load_scene

    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(processes.folder())
        hardware = stack.enter_context(processes.Role(__file__, "--emulate", str(folder)))
        ports = {name: str(folder / name) for name in ("servo", "board")}
        nodes = stack.enter_context(processes.nodes_of(load_scene("simulated"), ports))
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        listener = Listener(node := rclpy.create_node("benchmark"))
        stack.enter_context(processes.spinning(node))
        processes.progress("docking")
        dock(listener)
        stack.enter_context(processes.busy())
        time.sleep(SETTLE)
        counters = ("lost_tactile", "board link"), ("late_cycles", "servo bus")
        before = {key: listener.counter(part, key) for key, part in counters}
        meter = CpuMeter({**{name: each.pid for name, each in nodes.items()}, "emulated hardware": hardware.pid})
        watch, began = Watch(hardware, listener, seconds), time.monotonic()
        listener.listening = True
        watch.run()
        listener.listening = False
        ended, percent = time.monotonic(), meter.percent()
        time.sleep(1.1)  # for the diagnostics of the last second
        return {
            "asked": seconds,
            "seconds": ended - began,
            "span": (began, ended),
            "cpu_percent": percent,
            "load": os.getloadavg()[0],
            "openings": watch.openings,
            "charged": watch.charged,
            "counters": {key: listener.counter(part, key) - before[key] for key, part in counters},
            "frames": np.array(listener.frames).reshape(-1, 3),
            "states": np.array(listener.states),
            **{key: np.array(value) for key, value in hardware.ask("record").items() if key != "openings"},
        }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0, help="time to measure while charging")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--save", type=Path, help="also write the raw record to this file, .npz")
    parser.add_argument("--emulate", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.emulate:
        emulate(arguments.emulate)
        return 0
    try:
        record = run(arguments.seconds)
        if arguments.save:
            np.savez(arguments.save, **{key: record[key] for key in ("frames", "states", "samples", "beats", "span")})
        figures = evaluate(record)
    except CannotMeasure as error:
        processes.progress(f"nothing measured: {error}")
        return 1
    plain = {key: record[key] for key in ("seconds", "cpu_percent", "load", "openings", "charged", "counters")}
    processes.print_figures(figures, arguments.json, **plain)
    return 0


if __name__ == "__main__":
    sys.exit(main())
