# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report kinematics`: the measured laws of the kinematics, and the command's contract."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_kinematics import DeltaGeometry
from deltacharger_lab.reports.kinematics import sets
from deltacharger_lab.reports.kinematics.forms import INVERSE_FORMS, inverse_array, inverse_one
from deltacharger_lab.reports.kinematics.geometries import ADJUSTED
from deltacharger_lab.reports.kinematics.pictures import PICTURES
from deltacharger_lab.reports.kinematics.reference import ExactDelta
from deltacharger_lab.reports.kinematics.solvers import OURS, PRECISE

from .conftest import Quick

SETS = ("interior", "boundary", "fold", "near type 2", "wide")
OUTSIDE = ("outside 1e-15 to 1e-3 m", "outside 1e-17 to 1e-15 m")

REPORT = ("kinematics",)
MEASURES_WITH = ()


def rows(figures: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in figures["inverse"]}


def test_ours_answers_everywhere_on_the_right_knee_within_the_bounds(quick_report: Quick) -> None:
    figures = quick_report[2]
    for name in OURS:
        for each in SETS:
            entry = rows(figures)[name]["sets"][each]
            assert (entry["none"], entry["wrong"]) == (0.0, 0.0), (name, each)
            assert entry["max"] <= (4e-16 if name == PRECISE or each == "boundary" else 8e-16), (name, each)
    assert figures["round_trip"]["Delta.inverse"]["max"] <= 5e-16


def test_ours_decides_reach_without_error(quick_report: Quick) -> None:
    decisions = quick_report[2]["reach"]["solvers"]
    for name in OURS:
        assert [decisions[name][each] for each in (*OUTSIDE, "boundary")] == [0, 0, 0], name
    plain = decisions["single atan2"]
    assert sum(plain[each] for each in OUTSIDE) > 0, "the sets do not tell the forms apart"


def test_the_closed_forms_lose_half_their_digits_at_the_edge_and_ours_does_not(quick_report: Quick) -> None:
    curves = quick_report[2]["edge"]["curves"]
    assert curves["single atan2"][0] > 1e-9
    assert max(each for name in OURS for each in curves[name] if each is not None) <= 8e-16


def test_every_extreme_input_has_the_required_answer(quick_report: Quick) -> None:
    found = quick_report[2]["extremes"]
    assert len({each["name"] for each in found}) >= 35  # some names repeat the row above
    assert not [each for each in found if not each["ok"]]


def test_every_robot_is_solved_within_the_bounds(quick_report: Quick) -> None:
    for robot in quick_report[2]["robots"]:
        assert robot["count"] > 0
        assert robot["wrong_decisions"] == 0, robot
        assert robot["precise"] <= 4e-16, robot
        assert max(robot["array"], robot["point"]) <= 1e-15, robot


def test_every_table_has_set_count_and_seed(quick_report: Quick) -> None:
    _, _, figures, page = quick_report
    for each in figures["sets"] + figures["reach"]["sets"]:
        assert f"| {each['name']} | {each['about']} | {each['count']} |" in page
    assert page.count("set, seed 1") == 2


def test_without_peers_and_matplotlib_the_tables_remain_and_list_what_is_missing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for module in ("casadi", "pinocchio", "matplotlib"):
        monkeypatch.setitem(sys.modules, module, None)
    folder = tmp_path / "made" / "here"
    words = ("report", "kinematics", "--quick", "--points", "50", "--seed", "7", "--out", str(folder), "--json")
    assert main(words) == 0
    printed = capsys.readouterr()
    answer = json.loads(printed.out)
    assert set(answer["absent"]) == {"casadi", "pinocchio"}
    assert set(answer["missing_pictures"]) == set(PICTURES)
    page = (folder / "kinematics.md").read_text("utf-8")
    assert "deltacharger[peers]" in page
    assert "deltacharger[report]" in page
    assert "![" not in page
    assert "| single atan2 |" in page
    assert "set, seed 7" in page
    assert "casadi is absent" in printed.err


@pytest.mark.parametrize("geometry", [DeltaGeometry(), DeltaGeometry(limbs=ADJUSTED)], ids=["plain", "adjusted"])
def test_the_reference_brings_points_back_to_30_digits(geometry: DeltaGeometry) -> None:
    """Inverse and forward are independent code, so they agree only if both are right."""
    exact = ExactDelta(geometry)
    points = sets.interior(geometry, np.random.default_rng(3), 20).points
    solved = exact.inverse(points).angles
    nudge = exact.forward(solved.high)
    # The angles are rounded to doubles before the way back, so the error is of that rounding.
    assert nudge.distance(points).max() < 2e-16
    assert (solved.angle_error(solved.high) <= 3e-16).all()


def test_the_reference_agrees_with_itself_about_the_edge() -> None:
    exact, rng = ExactDelta(), np.random.default_rng(4)
    inside, beyond = sets.boundary(exact, rng, 60), sets.outside(exact, rng, 60, -17.0, -15.0)
    assert (len(inside.points), len(beyond.points)) == (60, 60)
    assert inside.edge is not None
    assert beyond.edge is not None
    assert inside.edge.min() > 0.0 > beyond.edge.max()
    assert inside.edge.min() < 1e-15
    assert np.abs(beyond.edge).max() < 3e-15
    assert np.isfinite(exact.inverse(inside.points).angles.high).all()
    assert np.isnan(exact.inverse(beyond.points).angles.high).any(-1).all()


@pytest.mark.parametrize("name", INVERSE_FORMS)
def test_every_closed_form_is_right_inside_the_workspace(name: str) -> None:
    geometry = DeltaGeometry()
    points = sets.interior(geometry, np.random.default_rng(5), 50).points
    truth = ExactDelta(geometry).inverse(points).angles
    form = INVERSE_FORMS[name]
    assert truth.angle_error(inverse_array(form, geometry, points)).max() < 1e-10
    one_by_one = np.array([inverse_one(form, geometry, *point) for point in points.tolist()])
    assert truth.angle_error(one_by_one).max() < 1e-10


def test_one_seed_gives_the_same_points() -> None:
    exact = ExactDelta()
    first, again = (sets.fold(exact, np.random.default_rng(6), 30).points for _ in range(2))
    assert np.array_equal(first, again)
