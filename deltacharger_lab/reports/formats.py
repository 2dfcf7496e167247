# SPDX-License-Identifier: Apache-2.0
"""How reports write figures: every number of every page goes through one of these. Unknown (NaN, None) is –."""

from __future__ import annotations

import math

UNKNOWN = "–"


def is_known(value: float | None) -> bool:
    """Return whether there is a number."""
    return value is not None and not math.isnan(value)


def fixed(value: float | None, digits: int = 1, plus: str = "") -> str:
    """Return a number with so many digits behind the point; `plus` = "+" signs what is positive."""
    return UNKNOWN if value is None or math.isnan(value) else f"{value:{plus}.{digits}f}"


def short(value: float | None, digits: int = 3, plus: str = "") -> str:
    """Return a number with so many digits that count."""
    return UNKNOWN if value is None or math.isnan(value) else f"{value:{plus}.{digits}g}"


def number(value: float | None, digits: int = 3) -> str:
    """Return a whole number as it is, and another with so many digits that count."""
    if value is not None and math.isfinite(value) and value == round(value) and abs(value) < 1e6:
        return f"{value:.0f}"
    return short(value, digits).replace("-inf", "−inf")


def power(value: float | None) -> str:
    """Return a number as a power of ten with one digit behind the point."""
    return UNKNOWN if value is None or math.isnan(value) else f"{value:.1e}"


def percent(share: float | None, digits: int = 1) -> str:
    """Return a share in %, without the sign."""
    return UNKNOWN if share is None else fixed(100.0 * share, digits)


def verdict(met: bool | None) -> str:
    """Return whether a target is met."""
    return "not measured" if met is None else "met" if met else "**NOT MET**"


def cell(text: str) -> str:
    """Return text that breaks no table."""
    return " ".join(text.split()).replace("|", "\\|")


def median(values: tuple[float | None, float | None, float | None], digits: int = 1) -> str:
    """Return a median with the lowest and the highest in brackets, where they differ."""
    middle, low, high = (fixed(value, digits) for value in values)
    return middle if low == high else f"{middle} ({low}–{high})"
