# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report docking`: bounds, bins and targets, and a report that continues."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_lab.campaigns.summary import upper_bound
from deltacharger_lab.reports.docking import (
    hostile,
    lean,
    pictures as lean_picture,
    report as docking_report,
    summary as docking_summary,
)
from deltacharger_lab.reports.docking.pictures import PICTURES
from deltacharger_lab.reports.docking.summary import Columns

ALIGNED = "what is called aligned, lean5"


def rows(count: int, **changes: Any) -> Columns:
    """Return this many charged dockings of level targets."""
    names = ("servo_push", "peak_push", "final_horizontal", "final_vertical", "final_misalignment")
    usual: dict[str, Any] = dict.fromkeys(names, 0.001)
    usual |= {"place_roll": 0.0, "code_name": "NONE", "charged": True, "ended": "", "moves": 1, "time": 8.0}
    usual |= {"shorts": 0, "parted_live": 0, "energised": 4.0, "energised_unsafe": 0.0, "rest_push": 17.0}
    usual |= {"rest_current": 0.45, "servo_current_hottest": 0.5, "aligned": True, "undocked": "NONE"}
    usual |= {"true_push": 17.0, "reported_push": 17.0, "force_min": 15.0, "force_max": 19.0, "still_touching": False}
    usual |= changes
    found = {name: [value] * count for name, value in usual.items()}
    return docking_summary.columns(found | {"number": list(range(count))})


@pytest.mark.parametrize(("hits", "count"), [(0, 1), (0, 300), (0, 20_000), (1, 2000), (3, 40)])
def test_a_rate_at_its_bound_has_at_most_this_count_in_one_of_twenty_campaigns(hits: int, count: int) -> None:
    bound = upper_bound(hits, count)
    few = sum(math.comb(count, k) * bound**k * (1.0 - bound) ** (count - k) for k in range(hits + 1))
    assert few == pytest.approx(0.05, rel=1e-6)
    assert hits or bound <= 3.0 / count
    assert upper_bound(5, 5) == 1.0
    assert math.isnan(upper_bound(0, 0))


@pytest.mark.parametrize(
    ("scene", "changes", "missed"),
    [
        ("random", {}, set()),
        ("random", {"energised_unsafe": 0.01}, {"energised without clearance, random scenes"}),
        ("random", {"shorts": 1}, {"shorts, our algorithm"}),
        ("random", {"code_name": "CRASHED"}, {"dockings that crashed"}),
        ("default", {"moves": 4}, {"moves, default, median", "moves, default, 99 %"}),
        ("default", {"time": 9.0}, {"seconds to charging, default, median"}),
        ("edge", {"charged": False}, {"charged, scenes at 8–11°", "seconds to charging, edge, median"}),
        ("default", {"final_horizontal": 0.0026}, {"at rest within 2.5 mm in both axes, default"}),
        ("strike", {"peak_push": 121.0}, {"strike, exact, default, largest"}),
    ],
)
def test_only_its_own_figure_and_scene_miss_a_target(scene: str, changes: dict[str, Any], missed: set[str]) -> None:
    good = docking_summary.summarise(rows(10))
    found = dict.fromkeys((*docking_summary.SECONDS_MOST, "strike"), good)
    found[scene] = docking_summary.summarise(rows(10, **changes))
    assert {each["name"] for each in docking_summary.targets(found, good) if not each["met"]} == missed
    assert {each["met"] for each in docking_summary.targets({}, None)} == {None}, "nothing was measured"


