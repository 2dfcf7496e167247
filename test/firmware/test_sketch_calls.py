# SPDX-License-Identifier: Apache-2.0
"""The sketch's calls of the Arduino core: pins, probe, the servos' line, the link, the watchdog."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from .build import FIRMWARE, make, once

FORM = "arm/wired-servos1-usb0"
LOW, HIGH, OUTPUT = 0, 1, 1


def compile_sketch(build: Path) -> None:
    """Compile the core in C, and the sketch with everything wired in C++ with a core that records every call."""
    make(build, f"{build}/{FORM}/opencm904.ino")
    folder, source = build / FORM, FIRMWARE / "deltacharger_board" / "src"
    flags = ["-g", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    subprocess.run([os.environ.get("CC", "cc"), "-std=c99", *flags, "-c", *source.glob("*.c")], cwd=build, check=True)
    sources = [*folder.glob("*.cpp"), Path(__file__).with_name("pins.cpp"), "-x", "c++", folder / "opencm904.ino"]
    includes = [*(f"-I{path}" for path in (FIRMWARE / "stub", source, folder)), "-include", "Arduino.h"]
    objects = ["-x", "none", *build.glob("*.o"), "-o", build / "sketch"]
    subprocess.run(["c++", "-std=gnu++11", *flags, *includes, *sources, *objects], check=True)


class Sketch:
    """The sketch on a core that records every call."""

    def __init__(self, folder: Path) -> None:
        self.process = subprocess.Popen(
            [folder / "sketch"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        wiring = (folder / FORM / "board_wiring.h").read_text()
        self.pins = {name: int(pin) for name, pin in re.findall(r"PIN_(\w+) = (\d+);", wiring)}

    def ask(self, line: str) -> tuple[int, list[str]]:
        """Execute a command and return its result and the calls that it caused."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(line + "\n")
        calls: list[str] = []
        while not (answer := self.process.stdout.readline()).startswith("done"):
            assert answer, f"the sketch died of '{line}'"
            calls.append(answer.strip())
        result = int(answer.split()[1])
        assert result >= 0, f"'{line}' is no command"
        return result, calls

    def calls(self, line: str) -> list[str]:
        """Execute a command and return the calls that it caused."""
        return self.ask(line)[1]


@pytest.fixture
def sketch() -> Iterator[Sketch]:
    sketch = Sketch(once("calls", "c++", compile_sketch))
    yield sketch
    sketch.process.communicate(timeout=10.0)
    assert sketch.process.returncode == 0


def test_every_output_is_off_before_it_is_enabled_and_stays_off(sketch: Sketch) -> None:
    calls = sketch.calls("setup")
    for name in ("CONTACTOR", "PRECHARGE", "PROBE"):
        pin = sketch.pins[name]
        assert calls.index(f"pin {pin} {LOW}") < calls.index(f"mode {pin} {OUTPUT}")
        assert f"pin {pin} {HIGH}" not in calls
    assert {call for call in calls if call.startswith("pwm")} == {f"pwm {sketch.pins['LIMIT']} 0"}
    assert calls[0] == f"pin {sketch.pins['CONTACTOR']} {LOW}"
    assert not [call for _ in range(50) for call in sketch.calls("loop") if call.endswith(f" {HIGH}") and "pin" in call]


def test_outputs_go_off_first_and_the_contactor_on_last(sketch: Sketch) -> None:
    contactor, precharge = sketch.pins["CONTACTOR"], sketch.pins["PRECHARGE"]
    assert sketch.calls("drive 1 1 0")[-2:] == [f"pin {precharge} {HIGH}", f"pin {contactor} {HIGH}"]
    calls = sketch.calls("drive 0 0 0")
    assert calls[:2] == [f"pin {contactor} {LOW}", f"pin {precharge} {LOW}"]
    assert f"pin {contactor} {HIGH}" not in calls


def test_the_probe_waits_even_if_the_clock_steps_back(sketch: Sketch) -> None:
    """micros() can step back by a millisecond if a tick interrupts it."""
    settle = 100_000
    sketch.calls("counts 100")
    sketch.calls("now 5000")
    assert sketch.calls("probe") == [f"pin {sketch.pins['PROBE']} {HIGH}"]
    for now in (5000, 4000, 4999, 5000 + settle - 1):
        sketch.calls(f"now {now}")
        assert sketch.ask("probed") == (0, [])
    sketch.calls(f"now {5000 + settle}")
    assert sketch.ask("probed") == (1, [f"pin {sketch.pins['PROBE']} {LOW}"])


def test_the_servos_line_is_released_after_the_last_bit(sketch: Sketch) -> None:
    calls = sketch.calls("setup")
    assert calls.index("bus connector 1") < calls.index("bus begin 1000000")
    assert calls.index("listen") < calls.index("bus begin 1000000")
    assert "speak" not in calls
    assert sketch.ask("send 20") == (20, ["speak", "bus write 20", "bus flush", "listen"])


def test_sending_to_the_servos_takes_half_a_millisecond_at_most(sketch: Sketch) -> None:
    for speed, most in ((9_600, 1), (57_600, 2), (1_000_000, 50), (4_500_000, 100)):
        assert sketch.ask(f"speed {speed}") == (1, [f"bus begin {speed}"])
        assert sketch.ask("send 128")[0] == most
        assert most == 1 or most * 10 / speed <= 0.5e-3


def test_a_speed_that_the_uart_does_not_support_changes_nothing(sketch: Sketch) -> None:
    for speed in (0, 9_599, 4_500_001, 2**32 - 1):
        assert sketch.ask(f"speed {speed}") == (0, [])


def test_the_link_never_gets_more_than_fits(sketch: Sketch) -> None:
    sketch.calls("setup")
    for room in (0, 1, 5, 127):
        sketch.calls(f"room {room}")
        written = [int(call.split()[2]) for call in sketch.calls("loop") if call.startswith("link write")]
        assert all(1 <= size <= room for size in written)
        assert bool(written) == (room > 0)


def test_the_watchdog_is_reloaded_until_the_bootloader_uses_it(sketch: Sketch) -> None:
    sketch.calls("setup")
    sketch.calls("loop")
    assert sketch.ask("fed")[0] == 1
    sketch.calls("watchdog 10")
    sketch.calls("loop")
    assert sketch.ask("fed")[0] == 0
