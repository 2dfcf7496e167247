# SPDX-License-Identifier: Apache-2.0
"""Formats of figures in reports, and grouping of rows. Unknown (NaN, None) is –."""

import math
from collections.abc import Iterable
from typing import Any

UNKNOWN = "–"


def is_known(value: float | None) -> bool:
    """Return whether a number is known."""
    return value is not None and not math.isnan(value)


def fixed(value: float | None, digits: int = 1, plus: str = "") -> str:
    """Return a number with this many decimals; `plus` = "+" signs positive numbers."""
    return UNKNOWN if value is None or math.isnan(value) else f"{value:{plus}.{digits}f}"


def short(value: float | None, digits: int = 3, plus: str = "") -> str:
    """Return a number with this many significant digits."""
    return UNKNOWN if value is None or math.isnan(value) else f"{value:{plus}.{digits}g}"


def number(value: float | None, digits: int = 3) -> str:
    """Return an integer unchanged, other numbers with this many significant digits."""
    if value is not None and math.isfinite(value) and value == round(value) and abs(value) < 1e6:
        return f"{value:.0f}"
    return short(value, digits).replace("-inf", "−inf")


def power(value: float | None) -> str:
    """Return a number in exponent notation with one decimal."""
    return UNKNOWN if value is None or math.isnan(value) else f"{value:.1e}"


def percent(share: float | None, digits: int = 1) -> str:
    """Return a share in %, without the sign."""
    return scaled(share, 100.0, digits)


def share(value: float) -> str:
    """Return a share with the unit %; small ones have two significant digits."""
    percent = 100.0 * value
    return f"{percent:.0f} %" if percent >= 10.0 or percent == 0.0 else f"{percent:.2g} %"


def verdict(met: bool | None) -> str:
    """Return whether a target is met."""
    return "not measured" if met is None else "met" if met else "**NOT MET**"


def cell(text: str) -> str:
    """Return text that fits a table cell."""
    return " ".join(text.split()).replace("|", "\\|")


def median(values: tuple[float | None, float | None, float | None], digits: int = 1) -> str:
    """Return a median with the lowest and the highest in brackets, if they differ."""
    middle, low, high = (fixed(value, digits) for value in values)
    return middle if low == high else f"{middle} ({low}–{high})"


def tens(value: float) -> str:
    """Return a power of ten in the form 1e3."""
    return f"{value:.0e}".replace("e+0", "e")


def spread(entry: dict[str, float | None]) -> str:
    """Return a mean share in % with half the width of its interval, if known."""
    return percent(entry["mean"]) + (f" ± {percent(entry['half'])}" if is_known(entry["half"]) else "")


def scaled(value: float | None, scale: float, digits: int = 1) -> str:
    """Return a number in another unit, with this many decimals."""
    return UNKNOWN if value is None else fixed(scale * value, digits)


def rate(each: dict[str, Any]) -> str:
    """Return a share in % with its interval."""
    if not each["n"]:
        return UNKNOWN
    low, high = (percent(end, 2) for end in each["interval"])
    return f"{percent(each['share'], 2)} ({low}–{high})"


def three(each: dict[str, float | None], digits: int = 1, scale: float = 1.0) -> str:
    """Return median, 99 % and the largest."""
    return ", ".join(scaled(each[key], scale, digits) for key in ("median", "p99", "max"))


def counts(each: dict[str, int]) -> str:
    """Return counts by name."""
    return ", ".join(f"{name} {hits}" for name, hits in each.items()) or UNKNOWN


def plain(value: float | None) -> str:
    """Return a number with three significant digits, or more before the point; never in exponent notation."""
    return fixed(value, 0) if value is not None and value >= 100.0 else short(value)


def grouped(rows: Iterable[dict[str, Any]], *keys: str) -> list[tuple[tuple[Any, ...], list[dict[str, Any]]]]:
    """Group rows with equal values of `keys`, in the order of each group's first row."""
    found: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(found.items())
