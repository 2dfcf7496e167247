# SPDX-License-Identifier: Apache-2.0
"""Dockings of the quick charger against one that computes all that the nodes do, and to each scene's result."""

import random
from functools import cache
from typing import Any

import numpy as np
import pytest

from deltacharger_docking.arm import Planner
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_lab.campaigns import docking, scene
from deltacharger_sim.pads import ContactSource
from deltacharger_sim.virtual.quick_charger import OnePieceFeed, QuickPlanner
from test.marks import rest

from .campaigns import QUICK

packaged = cache(scene.load_campaign_scene)


def test_frames_in_one_call_equal_single_frames() -> None:
    together, one_by_one = ContactSource(None, 7, 3), ContactSource(None, 7, 3)
    pose = (0.001, -0.002, 0.03)
    together.begin_docking()
    one_by_one.begin_docking()
    many = together.frames(1.0, pose, 70.0, 5, 0.01)
    single = [one_by_one.frames(0.96 + 0.01 * index, pose, 70.0, 1, 0.0)[0] for index in range(5)]
    np.testing.assert_allclose(many, np.stack(single), atol=0.02, equal_nan=True)  # two steps of the converter


@pytest.mark.parametrize("stiffness", [2.5, 20.0])
def test_lines_equal_the_planners(stiffness: float) -> None:
    source = random.Random(4)
    parameters, geometry = DockingParameters(servo_stiffness=stiffness), DeltaGeometry()
    quick, usual = QuickPlanner(parameters, geometry), Planner(parameters, geometry)
    for _ in range(10):
        start, goal = (
            (source.uniform(-0.05, 0.05), source.uniform(-0.05, 0.05), source.uniform(0.02, 0.10)) for _ in range(2)
        )
        speed = source.uniform(0.02, 0.25)
        ours, theirs = quick.line(start, goal, speed), usual.line(start, goal, speed)
        assert ours[-1].time == pytest.approx(theirs[-1].time, rel=0.006)
        shares = np.array([point.time for point in ours]) / ours[-1].time
        known = np.array([point.time for point in theirs]) / theirs[-1].time
        inside = shares >= known[0]
        for name, most in (("angles", 2e-3), ("torque_bound", 3e-3)):  # rad (an encoder's tick is 1.5e-3), N·m
            for index in range(3):
                one, two = ([getattr(point, name)[index] for point in line] for line in (ours, theirs))
                assert np.abs(np.interp(shares, known, two) - one)[inside].max() < most


def test_a_complete_line_is_sent_once_and_stops_at_hold() -> None:
    parameters = DockingParameters()
    line = Planner(parameters, DeltaGeometry()).line((0.0, 0.0, 0.05), (0.0, 0.0, 0.08), 0.05)
    feed = OnePieceFeed(0.06)
    feed.start(line, 10.0)
    assert feed.piece(10.01) == line
    assert feed.piece(10.02) is None
    assert feed.is_under_way(10.0 + 0.99 * line[-1].time)
    assert not feed.is_under_way(10.0 + line[-1].time)
    held = feed.hold(10.0 + 0.5 * line[-1].time)
    assert len(held) == 1
    assert line[0].angles < held[0].angles < line[-1].angles


@pytest.mark.parametrize(
    "content",
    [
        rest(QUICK),
        rest({"target": {"roll": 0.30}, "shift": {"roll": -0.02}}),
        ({"world": {"target": {"present": False}}}),
        rest({"world": {"port": {"voltage": -24.0}}}),
        rest({"world": {"target": {"tilt_x": 0.01, "tilt_y": 0.02}, "platform": {"compliance": 0.02}}}),
    ],
)
def test_a_quick_docking_ends_like_a_full_one(content: dict[str, Any]) -> None:
    quick = docking.dock_once(scene.parse_campaign_scene(content, "x"), 5, 0)
    exact = docking.dock_once(scene.parse_campaign_scene(content, "x"), 5, 0, exact=True)
    assert quick["error"] == exact["error"] == ""
    same = ("code_name", "charged", "shorts", "parted_live", "seed", "rig_seed", "goal_x", "place_x")
    assert {name: quick[name] for name in same} == {name: exact[name] for name in same}
    assert quick["energised_unsafe"] == exact["energised_unsafe"] == 0.0
    assert quick["lifted_live"] == exact["lifted_live"] == 0
    assert quick["bar_heat"] == pytest.approx(exact["bar_heat"], rel=0.3)
    assert quick["peak_push"] == pytest.approx(exact["peak_push"], rel=0.15, abs=1.0)  # 11 % on leaning faces


@pytest.mark.parametrize(
    ("number", "codes"),
    [
        (0, "NONE"),  # level, nothing wrong
        (15, "CRITICAL_ANGLE"),  # by −11°
        rest(45, "NONE"),  # a corner of the workspace, 20 N·m/rad
        rest(55, "NONE"),  # 2.5 N·m/rad on 1e7 N/m
        rest(70, "NO_TACTILE_CONTACT ESTIMATE_UNSURE"),  # no magnets: the pads hardly detect the push alone
        rest(76, "NONE"),  # gravity upward, 6 N·m/rad
        (104, "UNREACHABLE"),  # goal beyond a corner of the workspace
        (107, "NO_CONTACT"),  # absent
    ],
)
def test_a_listed_docking_ends_as_it_must(number: int, codes: str) -> None:
    assert len(packaged("fixed").dockings) == 160
    row = docking.dock_once(packaged("fixed"), 8, number)
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
    row = docking.dock_once(packaged(name), 7, 0, exact)
    assert (row["error"], row["shorts"], row["energised_unsafe"]) == ("", 0, 0.0)
    assert row.get("pads", "first") == ("second" if "second" in name else "first")
