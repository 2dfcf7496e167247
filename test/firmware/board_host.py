# SPDX-License-Identifier: Apache-2.0
"""The firmware's C core as a process, with the interface of the emulated board for the driver's tests."""

from __future__ import annotations

import contextlib
import math
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_sim.emulators.power import StageReading

from ..borrowed import anew, borrowed_tests

READINGS = ("battery", "target", "output", "current", "feedback")
"""What `measured` replaces."""


class BoardHost:
    """`board_host --step`: one line in, one line out; time advances by command only.

    Args:
        program: path of the built program.
        now: us on the board's counter at the start.
        seed: of noise and boot ids.
    """

    def __init__(self, program: Path, now: int = 0, seed: int = 1) -> None:
        command = [program, "--seed", str(seed), "--step", str(now)]
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        self._process = subprocess.Popen(command, text=True, bufsize=1, **pipes)

    def command(self, line: str) -> str:
        """Send a line and return the answer."""
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(line + "\n")
        answer = self._process.stdout.readline()
        assert answer, f"the board died of '{line[:80]}':\n{self._process.stderr.read()}"
        assert not answer.startswith("error"), f"{line[:80]}: {answer}"
        return answer.rstrip("\n")

    def sent(self, line: str) -> bytes:
        """Send a line that advances time and return the bytes sent to the host."""
        return bytes.fromhex(self.command(line).split(" ")[1])

    def state(self) -> dict[str, float]:
        """Return the state of board and bench."""
        _, *pairs = self.command("state").split(" ")
        return {name: float(value) for name, value in (pair.split("=") for pair in pairs)}

    def close(self) -> None:
        """End the process; any output on its standard error, such as a sanitizer's, is a failure."""
        _, errors = self._process.communicate("quit\n" if self._process.poll() is None else None, timeout=10.0)
        assert (self._process.returncode, errors) == (0, "")


class FirmwarePlant:
    """The interface of `BenchPlant` for the bench of the host program.

    Attributes:
        port: "live" is the bench's own target, a battery of `target` V behind `resistance`. A `TargetPort` replaces it.
        probe_result: ohm and V that every probe finds, None = what the target has.

    Args:
        offset: N added to every taxel, as before a tare.
        noise: N standard deviation.
        seed: not used; the board's seed determines the noise.
        clock: not used; the board's time is the bench's.
    """

    def __init__(
        self, offset: float = 0.12, noise: float = 0.02, seed: int = 0, clock: Callable[[], float] | None = None
    ) -> None:
        self.left = np.zeros((ROWS, COLUMNS))
        self.right = np.zeros((ROWS, COLUMNS))
        self.battery = 26.0
        self.target = 24.0
        self.resistance = 2.0
        self.port: Any = "live"
        self.probe_result: tuple[float, float] | None = None
        self.detected = 0
        self.welded = self.dropped = False
        self.measured: dict[str, float] = {}
        self.offset = offset
        self.noise = noise
        self.board: FirmwareBoard | None = None
        self._current, self._seen = 0.0, math.nan
        self._probing = False

    @property
    def modelled(self) -> bool:
        """Whether Python computes the target."""
        return not isinstance(self.port, str)

    def step(self, dt: float, state: dict[str, float], stage_voltage: float) -> None:
        """Advance the modelled target by `dt` s with the board's outputs."""
        touches, closed = not math.isinf(self.resistance), bool(state["contactor"])
        contact = self.resistance if closed else math.inf
        self._current, shown = self.port.step(dt, stage_voltage or state["voltage"], state["limit"], contact)
        self._seen = math.nan if not touches else shown if closed else self.port.undriven
        if state["probe"] and not self._probing and touches:
            self.probe_result = self.port.probe(self.resistance)
        self._probing = bool(state["probe"])

    def press(self, force: float) -> None:
        """Press both pads with `force` N each on the four taxels in the middle."""
        for pad in (self.left, self.right):
            pad[:] = 0.0
            pad[4:6, 4:6] = force / 4.0

    def settings(self) -> dict[str, str]:
        """Return every setting as the host program's command and value."""
        pads = np.stack((self.left, self.right)).astype("<f4").tobytes().hex()
        numbers = {
            name: repr(float(getattr(self, name)))
            for name in ("offset", "noise", "battery", "target", "resistance", "detected")
        }
        measured = self.measured
        if self.modelled:
            numbers["target"] = repr(self._seen)
            measured = {"current": self._current} | measured
        forced = {f"force {name}": str(measured.get(name, "none")) for name in READINGS}
        probe = "none" if self.probe_result is None else "{} {}".format(*self.probe_result)
        return {
            "pads": pads,
            **numbers,
            **forced,
            "probe": probe,
            "welded": f"{self.welded:d}",
            "drop": f"{self.dropped:d}",
        }

    def read_power(self) -> StageReading:
        """Return the readings at the board's present time; the output's voltage is not told."""
        assert self.board is not None
        state = self.board.host.state()
        target = math.nan if math.isinf(self.resistance) else self.target
        return StageReading(self.battery, target, math.nan, state["current"], bool(state["contactor"]), self.detected)


