# SPDX-License-Identifier: Apache-2.0
"""Formats numbers for people: `quantity` in diagnostics, `figure` in lines and columns."""

from __future__ import annotations

import math

UNKNOWN = "unknown"


def quantity(value: float, form: str, unit: str) -> str:
    """Return a number with its unit; "unknown" for NaN, "no limit" for infinity.

    Args:
        value: in `unit`.
        form: number format, such as ".1f".
        unit: unit symbol.
    """
    if math.isnan(value):
        return UNKNOWN
    return "no limit" if math.isinf(value) else f"{value:{form}} {unit}"


def figure(value: float, unit: str, digits: int, width: int = 0) -> str:
    """Return a number with its unit; – for NaN."""
    text = "–" if value != value else f"{value:.{digits}f}"
    return f"{text:>{width}} {unit}".rstrip()
