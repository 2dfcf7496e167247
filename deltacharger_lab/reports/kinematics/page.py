# SPDX-License-Identifier: Apache-2.0
"""What the page of the kinematics report asks for: names, and how shares and margins are told."""

from __future__ import annotations

from typing import Any

from deltacharger_lab.reports.formats import number
from deltacharger_lab.reports.kinematics.solvers import POINT, PRECISE, SCALAR
from deltacharger_lab.reports.kinematics.speed import BATCH, NEAR_EDGE

__all__ = ["BATCH", "NEAR_EDGE"]


def costs(rows: list[dict[str, Any]]) -> list[float]:
    """Return the µs of one point by ScalarDelta, Delta and Delta with precise=True."""
    found = {row["name"]: row["one_us"] for row in rows}
    return [found[name] for name in (SCALAR, POINT, PRECISE)]


def share(value: float) -> str:
    """Return a share in %, small ones with two digits that count."""
    percent = 100.0 * value
    return f"{percent:.0f} %" if percent >= 10.0 or percent == 0.0 else f"{percent:.2g} %"


def margin(row: dict[str, Any]) -> str:
    """Return the margin of an inverse solve; nothing for what has none."""
    if not row["status"] or row["unit"] == "m":
        return ""
    if row["margin"] is None:  # JSON has neither NaN nor infinity
        return "−inf" if "UNREACHABLE" in row["status"] else "NaN"
    return number(row["margin"])
