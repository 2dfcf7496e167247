# SPDX-License-Identifier: Apache-2.0
"""Real targets: how each kind of port ended, packs with foreign profiles, and gaps in the current."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from deltacharger_lab.campaigns.targets import FULL, ROWS, UNTOUCHED
from deltacharger_lab.reports.docking.summary import Columns, Figures, quantiles
from deltacharger_lab.reports.report import at_least, none

SCENES = ("targets", "target_pairs", "target_gaps")
"""Campaigns of the section, if they were run."""
_OVER = 0.3  # V


def figures(rows: Columns) -> Figures:
    """Return the figures of one campaign of targets."""
    right = rows["right"].astype(bool)
    told_full = np.array([str(each).startswith("told") for each in rows["ending"]], dtype=bool)
    refused = np.array([str(each) == UNTOUCHED for each in rows["ending"]], dtype=bool)
    above = rows["battery"] - rows["battery_full"]
    names = dict.fromkeys(map(str, rows["behaviour"]))
    return {
        "n": len(right),
        "right": int(right.sum()),
        "told_full": int(told_full.sum()),
        "refused": int(refused.sum()),
        "above": float(above[~refused].max()) if (~refused).any() else math.nan,
        "over": int((above[~refused] > _OVER).sum()),
        "unsafe": int(((rows["shorts"] > 0) | (rows["energised_unsafe"] > 0.0) | (rows["parted_live"] > 0)).sum()),
        "port_shorted": int((rows["port_shorted"] > 0.0).sum()),
        "energy": quantiles(np.abs(rows["energy_told"] / np.maximum(rows["energy"], 1.0) - 1.0)[~refused]),
        "kinds": [_kind(name, rows, right) for name in (ROWS if set(names) <= set(ROWS) else names)],
    }


def _kind(name: str, rows: Columns, right: Any) -> Figures:
    """Return how the dockings of one kind ended."""
    own = [index for index, each in enumerate(rows["behaviour"]) if str(each) == name]
    ends = (str(rows["charge_end"][i]) or str(rows["code_name"][i]) for i in own)
    full = [i for i in own if str(rows["ending"][i]) == FULL]
    return {
        "name": name,
        "text": ROWS[name].text if name in ROWS else "",
        "n": len(own),
        "right": int(right[own].sum()),
        "endings": dict(Counter(str(rows["ending"][i]) for i in own).most_common()),
        "told": dict(Counter(ends).most_common(3)),
        "short_of_full": quantiles((rows["battery_full"] - rows["battery"])[full]) if full else None,
    }


def targets(found: dict[str, Figures]) -> Iterator[dict[str, Any]]:
    """Yield the target of each campaign, and what must never happen in any."""
    abouts = "kinds of ports end right", "packs are refused or kept", "gaps are survived"
    for name, about in zip(SCENES, abouts, strict=True):
        each = found.get(name)
        yield at_least(f"targets: {about}", each["right"] / each["n"] if each else None, 1.0, "of them")
    count = f"of {sum(each['n'] for each in found.values())}"
    never = {
        "told_full": "told full, was not",
        "over": f"more than {_OVER} V above full",
        "unsafe": "live without clearance, shorted or parted",
    }
    for what, about in never.items():
        yield none(f"targets: {about}", sum(each[what] for each in found.values()) if found else None, count)
