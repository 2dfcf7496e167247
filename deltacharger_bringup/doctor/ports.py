# SPDX-License-Identifier: Apache-2.0
"""Checks of a serial port: whether it exists, may be opened, is free (else who uses it) and is a serial port."""

from __future__ import annotations

import grp
import os
from collections.abc import Iterator
from pathlib import Path

from deltacharger_bringup.doctor.findings import Finding, failed, hint, ok, wrong
from deltacharger_core.machine import BAUD_RATE

RULES = "config/udev/99-deltacharger.rules"
_RULES_ADVICE = f"install {RULES}, see docs/hardware.md"
_SLOW_LATENCY = 2e-3  # s; above it 100 Hz with three servos is impossible


def examine_port(part: str, path: str) -> Iterator[Finding]:
    """Open and close a port and yield the findings. Sends nothing.

    Args:
        part: for the findings, e.g. "servo port".
        path: of the port.

    Yields:
        the findings; the port can be used if none is wrong.
    """
    from deltacharger_driver.errors import PortBusy, PortDenied, PortError, PortMissing
    from deltacharger_driver.serial_open import open_serial

    try:
        open_serial(path, BAUD_RATE).close()
    except PortMissing as error:
        yield failed(part, error, _other_ports())
    except PortDenied as error:
        yield failed(part, error, _group_advice(path))
    except PortBusy as error:
        who = ", ".join(holders(path))
        if who:
            advice = "end that program; if it is this running charger, see its /diagnostics instead"
            yield wrong(part, f"{path}: in use by {who}", advice)
        else:
            yield failed(part, error, f"another user has opened it: sudo lsof {path} names the program")
    except PortError as error:
        yield failed(part, error)
    else:
        target = os.path.realpath(path)
        yield ok(part, f"{path} opens" + (f" (it is {target})" if target != path else ""))
        yield from _improvements(part, path, target)


def same_device(first: str, second: str) -> bool:
    """Return whether two paths lead to one device."""
    return os.path.realpath(first) == os.path.realpath(second)


def candidates() -> list[str]:
    """Return the serial ports of this machine's adapters, with their USB identity."""
    from serial.tools.list_ports import comports

    found = []
    for port in sorted(comports()):
        identity = f"{port.vid:04x}:{port.pid:04x} {port.product or ''}".strip() if port.vid is not None else ""
        found.append(f"{port.device}{f' ({identity})' if identity else ''}")
    return found


def holders(path: str) -> list[str]:
    """Return the visible processes that have opened a port; if any locked it, only these.

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


def _other_ports() -> str:
    ports = candidates()
    if not ports:
        return "plug the adapter in; this machine has no serial adapter (see lsusb, dmesg)"
    return f"plug it in, or give the right name; ports of this machine: {', '.join(ports)}"


def _group_advice(path: str) -> str:
    try:
        number = os.stat(path).st_gid
        group = grp.getgrgid(number).gr_name
        members = grp.getgrgid(number).gr_mem
    except (OSError, KeyError):
        return "add yourself to the group that owns the port, usually dialout, and log in again"
    user = os.environ.get("USER", "")
    if user in members and number not in os.getgroups():
        return f"you were added to the group {group} after your last login: log out and in again"
    return f"sudo usermod -aG {group} $USER, then log in again; or {_RULES_ADVICE}"


def _improvements(part: str, path: str, target: str) -> Iterator[Finding]:
    """Yield possible improvements of a working port."""
    from deltacharger_driver.servos.port import latency_timer

    latency = latency_timer(path)
    if latency > _SLOW_LATENCY:
        text = f"{path}: the adapter delays received bytes by {latency * 1e3:.0f} ms"
        yield hint(part, f"{text}; the servos' 100 Hz need 1 ms", _RULES_ADVICE)
    name = Path(target).name
    if path == target and name.startswith(("ttyUSB", "ttyACM")):
        yield hint(
            part, f"{path}: the number depends on the order of plugging in", f"{_RULES_ADVICE}, for a fixed name"
        )
    if name.startswith("ttyACM") and "ModemManager" in {_text(process / "comm").strip() for process in _processes()}:
        yield hint(part, f"{path}: ModemManager may write to it after it is plugged in", _RULES_ADVICE)


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
    """Return the shortened command line of a process, and its number."""
    command = _text(process / "cmdline").replace("\0", " ").strip() or _text(process / "comm").strip()
    shown = command if len(command) <= 80 else command[:77] + "..."
    return f"'{shown}' (process {process.name})"
