# SPDX-License-Identifier: Apache-2.0
"""Checks of versions, interfaces and ROS settings of this computer."""

from __future__ import annotations

import importlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from deltacharger_bringup.doctor.findings import Finding, install, ok, wrong
from deltacharger_bringup.doctor.ros_probe import ADVICE, ALONE, cause_of
from deltacharger_core import environment

_MODULES = ("numpy", "yaml", "serial", "dynamixel_sdk")
_RANGES = ("", "SUBNET", "LOCALHOST", "SYSTEM_DEFAULT")
_LONGEST_PROBE = 60.0  # s; a loaded computer takes 10 s to load ROS


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
        command = [sys.executable, "-m", "deltacharger_bringup.doctor.ros_probe"]
        variables = dict(os.environ)
        if environment.domain_problem():
            command.append(ALONE)
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
        begun = next(iter(ADVICE))
        for line in out.splitlines():
            said: dict[str, Any] = json.loads(line)
            begun = said.get("begins", begun)
            self.images = said.get("images", self.images)
            if "part" in said:
                yield Finding(**said)
        if begun:
            cause = cause_of(begun, problem)
            yield wrong(cause, problem, f"start in a new shell with one ROS installation only; then {ADVICE[cause]}")


def _last_line(text: str) -> str:
    """Return the last line of a process's output, without colours."""
    lines = re.sub(r"\x1b\[[0-9;]*m", "", text).strip().splitlines()
    return lines[-1] if lines else "no output"
