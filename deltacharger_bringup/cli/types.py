# SPDX-License-Identifier: Apache-2.0
"""Types of command-line values; their errors name the value and what is allowed."""

from __future__ import annotations

import argparse
import ipaddress
import math
import re
from collections.abc import Callable
from urllib.parse import urlsplit

from deltacharger_bringup.cli.web_viewer import WebAddress
from deltacharger_core.units import ON_ROBOT


def between(low: float, high: float) -> Callable[[str], float]:
    """Return the type of a finite number from `low` to `high`."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text}' is not a number") from None
        if not math.isfinite(value):
            raise argparse.ArgumentTypeError(f"'{text}' is not finite")
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is outside {low:g} to {high:g}")
        return value

    return number


def integer(low: int, high: int) -> Callable[[str], int]:
    """Return the type of a whole number from `low` to `high`."""

    def number(text: str) -> int:
        if not re.fullmatch(r"[-+]?[0-9]{1,12}", text):
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number")
        if not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"'{text}' is outside {low} to {high}")
        return int(text)

    return number


def namespace(text: str) -> str:
    """Return a ROS namespace without its outer slashes; '' means none."""
    name = text.strip("/")
    if name and not all(part.isidentifier() and part.isascii() for part in name.split("/")):
        raise argparse.ArgumentTypeError(f"'{text}' is not a ROS namespace; use letters, digits and _")
    return name


def web_address(text: str) -> WebAddress:
    """Return an address of this computer, ADDRESS or ADDRESS:PORT."""
    try:
        parts = urlsplit(f"//{text}")
        address = WebAddress(str(ipaddress.ip_address(parts.hostname or "")), parts.port or WebAddress.port)
        if parts.port == 0 or address.port > 65534:
            raise ValueError
        return address
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not an IP address with or without a port, such as 0.0.0.0 or 127.0.0.1:9090"
        ) from None


NOT_NEGATIVE = between(0.0, 2e9)  # range of a Duration's seconds
MILLIMETRES = between(-1e3 * ON_ROBOT, 1e3 * ON_ROBOT)
DEGREES = between(-90.0, 90.0)
SEED = integer(0, 2**32 - 1)


def deadline(text: str) -> float:
    """Return seconds; 0 means none, as for the other limits."""
    return NOT_NEGATIVE(text) or math.inf
