# SPDX-License-Identifier: Apache-2.0
"""What the doctor finds: a part, how bad it is, what it is, and how to mend it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "hint", "wrong"]

_PACKAGES = {"serial": "pyserial", "yaml": "pyyaml", "dynamixel_sdk": "dynamixel-sdk", "rclpy": "ros-rclpy[fastrtps]"}
"""Name of a module → name of the package that brings it, where they differ."""


@dataclass(frozen=True)
class Finding:
    """One sentence about one part.

    Attributes:
        part: e.g. "servo 2".
        level: ok; hint = works, but look at it; wrong = the charger will not work.
        message: what was found.
        remedy: what to do; empty where nothing is to be done.
    """

    part: str
    level: Level
    message: str
    remedy: str = ""


def ok(part: str, message: str) -> Finding:
    """Return that a part is as it should be."""
    return Finding(part, "ok", message)


def hint(part: str, message: str, remedy: str = "") -> Finding:
    """Return something worth knowing that keeps nothing from working."""
    return Finding(part, "hint", message, remedy)


def wrong(part: str, message: str, remedy: str) -> Finding:
    """Return something that keeps the charger from working."""
    return Finding(part, "wrong", message, remedy)


def checked(part: str, check: Callable[[], Iterable[Finding]]) -> list[Finding]:
    """Return the findings of a check; one that breaks off is a finding itself, after those that it made before.

    Args:
        part: named where the check breaks off.
        check: gives the findings, possibly one by one.
    """
    found: list[Finding] = []
    try:
        for finding in check():
            found.append(finding)
    except ImportError as error:
        found.append(wrong(part, f"cannot be checked: {error}", install(error.name or "")))
    except Exception as error:
        found.append(_broken_off(part, error))
    return found


def _broken_off(part: str, error: Exception) -> Finding:
    """Return what ended a check; the driver's errors say by themselves what is wrong and what to do."""
    if type(error).__module__.startswith("deltacharger_driver."):
        return failed(part, error)
    problem = f"the check broke off: {type(error).__name__}: {error}"
    return wrong(part, problem, "mend what it names and run the doctor again")


def failed(part: str, error: Exception, advice: str = "") -> Finding:
    """Return an error of the driver as a finding.

    Args:
        part: where it happened.
        error: its message ends with "; advice".
        advice: takes the place of the message's own.
    """
    what, _, own = str(error).rpartition("; ")
    return wrong(part, what or own, advice or own)


def install(module: str) -> str:
    """Return how to get a module that is missing."""
    top = module.split(".")[0]
    package = _PACKAGES.get(top, top)
    if not package:
        return "install the charger again: pip install ."
    rosdep = "DELTACHARGER_EXTRAS=all rosdep install --from-paths src --ignore-src"
    return f"pip install '{package}', or on a ROS installation: {rosdep}"
