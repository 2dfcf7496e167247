# SPDX-License-Identifier: Apache-2.0
"""Dockings of packaged scenes, each to its required result: some of the committed list, and one of each scene."""

from __future__ import annotations

from functools import cache

import pytest

from deltacharger_lab.campaigns.docking import dock_once
from deltacharger_lab.campaigns.scene import CampaignScene, load_campaign_scene

from ..marks import rest

scene = cache(load_campaign_scene)


@pytest.fixture(scope="module")
def fixed() -> CampaignScene:
    return scene("fixed")


def test_the_list_keeps_its_length(fixed: CampaignScene) -> None:
    assert len(fixed.dockings) == 160


@pytest.mark.parametrize(
    ("number", "codes"),
    [
        (0, "NONE"),  # level, nothing wrong
        rest(7, "NONE"),  # rolled by −7°
        (15, "CRITICAL_ANGLE"),  # by −11°
        rest(18, "CRITICAL_ANGLE"),  # by 15°
        rest(31, "NONE"),  # 10 mm off in both axes, 6°
        rest(45, "NONE"),  # a corner of the workspace, 20 N·m/rad
        rest(55, "NONE"),  # 2.5 N·m/rad on 1e7 N/m
        rest(64, "NONE"),  # 20 N·m/rad on 1e4 N/m, which bottoms under the magnets
        rest(70, "NO_TACTILE_CONTACT ESTIMATE_UNSURE"),  # no magnets: the pads hardly detect the push alone
        rest(76, "NONE"),  # gravity upward, 6 N·m/rad
        rest(97, "NONE"),  # tilted about y on 1e5 N/m
        (104, "UNREACHABLE"),  # goal beyond a corner of the workspace
        rest(106, "NO_CONTACT"),  # 30 mm behind the goal
        (107, "NO_CONTACT"),  # absent
    ],
)
def test_a_listed_docking_ends_as_it_must(fixed: CampaignScene, number: int, codes: str) -> None:
    row = dock_once(fixed, 8, number, "guarded")
    assert row["error"] == ""
    assert row["code_name"] in codes.split(), row["message"]
    assert (row["shorts"], row["energised_unsafe"], row["parted_live"]) == (0, 0.0, 0)
    assert row["servo_push"] <= 25.0
    if row["charged"]:
        assert 0.4 <= row["rest_current"] <= 0.5
        assert row["ended"] == ""
        assert row["servo_current_hottest"] <= 0.62
        assert abs(row["final_vertical"]) <= 0.0025
        assert row["clearance"] > 0.0


NAMES = ("assumed_stiffness", "assumed_torque_constant", "assumed_gravity", "assumed_geometry", "high_row", "parked")
OTHERS = ("nudged", "second", "second_sensitive", "random_second")


@pytest.mark.parametrize(
    ("name", "exact"),
    [("assumed_geometry", False), *(rest(name, exact) for name in (*NAMES, *OTHERS) for exact in (False, True))],
)
def test_a_packaged_scene_docks_safely(name: str, exact: bool) -> None:
    row = dock_once(scene(name), 7, 0, "guarded", exact)
    assert (row["error"], row["shorts"], row["energised_unsafe"]) == ("", 0, 0.0)
    assert row.get("pads", "first") == ("second" if "second" in name else "first")
