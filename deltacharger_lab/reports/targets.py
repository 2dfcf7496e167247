# SPDX-License-Identifier: Apache-2.0
"""Targets of the reports: what is wanted, what was measured, and whether that is met."""

from __future__ import annotations

import math
from typing import Any


def at_most(name: str, value: float | None, limit: float, unit: str, wanted: str = "") -> dict[str, Any]:
    """Return a target that a figure must not pass; `wanted` says it in other words than "≤ limit"."""
    return _target(name, wanted or f"≤ {limit:g}", value, unit, -math.inf, limit)


def at_least(name: str, value: float | None, limit: float, unit: str, wanted: str = "") -> dict[str, Any]:
    """Return a target that a figure must reach; `wanted` says it in other words than "≥ limit"."""
    return _target(name, wanted or f"≥ {limit:g}", value, unit, limit, math.inf)


def none(name: str, count: float | None, unit: str) -> dict[str, Any]:
    """Return a target that something never happens."""
    return at_most(name, count, 0.0, unit, "= 0")


def _target(name: str, wanted: str, value: float | None, unit: str, low: float, high: float) -> dict[str, Any]:
    measured = math.nan if value is None else float(value)
    met = low <= measured <= high or math.isclose(measured, low) or math.isclose(measured, high)  # but for rounding
    return {
        "name": name,
        "wanted": wanted,
        "measured": measured,
        "unit": unit,
        "met": None if math.isnan(measured) else met,
    }
