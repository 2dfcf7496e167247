# SPDX-License-Identifier: Apache-2.0
"""A finding of the doctor: part, level, message and remedy."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "hint", "wrong"]

_PACKAGES = {"serial": "pyserial", "yaml": "pyyaml", "dynamixel_sdk": "dynamixel-sdk", "rclpy": "ros-rclpy[fastrtps]"}
"""Name of a module → name of its package, if they differ."""


@dataclass(frozen=True)
class Finding:
    """One sentence about one part.

    Attributes:
        part: e.g. "servo 2".
        level: ok; hint = works, but should be checked; wrong = the charger will not work.
        message: the observation.
        remedy: what to do; empty if nothing.
    """

    part: str
    level: Level
    message: str
    remedy: str = ""


def ok(part: str, message: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(part, "ok", message)


def hint(part: str, message: str, remedy: str = "") -> Finding:
    """Return a finding that does not stop the charger from working."""
    return Finding(part, "hint", message, remedy)


def wrong(part: str, message: str, remedy: str) -> Finding:
    """Return a finding that stops the charger from working."""
    return Finding(part, "wrong", message, remedy)


def checked(part: str, check: Callable[[], Iterable[Finding]]) -> list[Finding]:
    """Return the findings of a check; its exception becomes the last finding.

    Args:
        part: for the finding about an exception.
        check: yields the findings.
    """
    found: list[Finding] = []
    try:
        for finding in check():
            found.append(finding)
    except ImportError as error:
        found.append(wrong(part, f"cannot be checked: {error}", install(error.name or "")))
    except Exception as error:
        found.append(_crashed(part, error))
    return found


def _crashed(part: str, error: Exception) -> Finding:
    """Return an exception as a finding; errors of the driver already name problem and remedy."""
    if type(error).__module__.startswith("deltacharger_driver."):
        return failed(part, error)
    problem = f"the check failed: {type(error).__name__}: {error}"
    return wrong(part, problem, "correct this and run the doctor again")


def failed(part: str, error: Exception, advice: str = "") -> Finding:
    """Return an error of the driver as a finding.

    Args:
        part: where it happened.
        error: its message ends with "; advice".
        advice: replaces the advice of the message.
    """
    what, _, own = str(error).rpartition("; ")
    return wrong(part, what or own, advice or own)


def install(module: str) -> str:
    """Return how to install a missing module."""
    top = module.split(".")[0]
    package = _PACKAGES.get(top, top)
    if not package:
        return "install the charger again: pip install ."
    rosdep = "DELTACHARGER_EXTRAS=all rosdep install --from-paths src --ignore-src"
    return f"pip install '{package}', or on a ROS installation: {rosdep}"
