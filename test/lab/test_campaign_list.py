# SPDX-License-Identifier: Apache-2.0
"""The committed list of dockings: some of them run here, each to its required result."""

from __future__ import annotations

import pytest

from deltacharger_lab.campaigns.docking import dock_once
from deltacharger_lab.campaigns.scene import load_campaign_scene

SEED = 8

EXPECTED = {
    0: ("NONE",),  # level, nothing wrong
    7: ("NONE",),  # rolled by −7°
    15: ("CRITICAL_ANGLE",),  # by −11°
    18: ("CRITICAL_ANGLE",),  # by 15°
    31: ("NONE",),  # 10 mm off in both axes, 6°
    45: ("NONE",),  # a corner of the workspace, 20 N·m/rad
    55: ("NONE",),  # 2.5 N·m/rad on 1e7 N/m
    64: ("NONE",),  # 20 N·m/rad on 1e4 N/m, which bottoms under the magnets
    70: ("NO_TACTILE_CONTACT", "ESTIMATE_UNSURE"),  # no magnets: the pads hardly detect the push alone
    76: ("NONE",),  # gravity upward, 6 N·m/rad
    97: ("NONE",),  # tilted about y on 1e5 N/m
    104: ("UNREACHABLE",),  # goal beyond a corner of the workspace
    106: ("NO_CONTACT",),  # 30 mm behind the goal
    107: ("NO_CONTACT",),  # absent
}


def test_the_list_keeps_its_length() -> None:
    assert len(load_campaign_scene("fixed").dockings) == 160


@pytest.mark.parametrize(("number", "codes"), EXPECTED.items())
def test_a_listed_docking_ends_as_it_must(number: int, codes: tuple[str, ...]) -> None:
    row = dock_once(load_campaign_scene("fixed"), SEED, number, "guarded")
    assert row["error"] == ""
    assert row["code_name"] in codes, row["message"]
    assert (row["shorts"], row["energised_unsafe"], row["parted_live"]) == (0, 0.0, 0)
    assert row["servo_push"] <= 25.0
    if row["charged"]:
        assert 0.4 <= row["rest_current"] <= 0.5
        assert row["ended"] == ""
        assert row["servo_current_hottest"] <= 0.62
        assert abs(row["final_vertical"]) <= 0.0025
        assert row["clearance"] > 0.0