@pytest.mark.rest
def test_a_report_runs_missing_dockings_and_shows_present_ones(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def report(*words: str) -> tuple[int, dict[str, Any], str]:
        capsys.readouterr()
        code = main(["report", "docking", *words, "--out", str(tmp_path), "--json"])
        captured = capsys.readouterr()
        return code, json.loads(captured.out), captured.err

    code, answer, _ = report("--only", "upright", "-n", "2")
    assert (code, "random" in answer["not_run"], "upright" in answer["not_run"]) == (0, True, False)
    code, answer, err = report("--only", "upright", "--only", "random", "-n", "3")
    assert (code, "2 of 3 dockings exist already" in err) == (0, True)
    pictures = PICTURES.keys() - {"docking-clearance.png", lean_picture.NAME}
    assert {Path(name).name for name in answer["files"]} == {"docking.md", "docking.json", *pictures}
    figures = json.loads((tmp_path / "docking.json").read_text("utf-8"))
    assert {name: each["n"] for name, each in figures["parts"].items()} == {"random": 3, "upright": 3}
    assert figures["parts"]["random"]["unsafe"]["bound"] == pytest.approx(upper_bound(0, 3))
    monkeypatch.setattr(docking_report, "versions", lambda: {"code": "other"})
    code, answer, _ = report("--only", "random", "-n", "3")
    assert (code, "version of code" in answer["error"]) == (2, True)


def test_hostile_figures_count_laws_and_codes_by_fault() -> None:
    given = {"broken": "", "acted": "servo_stays", "next_code": "NONE", "outside": 0.0, "live_unsafe_all": 0.0}
    given |= {"outside_limp": 0.0, "scene": "random", "drawn_faults": "from TIME + 1.00 s"}
    every = rows(4, peak_force=60.0, **given)
    every["broken"] = np.array(["", "code box", "box", ""])
    every["acted"] = np.array(["servo_stays", "servo_stays probe_late", "", "probe_late"])
    every["code_name"] = np.array(["NONE", "OVERCURRENT", "NONE", "POWER_STALE"])
    every["undocked"], every["next_code"] = (
        np.array(["NONE", "", "STUCK", ""]),
        np.array(["NONE", "NONE", "", "TIMEOUT"]),
    )
    found = hostile.figures(every)
    assert (found["n"], found["clean"]) == (4, 2)
    assert {law["name"]: (law["hits"], law["examples"]) for law in found["laws"] if law["hits"]} == {
        "code": (1, [1]),
        "box": (2, [1, 2]),
    }
    assert found["faults"] == [
        {
            "name": "servo_stays",
            "n": 2,
            "codes": {"NONE": 2, "OVERCURRENT": 1},
            "explained": 0.5,
            "broken": {"code": 1, "box": 1},
        },
        {
            "name": "probe_late",
            "n": 2,
            "codes": {"OVERCURRENT": 1, "POWER_STALE": 1},
            "explained": 0.5,
            "broken": {"code": 1, "box": 1},
        },
    ]
    assert found["next"] == {"NONE": 2, "TIMEOUT": 1}
    drawn = every["drawn_faults"]
    every["drawn_faults"] = np.array([f"{each} for 0.50 s" if index == 0 else each for index, each in enumerate(drawn)])
    assert (found["single"], hostile.figures(every)["single"]) == ({"n": 1, "named": 1}, {"n": 1, "named": 1})
    every["drawn_faults"] = np.array([f"{each} at 3.0 Hz" for each in drawn])
    assert hostile.figures(every)["single"] == {"n": 0, "named": 0}
    unmet = {each["name"] for each in hostile.targets({"hostile": found}) if each["met"] is False}
    assert unmet == {"hostile: code", "hostile: box"}
    assert {each["met"] for each in hostile.targets({})} == {None}


def leaning(yaws: list[float], pitches: list[float], **changes: Any) -> Columns:
    """Return a charged docking for each yaw and pitch (degrees)."""
    usual: dict[str, Any] = {"aligned": True, "contacts": 1, "lifted_live": 0, "bar_heat": 0.1}
    usual |= {"estimated_horizontal": 0.002, "estimated_horizontal_stddev": 0.0005}
    found = rows(len(yaws), **(usual | changes))
    tilts = {"y": yaws, "x": pitches}
    return found | {f"world.target.tilt_{axis}": np.radians(each) for axis, each in tilts.items()}


def test_leans_are_binned_by_integer_degrees_of_either_sign() -> None:
    every = leaning([0.5, -4.5, 5.0, 2.2], [-1.5, 4.9, -5.0, 0.0])
    every["charged"][1], every["code_name"] = False, np.array(["NONE", "LEANING", "NONE", "NONE"])
    cells = lean.by_lean(every)
    filled = [(yaw, pitch) for yaw in range(5) for pitch in range(5) if cells[yaw][pitch]["n"]]
    assert filled == [(0, 1), (2, 0), (4, 4)]
    yaw, pitch = lean.lean(rows(1) | {"parked.heading": np.radians([3.0])})  # of a robot that stands askew
    assert (yaw[0], pitch[0]) == (pytest.approx(3.0), 0.0)
    assert (cells[4][4]["n"], cells[4][4]["share"], cells[4][4]["refused"]) == (2, 0.5, {"LEANING": 1})


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, set()),
        (
            {"final_horizontal": 0.0041},
            {"at rest within 2.5 mm along x, lean5", f"beyond 4 mm along the bars of {ALIGNED}"},
        ),
        ({"energised_unsafe": 0.1}, {"energised without clearance, lean5"}),
        ({"lifted_live": 1}, {"live with a lifted bar, campaigns of leaning faces"}),
        ({"time": 17.0}, {"seconds to charging, lean5, median"}),
    ],
)
def test_only_its_own_figure_misses_a_target_of_leaning_faces(changes: dict[str, Any], missed: set[str]) -> None:
    found = lean.targets({"lean5": lean.figures(leaning([1.0, 4.0], [1.0, 0.0], **changes))})
    assert {each["name"] for each in found if each["met"] is False} == missed
