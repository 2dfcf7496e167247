# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report vision`: the detector on simulated images, and the command's contract."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from deltacharger_lab.campaigns.summary import upper_bound
from deltacharger_lab.reports.page import render
from deltacharger_lab.reports.vision import conditions as vision_conditions
from deltacharger_lab.reports.vision import plan as vision_plan
from deltacharger_lab.reports.vision import views as vision_views
from deltacharger_lab.reports.vision.conditions import (
    ALARMS,
    BAND,
    BY_RANGE,
    CLEAR,
    CONDITIONS,
    MUJOCO,
    OBSTRUCTED,
    RENDERERS,
    key,
    members,
)
from deltacharger_lab.reports.vision.gallery import worst
from deltacharger_lab.reports.vision.measure import FIELDS, LEVELS, Photographer, errors
from deltacharger_lab.reports.vision.pictures import PICTURES
from deltacharger_lab.reports.vision.report import row, targets
from deltacharger_vision.detector.detection import Detection

from .conftest import Quick

NOTHING = [*[math.nan] * 10, 1.0]

REPORT = ("vision", "--images", "2")
MEASURES_WITH = ("cv2", "matplotlib", "scipy")


def test_every_row_was_measured_with_its_number_of_images(quick_report: Quick) -> None:
    figures = quick_report[2]
    plan = vision_plan.VisionPlan(2, 0, True, figures["absent"])
    assert set(figures["rows"]) == {key(each) for each in plan.conditions()}
    for each in plan.conditions():
        seeds = [image[0] for image in figures["raw"]["images"][key(each)]]
        assert seeds == [20_000 + number for number in range(plan.count(each.weight))]
        assert figures["rows"][key(each)]["images"] == len(seeds)
    assert set(figures["mount"]) == set(LEVELS)
    assert any(each.renderer == MUJOCO for each in plan.conditions()) != ("mujoco" in figures["absent"])


def test_the_figures_are_those_of_their_images(quick_report: Quick) -> None:
    figures = quick_report[2]
    for name, images in figures["raw"]["images"].items():
        filled = [[math.nan if value is None else value for value in image] for image in images]
        for part, value in row(filled).items():
            found = figures["rows"][name][part]
            assert (math.isnan(value) and found is None) or found == pytest.approx(value), (name, part)


def test_near_unobstructed_terminals_are_found_and_right(quick_report: Quick) -> None:
    rows = quick_report[2]["rows"]
    plain = [rows[key(each)] for each in members(BY_RANGE) if BAND[0] <= each.away <= BAND[1]]
    assert sum(each["found"] for each in plain) >= 0.95 * sum(each["images"] for each in plain)
    assert sum(each["wrong"] for each in plain) == 0
    assert all(each["xy_mm_p95"] < 2.0 for each in plain)
    assert rows["hidden: 30 % of both bars hidden"]["wrong"] == 0
    before = [rows[key(each)] for each in members(OBSTRUCTED) if key(each) in rows]
    assert sum(each["found"] for each in before) >= 0.3 * sum(each["images"] for each in before)
    assert sum(each["sure"] for each in before) == 0


def test_the_mounts_error_dominates(quick_report: Quick) -> None:
    exact, half, whole = (quick_report[2]["mount"][name] for name in LEVELS)
    assert exact["base_mm_p50"] == pytest.approx(exact["camera_mm_p50"], rel=1e-6)
    assert 10.0 * exact["base_mm_p50"] < half["base_mm_p50"] < whole["base_mm_p50"]


def test_depth_gives_the_lean_and_the_mounts_error_degrades_it(quick_report: Quick) -> None:
    rows, mount = quick_report[2]["rows"], quick_report[2]["mount"]
    near = [rows[key(each)] for each in members(BY_RANGE) if 0.18 < each.away < 0.35]
    assert all(each["leans"] == each["found"] > 0 for each in near)
    assert max(each[f"{axis}_rms"] for each in near for axis in ("yaw", "pitch")) < 0.5
    assert mount["exact"]["yaw_rms"] < 0.3 * mount["1° / 3 mm"]["yaw_rms"]


