# SPDX-License-Identifier: Apache-2.0
"""The environment that the executables of a venv need, set by themselves where the user has set nothing."""

from __future__ import annotations

import os
import sys
from pathlib import Path

SIMULATION_DOMAIN = 87
"""ROS_DOMAIN_ID of simulated scenes where the user has chosen none: no robot on the default domain 0 hears them."""


LARGEST_DOMAIN = 232
"""Above it the UDP ports of a domain pass 65535."""


def prepare() -> None:
    """Let ROS find this installation; call before the first import of rclpy."""
    prefix = Path(sys.prefix)
    if not os.environ.get("AMENT_PREFIX_PATH") and (prefix / "share" / "ament_index").is_dir():
        os.environ["AMENT_PREFIX_PATH"] = str(prefix)


def isolate() -> None:
    """Keep a simulated scene's traffic on this machine and away from robots, unless the user chose otherwise."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(SIMULATION_DOMAIN))


def domain_problem() -> str:
    """Return what is wrong with ROS_DOMAIN_ID, or ''; ROS itself takes some wrong ones and then hears nobody."""
    text = os.environ.get("ROS_DOMAIN_ID", "")
    try:
        usable = not text or 0 <= int(text) <= LARGEST_DOMAIN
    except ValueError:
        usable = False
    return "" if usable else f"ROS_DOMAIN_ID is '{text}'; give a whole number from 0 to {LARGEST_DOMAIN}, or unset it"


def domain() -> int:
    """Return the ROS domain that nodes of this process join."""
    try:
        return int(os.environ.get("ROS_DOMAIN_ID", "") or 0)
    except ValueError:
        return 0
