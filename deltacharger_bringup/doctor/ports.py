# SPDX-License-Identifier: Apache-2.0
"""Can a serial port be opened, and if not, why: absent, forbidden, held by whom, not a serial port at all."""

from __future__ import annotations

import grp
import os
from collections.abc import Iterator
from pathlib import Path

from deltacharger_bringup.doctor.findings import Finding, failed, hint, ok, wrong
from deltacharger_core.machine import BAUD_RATE

RULES = "config/udev/99-deltacharger.rules"
_RULES_ADVICE = f"install {RULES} as docs/hardware.md says"
_SLOW_LATENCY = 2e-3  # s; above it 100 Hz with three servos is out of reach


def examine_port(part: str, path: str) -> Iterator[Finding]:
    """Open and close a port and say what came of it. Sends nothing.

    Args:
        part: for the findings, e.g. "servo port".
        path: of the port.

    Yields:
        what was found; the port can be used where none of it is wrong.
    """
    from deltacharger_driver.errors import PortBusy, PortDenied, PortError, PortMissing
    from deltacharger_driver.serial_open import open_serial

    try:
        open_serial(path, BAUD_RATE).close()
    except PortMissing as error:
        yield failed(part, error, _what_there_is())
    except PortDenied as error:
        yield failed(part, error, _group_advice(path))
    except PortBusy as error:
        who = ", ".join(holders(path))
        if who:
            advice = "end that program; where it is this charger at work, look at its /diagnostics instead"
            yield wrong(part, f"{path}: in use by {who}", advice)
        else:
            yield failed(part, error, f"another user has it: sudo lsof {path} names the program")
    except PortError as error:
        yield failed(part, error)
    else:
        target = os.path.realpath(path)
        yield ok(part, f"{path} opens" + (f" (it is {target})" if target != path else ""))
        yield from _habits(part, path, target)


def same_device(first: str, second: str) -> bool:
    """Return whether two paths lead to one device."""
    return os.path.realpath(first) == os.path.realpath(second)


def candidates() -> list[str]:
    """Return the serial ports of this machine's adapters, with what they say of themselves."""
    from serial.tools.list_ports import comports

    found = []
    for port in sorted(comports()):
        identity = f"{port.vid:04x}:{port.pid:04x} {port.product or ''}".strip() if port.vid is not None else ""
        found.append(f"{port.device}{f' ({identity})' if identity else ''}")
    return found


def holders(path: str) -> list[str]:
    """Return the processes that hold a port, as far as this user may see; those that locked it, where any did.

    Args:
        path: of the port, or of a link to it.
    """
    target = os.path.realpath(path)
    locked: list[str] = []
    opened: list[str] = []
    for process in sorted(Path("/proc").glob("[0-9]*"), key=lambda folder: int(folder.name)):
        descriptors = [link for link in _links(process / "fd") if _target(link) == target]
        if descriptors:
            name = _name(process)
            opened.append(name)
            if any("lock:" in _text(process / "fdinfo" / link.name) for link in descriptors):
                locked.append(name)
    return locked or opened


def _what_there_is() -> str:
    there = candidates()
    if not there:
        return "plug the adapter in; this machine has no serial adapter at all (lsusb, dmesg)"
    return f"plug it in, or give the right name; this machine has {', '.join(there)}"


def _group_advice(path: str) -> str:
    try:
        number = os.stat(path).st_gid
        group = grp.getgrgid(number).gr_name
        members = grp.getgrgid(number).gr_mem
    except (OSError, KeyError):
        return "add yourself to the group that owns the port, usually dialout, and log in again"
    user = os.environ.get("USER", "")
    if user in members and number not in os.getgroups():
        return f"you are in the group {group} since your last login: log in again"
    return f"sudo usermod -aG {group} $USER, then log in again; or {_RULES_ADVICE}"


def _habits(part: str, path: str, target: str) -> Iterator[Finding]:
    """Yield what is worth changing about a port that works."""
    from deltacharger_driver.servos.port import latency_timer

    latency = latency_timer(path)
    if latency > _SLOW_LATENCY:
        text = f"{path}: the adapter holds received bytes back for {latency * 1e3:.0f} ms"
        yield hint(part, f"{text}; the servos' 100 Hz need 1 ms", _RULES_ADVICE)
    name = Path(target).name
    if path == target and name.startswith(("ttyUSB", "ttyACM")):
        yield hint(
            part, f"{path}: the number depends on the order of plugging in", f"{_RULES_ADVICE}, for a lasting name"
        )
    if name.startswith("ttyACM") and "ModemManager" in {_text(process / "comm").strip() for process in _processes()}:
        yield hint(part, f"{path}: ModemManager may speak to it after every plugging in", _RULES_ADVICE)


def _processes() -> list[Path]:
    return list(Path("/proc").glob("[0-9]*"))


def _links(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _target(link: Path) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return ""


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""


def _name(process: Path) -> str:
    """Return a process as a person knows it: its command line, shortened, and its number."""
    command = _text(process / "cmdline").replace("\0", " ").strip() or _text(process / "comm").strip()
    shown = command if len(command) <= 80 else command[:77] + "..."
    return f"'{shown}' (process {process.name})"