def test_the_page_agrees_with_the_figures(quick_report: Quick) -> None:
    _, _, figures, page = quick_report
    assert "of simulated images" in page
    for target in figures["targets"]:
        verdict = "met" if target["met"] else "**NOT MET**"
        line = next(line for line in page.splitlines() if line.startswith(f"| {target['name']} |"))
        assert line.endswith(f"| {verdict} |")
    for each in members(BY_RANGE):
        found = figures["rows"][key(each)]
        line = next(line for line in page.splitlines() if line.startswith(f"| {each.name} |"))
        assert f"| {found['images']} | {100 * found['found'] / found['images']:.1f} |" in line
    assert "nan" not in page
    assert "None" not in page


def test_without_mujoco_and_pictures_the_page_states_why(quick_report: Quick) -> None:
    figures = json.loads((quick_report[0] / "vision.json").read_text("utf-8"))
    figures["rows"] = {name: each for name, each in figures["rows"].items() if MUJOCO not in name}
    figures |= {"absent": {"mujoco": "its rows are left out: none here"}, "pictures": []}
    figures["missing_pictures"] = dict.fromkeys(PICTURES, "no matplotlib")
    page = render("vision", figures, view=vision_conditions, upper_bound=upper_bound)
    assert "- mujoco: its rows are left out: none here" in page
    assert f"(No picture {next(iter(PICTURES))}: no matplotlib)" in page
    assert ", MuJoCo |" not in page.split("## Two renderers")[1]


def detection(position: tuple[float, float, float], roll: float = 0.0) -> Detection:
    return Detection(
        position=np.array(position),
        roll=roll,
        axis=np.array([1.0, 0.0, 0.0]),
        normal=np.array([0.0, 0.0, -1.0]),
        covariance=1e-6 * np.eye(6),
        confidence=1.0,
        range=0.3,
        bars=np.zeros((2, 4, 2)),
        source="fused",
    )


def test_large_errors_count_as_wrong() -> None:
    pose = np.eye(4)
    pose[2, 3] = 0.3
    named = FIELDS[1:]
    near = dict(zip(named, errors(detection((0.001, 0.0, 0.302), math.radians(4.9)), pose), strict=True))
    assert (near["found"], near["wrong"]) == (1.0, 0.0)
    assert near["xy_mm"] == pytest.approx(1.0)
    assert near["z_mm"] == pytest.approx(2.0)
    assert near["roll_deg"] == pytest.approx(4.9)
    assert near["nees"] == pytest.approx(5.0)
    assert near["tilt_deg"] == pytest.approx(0.0)
    for far in (detection((0.0, 0.0, 0.311)), detection((0.0, 0.0, 0.3), math.radians(-5.1))):
        assert errors(far, pose)[:2] == [1.0, 1.0]
    assert errors(detection((0.0, 0.0, 0.3)), pose, real=False)[:2] == [1.0, 1.0]
    assert errors(detection((0.0, 0.0, 0.3), math.pi), pose)[:2] == [1.0, 0.0]  # a line has no direction
    assert errors(None, pose)[:2] == [0.0, 0.0]


def test_only_right_detections_count_as_found() -> None:
    images = [
        [0, 1, 0, 1.0, 2.0, 0.1, 3.0, 1.0, 0.3, 0.4, 1.0, -2.0, 2.2, 0.0],
        [1, 1, 1, *NOTHING],
        [2, 0, 0, *NOTHING[:-1], 0.0],
    ]
    found = row(images)
    assert (found["images"], found["found"], found["wrong"]) == (3, 1, 1)
    assert found["xy_mm_p50"] == 1.0
    assert (found["sure"], found["sure_held"], found["error_mm_p50"]) == (1, 1.0, 2.2)
    assert (found["leans"], found["yaw_rms"], found["pitch_sigma_rms"]) == (1, 0.3, 2.0)
    assert (found["yaw_held"], found["pitch_held"]) == (1.0, 0.0)
    assert worst(images, real=True) == 1
    assert worst(images[::2], real=True) == 2
    assert worst(images[::2], real=False) == 0


