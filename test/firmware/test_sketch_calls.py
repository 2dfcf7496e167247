# SPDX-License-Identifier: Apache-2.0
"""The sketch's calls of the Arduino core: pins, probe, the servos' line, the link, the watchdog."""

import math
import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_core.machine import Port, port_of

from .build import FIRMWARE, make, once

FORM = "arm/wired-servos1-usb0"
LOW, HIGH, OUTPUT = 0, 1, 1
LOOK, SETTLE = 20_000, 100_000  # us
SCALES = {"TARGET": ("2048", "0.02"), "PROBE_VOLTAGE": ("0", "0.00125"), "PROBE_CURRENT": ("100", "2e-5")}
"""Zero, counts, and V or A per count of the inputs that the probe reads."""


def scale_inputs(wiring: Path) -> None:
    """Fill in the scales of the probe's inputs, of which the form only has pins."""
    text = wiring.read_text()
    for name, (zero, scale) in SCALES.items():
        text, count = re.subn(rf"({name} = {{\d+), .*?}}", rf"\1, {zero}.0f, {float(scale)}f}}", text)
        assert count == 1
    wiring.write_text(text)


def compile_sketch(build: Path) -> None:
    """Compile the core in C, and the sketch with everything wired in C++ with a core that records every call."""
    make(build, f"{build}/{FORM}/opencm904.ino")
    scale_inputs(build / FORM / "board_wiring.h")
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
    outputs = {f"pwm {sketch.pins[name]} 0" for name in ("LIMIT", "VOLTAGE")}
    assert {call for call in calls if call.startswith("pwm")} == outputs
    assert calls[0] == f"pin {sketch.pins['CONTACTOR']} {LOW}"
    assert not [call for _ in range(50) for call in sketch.calls("loop") if call.endswith(f" {HIGH}") and "pin" in call]


def test_outputs_go_off_first_and_the_contactor_on_last(sketch: Sketch) -> None:
    contactor, precharge = sketch.pins["CONTACTOR"], sketch.pins["PRECHARGE"]
    assert sketch.calls("drive 1 1 0")[-2:] == [f"pin {precharge} {HIGH}", f"pin {contactor} {HIGH}"]
    calls = sketch.calls("drive 0 0 0")
    assert calls[:2] == [f"pin {contactor} {LOW}", f"pin {precharge} {LOW}"]
    assert f"pin {contactor} {HIGH}" not in calls


def probe(sketch: Sketch, port: str, began: int = 5000) -> tuple[float, float, list[str]]:
    """Probe a port, polling every millisecond, and return ohm, V, and the calls without the result."""
    sketch.calls(f"now {began}")
    sketch.calls(f"port {port}")
    calls = sketch.calls("probe")
    for now in range(began, began + 200_001, 1000):
        sketch.calls(f"now {now}")
        ended, more = sketch.ask("probed")
        calls += [call for call in more if not call.startswith("found")]
        if ended:
            ohm, volt = (float(number) for number in more[-1].split()[1:])
            return ohm, volt, calls
    raise AssertionError("the probe did not end in 200 ms")


@pytest.mark.parametrize(("voltage", "port"), [(24.0, Port.LIVE), (-24.0, Port.REVERSED)])
def test_a_port_with_its_own_voltage_is_never_driven(sketch: Sketch, voltage: float, port: Port) -> None:
    ohm, volt, calls = probe(sketch, f"live {voltage} 0")
    assert f"pin {sketch.pins['PROBE']} {HIGH}" not in calls
    assert math.isnan(ohm)
    assert volt == pytest.approx(voltage, abs=0.02)
    assert port_of(ohm, volt) is port


PORTS = [  # as measured by 5 V through 100 ohm for 100 ms
    ("capacitor 2200e-6 0", Port.DEAD, 57.5, 1.83),
    ("resistor 47000 0", Port.DEAD, 47_000.0, 0.0),
    ("resistor 0.05 0", Port.SHORT, 0.05, 0.0),
    ("resistor 100000 0", Port.OPEN, math.inf, 0.0),  # 0.05 mA
    ("diode 24 0", Port.OPEN, math.inf, 0.0),
]


@pytest.mark.parametrize(("kind", "port", "ohm", "volt"), PORTS)
def test_a_dead_port_is_driven_and_judged_at_the_end_of_its_curve(
    sketch: Sketch, kind: str, port: Port, ohm: float, volt: float
) -> None:
    found = probe(sketch, kind)
    assert found[0] == pytest.approx(ohm, rel=0.2)
    assert found[1] == pytest.approx(volt, abs=0.02)
    assert port_of(*found[:2]) is port
    pin = sketch.pins["PROBE"]
    assert found[2].index(f"pin {pin} {HIGH}") < len(found[2]) - 1
    assert found[2][-1] == f"pin {pin} {LOW}"


@pytest.mark.parametrize(("voltage", "port"), [(24.0, Port.LIVE), (-24.0, Port.REVERSED)])
def test_a_battery_that_connects_during_the_driven_look_is_live(sketch: Sketch, voltage: float, port: Port) -> None:
    """A bounce of the contacts, or a target that wakes up by the probe's voltage."""
    ohm, volt, _ = probe(sketch, f"live {voltage} {5000 + LOOK + 50_000}")
    assert volt == pytest.approx(voltage, abs=0.02)
    assert port_of(ohm, volt) is port


def test_the_servos_line_is_released_after_the_last_bit(sketch: Sketch) -> None:
    calls = sketch.calls("setup")
    assert calls.index("bus connector 1") < calls.index("bus begin 1000000")
    assert calls.index("listen") < calls.index("bus begin 1000000")
    assert "speak" not in calls
    assert sketch.ask("send 20") == (20, ["speak", "bus write 20", "bus flush", "listen"])


def test_the_watchdog_is_reloaded_until_the_bootloader_uses_it(sketch: Sketch) -> None:
    sketch.calls("setup")
    sketch.calls("loop")
    assert sketch.ask("fed")[0] == 1
    sketch.calls("watchdog 10")
    sketch.calls("loop")
    assert sketch.ask("fed")[0] == 0
