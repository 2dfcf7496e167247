# SPDX-License-Identifier: Apache-2.0
"""The environment that the executables of a venv need, set by themselves where the user has set nothing."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import NoReturn

from deltacharger_core import streams

SIMULATION_DOMAIN = 87
"""ROS_DOMAIN_ID of simulated scenes where the user has chosen none: no robot on the default domain 0 hears them."""

RUNS_ON = "ROS 2 Jazzy with rclpy 7.1.4 or newer, or Kilted"
"""Versions whose rclpy has what the nodes stand on, in words."""

LARGEST_DOMAIN = 232
"""Above it the UDP ports of a domain pass 65535."""

_DOMAIN, _RANGE = "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE"
CHOSEN = (_DOMAIN, _RANGE)
"""The variables by which programs of one computer find each other."""

_REACHED = {  # rcl takes an unknown word as LOCALHOST
    "OFF": "this process alone",
    "LOCALHOST": "every program on this computer",
    "SUBNET": "every computer of this network",
    "SYSTEM_DEFAULT": "whom the profile of the middleware lets in",
}
_PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
_PROFILES_HERE = "DEFAULT_FASTDDS_PROFILES.xml"  # which Fast DDS also reads, where it is in the working directory


class UnsupportedRos(SystemExit):
    """This ROS lacks what the nodes stand on, as its text says; ends a program with code 2."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.code = 2


def refuse_ros(missing: ImportError) -> NoReturn:
    """Say in one line which versions of ROS run, and end the program.

    Executables get here while they import, before code of theirs can catch and tell an error.

    Raises:
        UnsupportedRos: always.
    """
    reason = f"this ROS does not run deltacharger ({missing}); use {RUNS_ON}"
    streams.write(reason, sys.stderr)
    raise UnsupportedRos(reason) from missing


def prepare() -> None:
    """Let ROS find this installation; call before the first import of rclpy."""
    prefix = Path(sys.prefix)
    if not os.environ.get("AMENT_PREFIX_PATH") and (prefix / "share" / "ament_index").is_dir():
        os.environ["AMENT_PREFIX_PATH"] = str(prefix)
    announce()


def announce() -> None:
    """Let nodes tell twice a second that they are there, unless the user has settings of Fast DDS."""
    if not any(os.environ.get(name) for name in _PROFILES) and not Path(_PROFILES_HERE).exists():
        for file in config("fastdds.xml")[:1]:
            os.environ[_PROFILES[0]] = str(file)


def config(name: str) -> list[Path]:
    """Return where a file or folder of config/ is: in the source tree, then in each installation."""
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    found = [Path(__file__).resolve().parents[1] / "config" / name]
    found += [prefix / "share" / "deltacharger" / "config" / name for prefix in [*prefixes, Path(sys.prefix)]]
    return [path for path in dict.fromkeys(found) if path.exists()]


def isolate(variables: MutableMapping[str, str] = os.environ) -> None:
    """Keep a simulated scene's traffic on this machine and away from robots, unless the user chose otherwise."""
    reach("localhost", variables)
    variables.setdefault(_DOMAIN, str(SIMULATION_DOMAIN))


def reach(network: str, variables: MutableMapping[str, str] = os.environ) -> None:
    """Let nodes of this environment reach what a scene's key `network` says, unless the user chose otherwise."""
    if not variables.get(_RANGE):
        variables[_RANGE] = network.upper()


def openness(variables: Mapping[str, str] = os.environ) -> str:
    """Return in words who can command the nodes of this environment."""
    if variables.get("ROS_SECURITY_ENABLE") == "true" and variables.get("ROS_SECURITY_STRATEGY") == "Enforce":
        return "nodes with a key of this keystore alone"
    if variables.get("ROS_LOCALHOST_ONLY") == "1":  # rcl then leaves out the peers, too
        return _REACHED["LOCALHOST"]
    chosen = variables.get(_RANGE) or "SUBNET"
    peers = variables.get("ROS_STATIC_PEERS", "")
    beyond = f" and to {peers}" if peers and chosen not in ("OFF", "SYSTEM_DEFAULT") else ""
    return _REACHED.get(chosen, _REACHED["LOCALHOST"]) + beyond


def domain_problem() -> str:
    """Return what is wrong with ROS_DOMAIN_ID, or ''; ROS itself takes some wrong ones and then hears nobody."""
    text = os.environ.get(_DOMAIN, "")
    try:
        usable = not text or 0 <= int(text) <= LARGEST_DOMAIN
    except ValueError:
        usable = False
    return "" if usable else f"ROS_DOMAIN_ID is '{text}'; give a whole number from 0 to {LARGEST_DOMAIN}, or unset it"


def domain(variables: Mapping[str, str] = os.environ) -> int:
    """Return the ROS domain that nodes of this environment join."""
    try:
        return int(variables.get(_DOMAIN, "") or 0)
    except ValueError:
        return 0