class FirmwareBoard:
    """The firmware with `BoardEmulator`'s methods, for the driver's tests; time is the caller's, in s."""

    program: ClassVar[Path]
    started: ClassVar[list[FirmwareBoard]] = []

    def __init__(
        self,
        plant: FirmwarePlant,
        seed: int | None = None,
        stage: Any = None,
    ) -> None:
        plant.board = self
        self.host = BoardHost(self.program, seed=1 if seed is None else seed)
        self.started.append(self)
        self._plant = plant
        self._known: dict[str, str] = {}
        self._boot_wanted = True
        self._polled = 0
        self._stage_voltage = 0.0 if stage is None else stage.stage_voltage
        if stage is not None:
            self.host.command(f"steps_up {stage.steps_up:d}")
            self.host.command(f"stage_voltage {stage.stage_voltage or math.nan}")
            self.host.command(f"input_fuse {stage.input_fuse}")

    @property
    def contactor_commanded(self) -> bool:
        """Whether a close was accepted and no opening followed."""
        return bool(self.host.state()["commanded"])

    @property
    def fault(self) -> int:
        """The latched fault, 0 = none."""
        return int(self.host.state()["fault"])

    def reboot(self) -> None:
        """Boot at the next poll."""
        self._boot_wanted = True

    def trip(self, fault: int) -> None:
        """Open the power stage at once and latch a fault."""
        self.host.command(f"trip {int(fault)}")

    def set_dead(self, pad: int, row: int, column: int, dead: bool = True) -> None:
        """Make a taxel dead or live: pad 0 is left, 1 right."""
        self.host.command(f"dead {pad} {row} {column} {int(dead)}")

    def receive(self, data: bytes, now: float) -> bytes:
        """Take bytes from the host at `now` and return what the board sends."""
        return self.poll(now) + self.host.sent(f"wire {data.hex()}")

    def poll(self, now: float) -> bytes:
        """Return what the board sends on its own at `now`."""
        sent = b"" if self._boot_wanted or not self._plant.modelled else self._step_plant(round(now * 1e6))
        self._tell_plant()
        self._polled = round(now * 1e6)
        line = f"{'boot' if self._boot_wanted else 'advance'} {self._polled}"
        self._boot_wanted = False
        return sent + self.host.sent(line)

    def _step_plant(self, until: int) -> bytes:
        """Advance board and modelled target, 1 ms a step while it is driven; return what the board sends."""
        sent = b""
        while self._polled < until:
            state = self.host.state()
            step = min(1000, until - self._polled) if state["coil"] or state["precharge"] else until - self._polled
            self._plant.step(1e-6 * step, state, self._stage_voltage)
            self._tell_plant()
            self._polled += step
            sent += self.host.sent(f"advance {self._polled}")
        return sent

    def _tell_plant(self) -> None:
        for name, value in self._plant.settings().items():
            if self._known.get(name) != value:
                self.host.command(f"{name} {value}")
                self._known[name] = value


def on_firmware(name: str) -> dict[str, object]:
    """Return a driver test module's tests and fixtures, with the firmware as board and its bench."""
    return borrowed_tests(anew(name, "tests_on_firmware", BoardEmulator=FirmwareBoard, BenchPlant=FirmwarePlant), set())
