# SPDX-License-Identifier: Apache-2.0
"""Environment variables that the executables set for themselves unless the user has set them; the version."""

import importlib.util
import os
import sys
import sysconfig
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import NoReturn

from deltacharger_core import streams

SIMULATION_DOMAIN = 87
"""Default ROS_DOMAIN_ID of simulated scenes: it keeps them apart from robots on the default domain 0."""

RUNS_ON = "ROS 2 Jazzy with rclpy 7.1.4 or newer, or Kilted"
"""Supported ROS versions, as text."""

NEW_SHELL = "start in a new shell, or unset PYTHONPATH, AMENT_PREFIX_PATH and LD_LIBRARY_PATH"
"""What to do if another ROS is sourced."""

LARGEST_DOMAIN = 232
"""The UDP ports of a larger domain would exceed 65535."""

_DOMAIN, _RANGE = "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"
CHOSEN = (_DOMAIN, _RANGE)
"""Variables that decide which programs discover each other."""

_REACHED = {  # rcl treats an unknown value as LOCALHOST
    "OFF": "this process alone",
    "LOCALHOST": "every program on this computer",
    "SUBNET": "every computer of this network",
    "SYSTEM_DEFAULT": "programs that the middleware's profile admits",
}
_PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
_PROFILES_HERE = "DEFAULT_FASTDDS_PROFILES.xml"  # Fast DDS also reads this file from the working directory


class UnsupportedRos(SystemExit):
    """This ROS version is not supported. Ends the program with exit code 2."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.code = 2


def refuse_ros(missing: ImportError) -> NoReturn:
    """Print the supported ROS versions in one line and end the program.

    Executables call this during imports, before their own code can report an error.

    Raises:
        UnsupportedRos: always.
    """
    reason = f"deltacharger does not run on this version of ROS ({missing}); use {RUNS_ON}"
    streams.write(reason, sys.stderr)
    raise UnsupportedRos(reason) from missing


def prepare() -> None:
    """Make this installation visible to ROS; call before the first import of rclpy."""
    prefix = Path(sys.prefix)
    if not os.environ.get("AMENT_PREFIX_PATH") and (prefix / "share" / "ament_index").is_dir():
        os.environ["AMENT_PREFIX_PATH"] = str(prefix)
    announce()


def announce() -> None:
    """Make nodes announce themselves twice a second, unless the user has Fast DDS settings."""
    if not any(os.environ.get(name) for name in _PROFILES) and not Path(_PROFILES_HERE).exists():
        for file in config("fastdds.xml")[:1]:
            os.environ[_PROFILES[0]] = str(file)


def config(name: str) -> list[Path]:
    """Return the existing paths of a file or folder of config/: first the source tree, then each installation."""
    found = [Path(__file__).resolve().parents[1] / "config" / name]
    found += [prefix / "share" / "deltacharger" / "config" / name for prefix in _prefixes()]
    return [path for path in dict.fromkeys(found) if path.exists()]


def _prefixes() -> list[Path]:
    """Return the installations of ROS packages: those that are sourced, then this one."""
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [Path(prefix) for prefix in [*filter(None, sourced), sys.prefix]]


def isolate(variables: MutableMapping[str, str] = os.environ) -> None:
    """Keep a simulated scene on this computer and away from robots, unless the user chose otherwise."""
    reach("localhost", variables)
    variables.setdefault(_DOMAIN, str(SIMULATION_DOMAIN))


def reach(network: str, variables: MutableMapping[str, str] = os.environ) -> None:
    """Set the discovery range from a scene's key `network`, unless the user chose one."""
    if not variables.get(_RANGE):
        variables[_RANGE] = network.upper()


def openness(variables: Mapping[str, str] = os.environ) -> str:
    """Return as text who can command the nodes of this environment."""
    if variables.get("ROS_SECURITY_ENABLE") == "true" and variables.get("ROS_SECURITY_STRATEGY") == "Enforce":
        return "only nodes with a key of this keystore"
    if variables.get("ROS_LOCALHOST_ONLY") == "1":  # rcl then also ignores the peers
        return _REACHED["LOCALHOST"]
    chosen = variables.get(_RANGE) or "SUBNET"
    peers = variables.get("ROS_STATIC_PEERS", "")
    beyond = f" and to {peers}" if peers and chosen not in ("OFF", "SYSTEM_DEFAULT") else ""
    return _REACHED.get(chosen, _REACHED["LOCALHOST"]) + beyond


def problem() -> str:
    """Return why ROS cannot start in this environment and what to do; '' = nothing found.

    Call it before the first import of rclpy, which may end the process.
    """
    return domain_problem() or _middleware_problem() or _mixture()


def _middleware_problem() -> str:
    """Return the error in RMW_IMPLEMENTATION, or ''. rcl ends a process that imports it with code 102."""
    chosen = os.environ.get("RMW_IMPLEMENTATION", "")
    index = [prefix / "share/ament_index/resource_index/rmw_typesupport" for prefix in _prefixes()]
    installed = sorted({file.name for folder in index if folder.is_dir() for file in folder.iterdir()})
    if not chosen or chosen in installed or not installed:
        return ""
    known = " or ".join(name for name in installed if name != "rmw_implementation")
    return f"RMW_IMPLEMENTATION is '{chosen}', which is not installed; unset it, or choose {known}"


def _mixture() -> str:
    """Return the error that another ROS is sourced over the one of this virtual environment, or ''."""
    own, found = Path(sysconfig.get_path("platlib")) / "rclpy", importlib.util.find_spec("rclpy")
    if found is None or found.origin is None or not own.is_dir() or own.samefile(Path(found.origin).parent):
        return ""
    first = Path(found.origin).parents[1]
    return f"another ROS is sourced: rclpy comes from {first}, not from {own.parent}; {NEW_SHELL}"


def domain_problem() -> str:
    """Return the error in ROS_DOMAIN_ID, or ''. ROS accepts some wrong values and then discovers no nodes."""
    text = os.environ.get(_DOMAIN, "")
    try:
        usable = not text or 0 <= int(text) <= LARGEST_DOMAIN
    except ValueError:
        usable = False
    return "" if usable else f"ROS_DOMAIN_ID is '{text}'; give a whole number from 0 to {LARGEST_DOMAIN}, or unset it"


def domain(variables: Mapping[str, str] = os.environ) -> int:
    """Return the ROS domain of this environment's nodes."""
    try:
        return int(variables.get(_DOMAIN, "") or 0)
    except ValueError:
        return 0


def package_version() -> str:
    """Return the version; 'unknown' in a colcon workspace, which installs no metadata."""
    from importlib.metadata import PackageNotFoundError, version  # here, because the import takes 20 ms

    try:
        return version("deltacharger")
    except PackageNotFoundError:
        return "unknown"
