# SPDX-License-Identifier: Apache-2.0
"""Checks of versions, interfaces and ROS settings of this computer."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from deltacharger_bringup.doctor.findings import Finding, hint, install, ok, wrong
from deltacharger_bringup.doctor.ros_probe import ALONE
from deltacharger_core import environment

_OLDEST_PYTHON = (3, 10)
_MODULES = ("numpy", "yaml", "serial", "dynamixel_sdk")
_DISTRIBUTIONS = {"yaml": "PyYAML", "serial": "pyserial", "dynamixel_sdk": "dynamixel-sdk"}
_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
_LONGEST_PROBE = 60.0  # s; a loaded computer takes 10 s to load ROS


def examine_versions() -> Iterator[Finding]:
    """Yield the versions of Python and of each library, without ROS."""
    running = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info < _OLDEST_PYTHON:
        yield wrong("python", f"{running} at {sys.executable}", "install Python 3.10 or later and build again")
    else:
        yield ok("python", f"{running} at {sys.executable}")
    for module in _MODULES:
        yield _library(module)


def _library(module: str) -> Finding:
    name = _DISTRIBUTIONS.get(module, module)
    try:
        __import__(module)
    except Exception as error:
        return wrong(name, f"cannot be loaded: {str(error).strip().splitlines()[0]}", install(module))
    try:
        return ok(name, version(name))
    except PackageNotFoundError:
        return ok(name, "unknown version")


def examine_settings() -> Iterator[Finding]:
    """Yield the findings for the environment variables of ROS."""
    problem = environment.domain_problem()
    if problem:
        what, _, remedy = problem.partition("; ")
        yield wrong("ros domain", what, remedy)
    else:
        given = "" if os.environ.get("ROS_DOMAIN_ID") else " (ROS_DOMAIN_ID is not set)"
        yield ok("ros domain", f"{environment.domain()}{given}")
    yield _range()
    yield ok("ros security", f"nodes started here are open to {environment.openness()}")
    if os.environ.get("ROS_LOCALHOST_ONLY"):
        text = "ROS_LOCALHOST_ONLY is set, which is deprecated"
        yield hint("ros discovery", text, "use ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST")
    yield from _prefixes()


def _range() -> Finding:
    chosen = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    part = "ros discovery"
    if not chosen:
        return ok(
            part, "ROS_AUTOMATIC_DISCOVERY_RANGE is not set; ROS uses SUBNET, a scene the value of its key `network`"
        )
    if chosen not in _RANGES:
        text = f"ROS_AUTOMATIC_DISCOVERY_RANGE is '{chosen}', unknown to ROS"
        return wrong(part, text, f"set it to one of {', '.join(_RANGES)}")
    if chosen == "OFF":
        return wrong(part, "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: nodes do not find each other", "unset it")
    return ok(part, f"ROS_AUTOMATIC_DISCOVERY_RANGE is {chosen}")


def _prefixes() -> Iterator[Finding]:
    """Yield whether ROS finds this package by AMENT_PREFIX_PATH."""
    part = "ros prefix"
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    index = Path("share/ament_index/resource_index/packages/deltacharger")
    having = [prefix for prefix in prefixes if (prefix / index).exists()]
    missing = [str(prefix) for prefix in prefixes if not prefix.is_dir()]
    if not prefixes:
        yield wrong(
            part, "AMENT_PREFIX_PATH is not set", "source install/setup.bash of the workspace, or build with make"
        )
    elif not having:
        shown = os.environ["AMENT_PREFIX_PATH"]
        advice = "source install/setup.bash of the charger's workspace; in a venv: unset AMENT_PREFIX_PATH"
        yield wrong(part, f"no prefix of AMENT_PREFIX_PATH has this package: {shown}", advice)
    else:
        yield ok(part, f"the package is in {having[0]}")
    if missing:
        yield hint(part, f"AMENT_PREFIX_PATH contains missing folders: {', '.join(missing)}", "start in a new shell")


class RosProbe:
    """Check ROS in a separate process, in parallel with other checks."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "deltacharger_bringup.doctor.ros_probe"]
        self._domain_works = not environment.domain_problem()
        if not self._domain_works:
            command.append(ALONE)
        variables = dict(os.environ) if self._domain_works else {**os.environ, "ROS_DOMAIN_ID": "0"}
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=variables
        )
        self._report: dict[str, Any] = {}

    def close(self) -> None:
        """End the process, finished or not."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()

    def images(self) -> int | None:
        """Return the number of publishers of images; None if unknown. Call after `examine`."""
        count = self._report.get("images")
        return int(count) if count is not None and self._domain_works else None

    def examine(self) -> Iterator[Finding]:
        """Wait for the process and yield its findings."""
        try:
            out, err = self._process.communicate(timeout=_LONGEST_PROBE)
            problem = f"the process ended with code {self._process.returncode}: {_last_line(err)}"
        except subprocess.TimeoutExpired:
            self._process.kill()
            out, _ = self._process.communicate()
            problem = f"it took more than {_LONGEST_PROBE:.0f} s"
        lines = out.strip().splitlines()
        report = self._report = json.loads(lines[-1]) if lines else {"step": "rclpy", "error": ""}
        yield from self._reached(report)
        if report["step"]:
            crashed = not report["error"]
            problem = report["error"] or problem
            cause = _cause(report["step"], problem)
            advice = f"start in a new shell with one ROS installation only; then {_ADVICE[cause]}"
            yield wrong(_STEPS[cause], problem, advice if crashed else _ADVICE[cause])

    def _reached(self, report: dict[str, Any]) -> Iterator[Finding]:
        """Yield the successful steps of the probe."""
        if "rclpy" in report:
            yield ok("rclpy", f"loaded from {report['rclpy']}")
        if "interfaces" in report:
            yield ok("interfaces", f"{report['interfaces']} messages, services and actions are built and loaded")
        if "numpy" in report:
            yield ok("numpy and ROS", "arrays are compatible")
        if "chargers" in report:
            yield ok("ros middleware", f"{report['rmw']} runs")
            if self._domain_works:
                yield _running(report["chargers"], report["silent"])


_STEPS = {
    "rclpy": "rclpy",
    "version": "ros version",
    "interfaces": "interfaces",
    "numpy": "numpy and ROS",
    "middleware": "ros middleware",
}
_ADVICE = {
    "rclpy": "in a venv: pip install 'ros-rclpy[fastrtps]'; on a ROS installation: source its setup.bash",
    "version": f"use {environment.RUNS_ON}",
    "interfaces": "build them: pip install ., or colcon build and source install/setup.bash",
    "numpy": "build the interfaces again with the numpy that is installed now: pip install --no-build-isolation .",
    "middleware": "unset RMW_IMPLEMENTATION or install that middleware; check ROS_DOMAIN_ID and the network",
}


def _cause(step: str, problem: str) -> str:
    """Return the step that caused a problem; an earlier step may have reported it."""
    for cause, word in (("numpy", "numpy"), ("middleware", "rmw")):
        if word in problem.lower():
            return cause
    return step


def _last_line(text: str) -> str:
    """Return the last line of a process's output, without colours."""
    lines = re.sub(r"\x1b\[[0-9;]*m", "", text).strip().splitlines()
    return lines[-1] if lines else "no output"


def _running(chargers: list[str], silent: str) -> Finding:
    domain = environment.domain()
    if silent:
        what, _, remedy = silent.partition(": ")
        return wrong("charger", what, remedy)
    if chargers:
        text = f"a charger runs in ROS domain {domain}, namespace {', '.join(chargers)}"
        return hint("charger", text, "stop it before you start another one there; it has opened the ports of its scene")
    return ok("charger", f"none runs in ROS domain {domain}")
