# SPDX-License-Identifier: Apache-2.0
"""What the page of the docking report asks for: its columns and rows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from deltacharger_lab.reports.docking.pictures import FORMS
from deltacharger_lab.reports.docking.summary import UPRIGHT

__all__ = ["AXES", "SAFE", "UPRIGHT"]

SAFE = (
    *("random", "upright", "edge", "zero", "soft", "seen", "tilted", "gaussian", "tails", "understated", "biased"),
    *("paper", "classes", "published"),
)
AXES = (("horizontal", 1000.0, " mm"), ("vertical", 1000.0, " mm"), ("angle", math.degrees(1.0), "°"))
"""Of an estimate: name, and scale and unit that its error is told in."""
_Found = dict[str, dict[str, Any]]


def columns(parts: _Found) -> dict[str, str]:
    """Return titles of the campaigns that are told by angle."""
    titles = {"edge": "`edge`, guarded", **{name: title for name, (title, _) in FORMS.items()}}
    return {name: title for name, title in titles.items() if name in parts}


def by_angle(parts: _Found) -> list[tuple[tuple[float, float], _Found]]:
    """Return for each bin of |roll| (degrees) what those campaigns say of it."""
    found: dict[tuple[float, float], _Found] = {}
    for name in columns(parts):
        for each in parts[name]["bins"]:
            found.setdefault((each["low"], each["high"]), {})[name] = each
    return sorted(found.items())


def compared(pair: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any], str, float]]:
    """Yield name, figures, unit and scale of what is compared docking by docking."""
    for name, each in pair["rates"].items():
        yield name, each, "%", 100.0
    for name, each in pair["numbers"].items():
        yield name, each, *(("mm", 1000.0) if each["unit"] == "m" else (each["unit"], 1.0))