def test_a_missed_target_is_reported() -> None:
    good = row([[0, 1, 0, 0.1, 0.1, 0.1, 3.0, 1.0, 0.1, 0.1, 1.0, 1.0, 0.1, 0.0]] * 100)
    bad = row(
        [[0, 0, 0, *NOTHING]] * 2
        + [[0, 1, 1, *NOTHING]]
        + [[0, 1, 0, 1.1, 2.1, 1.1, 3.0, 1.0, 0.1, 0.1, 1.0, 1.0, 2.4, 0.0]] * 97
    )
    for whole, time, met in ((good, 14.9, True), (bad, 15.1, False)):
        names = {key(each): {"median_ms": time} for each in members(BY_RANGE)}
        alarms = {"images": 100, "wrong": 0 if met else 1}
        half = {"images": 100, "found": 90 if met else 80}
        rows = {"hidden: 50 % of one bar hidden": half, f"{ALARMS}: clutter, no electrodes": alarms}
        hidden = {"images": 100, "found": 61 if met else 59, "sure": 0 if met else 1}
        clear = {"images": 100, "found": 99 if met else 98, "sure": 0 if met else 1}
        results = {"band": whole, "rows": rows, "times": names, OBSTRUCTED: hidden, CLEAR: clear}
        found = targets(results)
        assert [each["met"] for each in found] == [met] * len(found), found


def test_the_images_suffice_for_the_claims() -> None:
    plan = vision_plan.VisionPlan(vision_plan.FULL, 0, False, {})
    band = sum(plan.count(each.weight) for each in members(BY_RANGE) if BAND[0] <= each.away <= BAND[1])
    assert band >= 1500
    assert {each.name: plan.count(each.weight) for each in members(ALARMS)}["clutter, no electrodes"] == 1000
    for group in (OBSTRUCTED, CLEAR):
        assert sum(plan.count(each.weight) for each in members(group)) == 1000
    assert sum(plan.count(each.weight) for each in plan.conditions()) < 16_000


def test_seeds_are_those_of_the_report_and_shift() -> None:
    first, second = (vision_plan.VisionPlan(2, seed, True, {}) for seed in (0, 1))
    assert first.seeds(3)[0] == 20_000
    assert not set(first.seeds(1000)) & set(second.seeds(1000))


def test_one_seed_is_one_view_for_both_renderers_and_all_defects() -> None:
    plan = vision_plan.plan(2, 0, True)
    photographer = Photographer()
    names = ["defects: nothing special", "defects: exposure × 0.2", f"{RENDERERS}: exposure × 0.2, ray-caster"]
    names += [] if "mujoco" in plan.absent else [f"{RENDERERS}: exposure × 0.2, {MUJOCO}"]
    try:
        samples = [photographer.take(CONDITIONS[name], 20_000) for name in names]
    finally:
        photographer.close()
    for sample in samples[1:]:
        np.testing.assert_array_equal(sample.view.pose, samples[0].view.pose)
    assert samples[1].image.color.mean() < 0.7 * samples[0].image.color.mean()


@pytest.mark.parametrize("name", [name for name in CONDITIONS if not name.startswith((ALARMS, RENDERERS))])
def test_the_terminal_of_every_view_is_completely_in_the_picture(name: str) -> None:
    from deltacharger_vision.projection import project

    condition = CONDITIONS[name]
    for seed in range(300, 303):
        view = condition.draw(np.random.default_rng([seed, condition.stream]))
        corners = view.scene.terminal.corners() @ view.pose[:3, :3].T + view.pose[:3, 3]
        pixels = project(corners, condition.takes)
        assert (pixels > 0.0).all()
        assert (pixels < [condition.takes.width - 1, condition.takes.height - 1]).all()


def test_no_pose_if_the_terminal_is_larger_than_the_picture() -> None:
    with pytest.raises(ValueError, match="no pose"):
        vision_views.draw_pose(0.04, np.random.default_rng(0))
