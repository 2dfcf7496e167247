# SPDX-License-Identifier: Apache-2.0
"""Cells and phrases that the docking report's page repeats."""

from __future__ import annotations

import math
from typing import Any

from deltacharger_lab.reports.docking.pictures import NAMES

_ALT = {
    NAMES[0]: "Charged share and refusals over the target's roll",
    NAMES[1]: "Believed over true clearance of each docking, charged and refused",
    NAMES[2]: "Contact current at rest, hottest servo and largest push",
    NAMES[3]: "Alignment moves, time to charging, and offsets at rest",
    NAMES[4]: "Errors of the estimates over their standard deviations",
}


def show(results: dict[str, Any], name: str) -> str:
    """Return a picture of the page, or why there is none."""
    if name in results["pictures"]:
        return f"![{_ALT[name]}]({name})"
    return f"*No picture {name}: {results['missing_pictures'][name]}.*"


def share(each: dict[str, Any]) -> str:
    """Return a share in % with its interval."""
    if not each["n"]:
        return "–"
    low, high = each["interval"]
    return f"{100.0 * each['share']:.2f} ({100.0 * low:.2f}–{100.0 * high:.2f})"


def number(value: float, digits: int) -> str:
    """Return a number, – where there is none."""
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def three(each: dict[str, float], digits: int) -> str:
    """Return median, 99 % and the largest."""
    return ", ".join(number(each[key], digits) for key in ("median", "p99", "max"))


def causes(refused: dict[str, int]) -> str:
    """Return how often each code ended a docking."""
    return ", ".join(f"{name} {hits}" for name, hits in refused.items()) or "–"
