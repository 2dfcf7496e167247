# SPDX-License-Identifier: Apache-2.0
"""Checks of this computer: versions, interfaces, ROS settings, serial ports and the camera.

A wrong library can end or hang the process that loads it. So ROS is checked by `main` in a separate process, which may
do so: python -m deltacharger_bringup.doctor.environment. It prints lines of JSON: the step that begins, and its
findings. With `--alone` it does not search for chargers.
"""

import contextlib
import grp
import importlib
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from deltacharger_bringup.doctor.findings import Finding, failed, hint, install, ok, wrong
from deltacharger_core import environment, streams
from deltacharger_core.machine import BAUD_RATE

RULES = "config/udev/99-deltacharger.rules"
_RULES_ADVICE = f"install {RULES}, see docs/hardware.md"
_SLOW_LATENCY = 2e-3  # s; above it 100 Hz with three servos is impossible
_MYRIAD = "03e7"
"""USB vendor of the camera's processor, before and after boot."""
_INSTEAD = "give the coordinates with `deltacharger dock --x-mm --y-mm --z-mm`, or the key 'goal' of the scene"
_MODULES = ("numpy", "yaml", "serial", "dynamixel_sdk")
_RANGES = ("", "SUBNET", "LOCALHOST", "SYSTEM_DEFAULT")
_LONGEST_PROBE = 60.0  # s; a loaded computer takes 10 s to load ROS
_ALONE = "--alone"
_ADVICE = {
    "rclpy": "in a venv: pip install 'ros-rclpy[fastrtps]'; on a ROS installation: source its setup.bash",
    "ros version": f"use {environment.RUNS_ON}",
    "interfaces": "build them: pip install ., or colcon build and source install/setup.bash",
    "numpy and ROS": "build the interfaces again with the numpy that is installed now: "
    "pip install --no-build-isolation .",
    "ros middleware": "unset RMW_IMPLEMENTATION or install that middleware; check ROS_DOMAIN_ID and the network",
}
"""What to do about each step."""
_LOOK = 3.3  # s; after a missed announcement of a charger the next comes 3 s later
_MATCH = 1.0  # s until the actions of a charger whose topic was found are found too
_STEP = 0.05  # s


def examine_versions() -> Iterator[Finding]:
    """Yield the version of Python, and whether each library loads, without ROS."""
    yield ok("python", f"{'.'.join(map(str, sys.version_info[:3]))} at {sys.executable}")
    for module in _MODULES:
        try:
            importlib.import_module(module)
        except Exception as error:
            yield wrong(module, f"cannot be loaded: {str(error).strip().splitlines()[0]}", install(module))
        else:
            yield ok(module, "is installed")


def examine_settings() -> Iterator[Finding]:
    """Yield the findings for the environment variables of ROS."""
    problem = environment.domain_problem()
    if problem:
        what, _, remedy = problem.partition("; ")
        yield wrong("ros domain", what, remedy)
    else:
        given = "" if os.environ.get("ROS_DOMAIN_ID") else " (ROS_DOMAIN_ID is not set)"
        yield ok("ros domain", f"{environment.domain()}{given}")
    chosen = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if chosen not in _RANGES:
        text = f"with ROS_AUTOMATIC_DISCOVERY_RANGE '{chosen}' nodes do not find each other"
        yield wrong("ros discovery", text, f"unset it, or set it to one of {', '.join(_RANGES[1:])}")
    yield ok("ros security", f"nodes started here are open to {environment.openness()}")


class RosProbe:
    """Check ROS in a separate process, in parallel with other checks.

    Attributes:
        images: number of publishers of images; None if unknown. Set by `examine`.
    """

    def __init__(self) -> None:
        command = [sys.executable, "-m", "deltacharger_bringup.doctor.environment"]
        variables = dict(os.environ)
        if environment.domain_problem():
            command.append(_ALONE)
            variables["ROS_DOMAIN_ID"] = "0"
        self.images: int | None = None
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=variables
        )

    def close(self) -> None:
        """End the process, finished or not."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()

    def examine(self) -> Iterator[Finding]:
        """Wait for the process and yield its findings."""
        try:
            out, err = self._process.communicate(timeout=_LONGEST_PROBE)
            problem = f"the process ended with code {self._process.returncode}: {_last_line(err)}"
        except subprocess.TimeoutExpired:
            self._process.kill()
            out, _ = self._process.communicate()
            problem = f"it took more than {_LONGEST_PROBE:.0f} s"
        begun = next(iter(_ADVICE))
        for line in out.splitlines():
            said: dict[str, Any] = json.loads(line)
            begun = said.get("begins", begun)
            self.images = said.get("images", self.images)
            if "part" in said:
                yield Finding(**said)
        if begun:
            cause = _cause(begun, problem)
            yield wrong(cause, problem, f"start in a new shell with one ROS installation only; then {_ADVICE[cause]}")


def _last_line(text: str) -> str:
    """Return the last line of a process's output, without colours."""
    lines = re.sub(r"\x1b\[[0-9;]*m", "", text).strip().splitlines()
    return lines[-1] if lines else "no output"


