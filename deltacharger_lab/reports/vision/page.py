# SPDX-License-Identifier: Apache-2.0
"""What the page of the vision report asks for: rows of a table, and the bound of a share."""

from __future__ import annotations

from deltacharger_lab.campaigns.summary import upper_bound as at_most
from deltacharger_lab.reports.vision import conditions

__all__ = ["CLUTTER", "at_most"]

CLUTTER = f"{conditions.ALARMS}: {conditions.CLUTTER}"


def keys(*groups: str) -> list[str]:
    """Return the keys of the rows of tables."""
    return [conditions.key(each) for group in groups for each in conditions.members(group)]


def name(key: str) -> str:
    """Return what a row is called."""
    return conditions.CONDITIONS[key].name
