# SPDX-License-Identifier: Apache-2.0
"""Common parts of the campaign tests: a quick scene, and rows that compare equal although they have NaN."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from deltacharger_lab.campaigns.scene import CampaignScene, parse_campaign_scene
from deltacharger_lab.campaigns.store import CampaignSettings, versions

# A stiff arm close to its target, so that a docking takes a few hundredths of a second.
QUICK: dict[str, Any] = {
    "name": "quick",
    "target": {"x": [-0.002, 0.002], "y": [-0.002, 0.002], "roll": [-0.05, 0.05]},
    "camera": {"position_stddev": 0.0005},
    "world": {"servo": {"stiffness": [14.0, 16.0]}},
}


def settings(n: int, seed: int = 3, exact: bool = False, content: Mapping[str, Any] | None = None) -> CampaignSettings:
    return CampaignSettings(n, seed, exact, QUICK if content is None else content, "quick", versions())


def scene(content: Mapping[str, Any] | None = None) -> CampaignScene:
    return parse_campaign_scene(QUICK if content is None else content, "quick")


def comparable(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return rows in the order of their numbers with NaN as text, so that == means equal to the last bit."""
    ordered = sorted(rows, key=lambda row: int(row["number"]))
    return [
        {name: "NaN" if isinstance(value, float) and math.isnan(value) else value for name, value in row.items()}
        for row in ordered
    ]


def stored(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of a campaign's folder."""
    from deltacharger_lab.campaigns.store import read_results

    columns = read_results(folder)
    rows = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
    return comparable(rows)
