# SPDX-License-Identifier: Apache-2.0
"""Numbers as people read them: in diagnostics by `quantity`, in lines and columns by `figure`."""

from __future__ import annotations

import math

UNKNOWN = "unknown"


def quantity(value: float, form: str, unit: str) -> str:
    """Return a number with its unit; "unknown" for NaN, "no limit" for an infinite one.

    Args:
        value: in `unit`.
        form: format of the number, such as ".1f".
        unit: its symbol.
    """
    if math.isnan(value):
        return UNKNOWN
    return "no limit" if math.isinf(value) else f"{value:{form}} {unit}"


def figure(value: float, unit: str, digits: int, width: int = 0) -> str:
    """Return a number with its unit, – in its place where it is not known."""
    text = "–" if value != value else f"{value:.{digits}f}"
    return f"{text:>{width}} {unit}".rstrip()