def main() -> int:
    """Probe step by step."""
    steps = (_rclpy, _version, _interfaces, _exchange_arrays, _look_around)
    step = ""
    try:
        for step, check in zip(_ADVICE, steps, strict=True):
            _print(begins=step)
            for finding in check():
                _print(**asdict(finding))
    except Exception as error:
        lines = str(error).strip().splitlines() or [type(error).__name__]
        cause = _cause(step, lines[0])
        _print(**asdict(wrong(cause, f"{type(error).__name__}: {lines[0]}", _ADVICE[cause])))
    _print(begins="")
    os._exit(0)  # the middleware's threads must not delay the report


def _print(**values: Any) -> None:
    streams.write(json.dumps(values), sys.stdout)


def _cause(step: str, problem: str) -> str:
    """Return the step that caused a problem; an earlier step may have reported it."""
    for cause, word in (("numpy and ROS", "numpy"), ("ros middleware", "rmw")):
        if word in problem.lower():
            return cause
    return step


def _rclpy() -> Iterator[Finding]:
    import rclpy

    yield ok("rclpy", f"loaded from {os.path.dirname(os.path.dirname(str(rclpy.__file__)))}")


def _version() -> Iterator[Finding]:
    importlib.import_module("rclpy.experimental.events_executor")
    yield from ()


def _interfaces() -> Iterator[Finding]:
    """Load the compiled part of every interface."""
    count = 0
    for kind in ("msg", "srv", "action"):
        module = importlib.import_module(f"deltacharger.{kind}")
        for name, interface in vars(module).items():
            if isinstance(interface, type) and hasattr(interface, "__import_type_support__"):
                interface.__import_type_support__()
                count += "_" not in name  # Dock_Goal is part of Dock
    yield ok("interfaces", f"{count} messages, services and actions are built and loaded")


def _exchange_arrays() -> Iterator[Finding]:
    """Pass numpy arrays through the compiled interfaces; this fails with another ABI of numpy."""
    import numpy as np
    from deltacharger.msg import ServoState, TactileFrame
    from geometry_msgs.msg import PoseWithCovariance
    from rclpy.serialization import deserialize_message, serialize_message

    sent = PoseWithCovariance(covariance=np.arange(36.0))
    received: Any = deserialize_message(serialize_message(sent), PoseWithCovariance)
    if not np.array_equal(received.covariance, sent.covariance):
        raise RuntimeError("an array was changed by serialisation")
    deserialize_message(serialize_message(TactileFrame(left=[1.0] * 100)), TactileFrame)
    deserialize_message(serialize_message(ServoState(position=[1.0] * 3)), ServoState)
    yield ok("numpy and ROS", "arrays are compatible")


def _look_around() -> Iterator[Finding]:
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.utilities import get_rmw_implementation_identifier

    context = Context()
    rclpy.init(context=context, args=[])
    node = Node("charger_doctor", context=context, enable_rosout=False, start_parameter_services=False)
    yield ok("ros middleware", f"{get_rmw_implementation_identifier()} runs")
    if _ALONE in sys.argv:
        return
    end = time.monotonic() + _LOOK
    chargers: list[str] = []
    while not chargers and time.monotonic() < end:
        time.sleep(_STEP)
        topics = dict(node.get_topic_names_and_types())
        chargers = sorted(
            name.removesuffix("/docking_state") or "/"
            for name, types in topics.items()
            if name.endswith("/docking_state") and types == ["deltacharger/msg/DockingState"]
        )
    yield running(chargers, next(filter(None, (_silence(name, context) for name in chargers)), ""))
    names = [name for name, _ in node.get_topic_names_and_types() if name.endswith("/color/image_raw")]
    _print(images=sum(node.count_publishers(name) for name in names))


def running(chargers: list[str], silent: str) -> Finding:
    """Return the finding about chargers by their namespaces, one of which may not answer: why, and what to do."""
    domain = environment.domain()
    if silent:
        what, _, remedy = silent.partition(": ")
        return wrong("charger", what, remedy)
    if chargers:
        text = f"a charger runs in ROS domain {domain}, namespace {', '.join(chargers)}"
        return hint("charger", text, "stop it before you start another one there; it has opened the ports of its scene")
    return ok("charger", f"none runs in ROS domain {domain}")


def _silence(namespace: str, context: Any) -> str:
    """Return why nothing is heard of a charger's actions; '' if they answer, or there are none."""
    from deltacharger_core.ros.client import ChargerClient, ClientError

    try:
        ChargerClient(namespace, context).wait_until_it_answers(_MATCH)
    except ClientError as error:
        return str(error)
    return ""


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


if __name__ == "__main__":
    raise SystemExit(main())
