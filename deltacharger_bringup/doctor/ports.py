# SPDX-License-Identifier: Apache-2.0
"""Checks of what is plugged in: serial ports (exist, open, are free) and the camera (USB, libraries, topics)."""

from __future__ import annotations

import contextlib
import grp
import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from deltacharger_bringup.doctor.findings import Finding, failed, hint, ok, wrong
from deltacharger_core.machine import BAUD_RATE

RULES = "config/udev/99-deltacharger.rules"
_RULES_ADVICE = f"install {RULES}, see docs/hardware.md"
_SLOW_LATENCY = 2e-3  # s; above it 100 Hz with three servos is impossible
_MYRIAD = "03e7"
"""USB vendor of the camera's processor, before and after boot."""
_INSTEAD = "give the coordinates with `deltacharger dock --x-mm --y-mm --z-mm`, or the key 'goal' of the scene"


def examine_port(part: str, path: str) -> Iterator[Finding]:
    """Open and close a port and yield the findings. Sends nothing.

    Args:
        part: for the findings, e.g. "servo port".
        path: of the port.

    Yields:
        the findings; the port can be used if none is wrong.
    """
    from deltacharger_driver.errors import PortBusy, PortDenied, PortError, PortMissing
    from deltacharger_driver.ports import open_serial

    try:
        open_serial(path, BAUD_RATE).close()
    except PortMissing as error:
        yield failed(part, error, _other_ports())
    except PortDenied as error:
        yield failed(part, error, _group_advice(path))
    except PortBusy as error:
        if error.reason:
            advice = "end that program; if it is this running charger, see its /diagnostics instead"
            yield wrong(part, f"{path}: in use by {error.reason}", advice)
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


def _other_ports() -> str:
    ports = candidates()
    if not ports:
        return "plug the adapter in; this machine has no serial adapter (see lsusb, dmesg)"
    return f"plug it in, or give the right name; ports of this machine: {', '.join(ports)}"


def _group_advice(path: str) -> str:
    try:
        group = grp.getgrgid(os.stat(path).st_gid).gr_name
    except (OSError, KeyError):
        return "add yourself to the group that owns the port, usually dialout, and log in again"
    return f"sudo usermod -aG {group} $USER, then log in again; or {_RULES_ADVICE}"


def _improvements(part: str, path: str, target: str) -> Iterator[Finding]:
    """Yield possible improvements of a working port."""
    from deltacharger_driver.ports import latency_timer

    latency = latency_timer(path)
    if latency > _SLOW_LATENCY:
        text = f"{path}: the adapter delays received bytes by {latency * 1e3:.0f} ms"
        yield hint(part, f"{text}; the servos' 100 Hz need 1 ms", _RULES_ADVICE)
    name = Path(target).name
    if path == target and name.startswith(("ttyUSB", "ttyACM")):
        yield hint(
            part, f"{path}: the number depends on the order of plugging in", f"{_RULES_ADVICE}, for a fixed name"
        )


def examine_camera(publishers: int | None, devices: Path = Path("/sys/bus/usb/devices")) -> Iterator[Finding]:
    """Yield the findings for a camera. None is wrong, because coordinates can replace it.

    Args:
        publishers: of color/image_raw in the charger's ROS domain; None if unknown.
        devices: the kernel's folder of USB devices.
    """
    if find_spec("cv2") is None:
        remedy = "pip install 'deltacharger[vision]', or python3-opencv; without it " + _INSTEAD
        yield hint("camera", "OpenCV, which electrode_detector_node needs, is not installed", remedy)
    if find_spec("depthai") is None:
        remedy = "pip install 'deltacharger[oak]' for camera_node with an OAK-D; other cameras do not need it"
        yield hint("camera", "depthai, the library of OAK-D cameras, is not installed", remedy)
    if _on_usb(devices):
        yield ok("camera", "an OAK camera is on USB")
    else:
        yield hint("camera", "no OAK camera is on USB", "plug it in, if possible directly into USB 3")
    if publishers:
        yield ok("camera", f"{publishers} publisher{'s' if publishers > 1 else ''} of color/image_raw")
    elif publishers is not None:
        remedy = "start camera_node, or the camera's own driver; or " + _INSTEAD
        yield hint("camera", "no publisher of color/image_raw", remedy)


def _on_usb(devices: Path) -> bool:
    for vendor in devices.glob("*/idVendor"):
        with contextlib.suppress(OSError):  # it was unplugged
            if vendor.read_text().strip() == _MYRIAD:
                return True
    return False
