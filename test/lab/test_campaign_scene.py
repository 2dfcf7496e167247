# SPDX-License-Identifier: Apache-2.0
"""Draws of a campaign: values within bounds, and a world with the drawn values."""

from __future__ import annotations

import hashlib
import math
import random
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_core.parameters import Declaration, declared
from deltacharger_lab.campaigns.draw import draw, zero_angle
from deltacharger_lab.campaigns.keys import TAKEN, EstimatorErrors, known_keys
from deltacharger_lab.campaigns.parts import build_parts
from deltacharger_lab.campaigns.scene import CampaignScene, load_campaign_scene, parse_campaign_scene
from deltacharger_lab.campaigns.spread import read_spread
from deltacharger_sim.clearance import Overlap
from deltacharger_sim.parameters import WorldParameters
from deltacharger_tactile.parameters import TactileParameters

from ..marks import night

METRES = Declaration("x", float, None, "a place", "m", -0.06, 0.06)


@pytest.mark.parametrize(
    ("value", "mean", "stddev"),
    [
        (0.01, 0.01, 0.0),
        ([-0.03, 0.03], 0.0, 0.06 / math.sqrt(12.0)),
        ({"mean": 0.01, "stddev": 0.005}, 0.01, 0.005),
        ({"choose": [-0.02, 0.02]}, 0.0, 0.02),
        ({"either_sign": [0.02, 0.02]}, 0.0, 0.02),
        ({"log": [0.01, 0.04]}, 0.03 / math.log(4.0), 0.00864),
    ],
)
def test_a_spread_has_its_mean_and_its_width(value: Any, mean: float, stddev: float) -> None:
    source = random.Random(5)
    drawn = np.array([read_spread(value, METRES, "x").draw(source) for _ in range(4000)])
    assert np.mean(drawn) == pytest.approx(mean, abs=0.001)
    assert np.std(drawn) == pytest.approx(stddev, abs=0.001)


def test_a_normal_spread_stays_within_the_bounds() -> None:
    source = random.Random(5)
    spread = read_spread({"mean": 0.055, "stddev": 0.05}, METRES, "x")
    assert all(-0.06 <= spread.draw(source) <= 0.06 for _ in range(2000))


def test_every_number_of_the_world_can_be_drawn_or_names_its_replacement() -> None:
    for each in declared(WorldParameters, "world"):
        assert each.name in set(known_keys()) | set(TAKEN), each.name


def test_the_goal_is_the_cameras_pose_and_the_world_has_the_true_one() -> None:
    content = {
        "target": {"x": 0.01, "y": -0.005, "z": 0.002, "roll": 0.04},
        "shift": {"x": 0.003, "z": -0.001, "roll": -0.02},
        "estimator": {"angle_stddev": 0.01},
    }
    drawn = draw(parse_campaign_scene(content, "x"), 1, 0, "guarded")
    assert drawn.goal.position == pytest.approx((0.01, -0.005, 0.082))
    assert (drawn.goal.roll, drawn.goal.roll_stddev) == (0.04, 0.0)
    target = drawn.world.target
    assert (target.x, target.y, target.z, target.roll) == pytest.approx((0.013, -0.005, 0.081, 0.02))
    assert drawn.estimator == EstimatorErrors(angle_stddev=0.01)


def scattered(scene: CampaignScene, count: int) -> list[Any]:
    return [draw(scene, 1, number, "guarded") for number in range(count)]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (
            {"camera": {"position_stddev": 0.001, "roll_stddev": 0.01}, "hand_eye": {"position_stddev": 0.002}},
            (math.hypot(0.001, 0.002),) * 3,
        ),
        # A camera at (0, 0.12, -0.12) m is 0.233 m from (0, 0, 80 mm): 0.2 m along z, 0.12 m along y, none along x.
        ({"hand_eye": {"rotation_stddev": 0.01}}, (0.00233, 0.002, 0.0012)),
    ],
)
@pytest.mark.parametrize(("count", "within"), [(150, 0.2), night(1500, 0.06)])
def test_errors_of_camera_and_mount_have_their_declared_width(
    content: dict[str, Any], expected: tuple[float, ...], count: int, within: float
) -> None:
    goals = np.array([each.goal.position for each in scattered(parse_campaign_scene(content, "x"), count)])
    assert np.std(goals, axis=0) == pytest.approx(expected, rel=within)
    assert np.mean(goals, axis=0) == pytest.approx((0.0, 0.0, 0.08), abs=0.0033 * within)


@pytest.mark.parametrize(("azimuth", "expected"), [(0.0, (0.0, 0.0)), (math.pi / 2.0, (1.0, 0.0))])
def test_a_tilted_robot_has_tilted_gravity(azimuth: float, expected: tuple[float, float]) -> None:
    values = {"gravity.tilt": 0.1, "gravity.azimuth": azimuth}
    world, _, docking = build_parts(values, "guarded")
    assert math.hypot(world.gravity_x, world.gravity_y, world.gravity_z) == pytest.approx(9.81)
    assert world.gravity_x == pytest.approx(9.81 * math.sin(0.1) * expected[0])
    assert docking.gravity == (0.0, -9.81, 0.0)
    _, _, docking = build_parts({**values, "gravity.known": True}, "guarded")
    assert docking.gravity == pytest.approx((world.gravity_x, world.gravity_y, world.gravity_z))


def test_electrodes_have_the_hole_that_the_scene_gives_them() -> None:
    assert build_parts({"electrode.hole": 0.002}, "guarded")[1].contact.hole == 0.002
    assert build_parts({}, "guarded")[1] == TactileParameters()
    holed, plain = (draw(load_campaign_scene(name), 3, 5, "guarded") for name in ("holes", "random"))
    assert (holed.tactile.contact.hole, plain.tactile.contact.hole) == (0.0022, 0.0)
    assert (holed.world, holed.goal, holed.rig_seed) == (plain.world, plain.goal, plain.rig_seed)


def test_a_listed_docking_is_as_listed_and_the_rest_is_drawn() -> None:
    entries = [{"shift": {"x": 0.001 * index}} for index in range(3)]
    scene = parse_campaign_scene({"target": {"roll": [-0.1, 0.1]}, "dockings": entries}, "x")
    drawn = [draw(scene, 1, number, "guarded") for number in range(3)]
    assert [each.values["shift.x"] for each in drawn] == [0.0, 0.001, 0.002]
    assert len({each.values["target.roll"] for each in drawn}) == 3
    assert scene.drawn() == ["shift.x", "target.roll"]


@pytest.mark.parametrize(
    ("name", "digest"),
    [("default", "77ca1c1e2391afcbb846db50afc10b09"), ("steep", "e45b5150f0adaa90ca984d8888f6637e")],
)
def test_a_seed_always_draws_the_same_values(name: str, digest: str) -> None:
    scene = load_campaign_scene(name)
    found = hashlib.sha256()
    for number in range(40):
        one = draw(scene, 21, number, "guarded")
        world = one.world
        parts = list(map(astuple, (world.servo, world.contact, world.magnets, world.target, one.goal)))
        parts[1], parts[4] = parts[1][:4], parts[4][:4]  # pad_stiffness and a goal's lean are younger than the digests
        values = sorted(item for item in one.values.items() if item[0] != "docking.yaw_stddev")  # so is this
        gravity = (world.gravity_x, world.gravity_y, world.gravity_z)
        found.update(repr((values, *parts, *gravity, one.seed, one.rig_seed)).encode())
    assert found.hexdigest()[:32] == digest


@pytest.mark.parametrize(
    "more",
    [
        {"estimator": {"tail": 3.0, "stddev_scale": 0.5, "bias_vertical": 0.0005, "paper": False}},
        {"gravity": {"anywhere": True, "known": True}},
        {"world": {"contact": {"stiffness": {"log": [1e4, 1e7]}}}},
        {"shift": {"limit": 0.06, "x": {"either_sign": [0.001, 0.002]}}},
    ],
)
def test_a_new_key_does_not_change_the_values_of_others(more: dict[str, Any]) -> None:
    base = {"target": {"x": [-0.02, 0.02]}, "camera": {"position_stddev": 0.001}, "hand_eye": {"rotation_stddev": 0.01}}
    for number in range(5):
        one = draw(parse_campaign_scene(base, "x"), 4, number, "guarded")
        two = draw(parse_campaign_scene({**base, **more}, "x"), 4, number, "guarded")
        assert {name: two.values[name] for name in one.values} == one.values
        assert (one.goal, one.seed, one.rig_seed) == (two.goal, two.seed, two.rig_seed)


@pytest.mark.parametrize(("count", "within"), [(200, 0.12), night(1500, 0.05)])
def test_gravity_from_anywhere_has_all_directions_equally_likely(count: int, within: float) -> None:
    scene = parse_campaign_scene({"gravity": {"anywhere": True, "known": True}}, "x")
    drawn = scattered(scene, count)
    pull = np.array([(each.world.gravity_x, each.world.gravity_y, each.world.gravity_z) for each in drawn]) / 9.81
    assert np.linalg.norm(pull, axis=1) == pytest.approx(1.0)
    assert np.mean(pull, axis=0) == pytest.approx((0.0, 0.0, 0.0), abs=within)
    assert np.mean(pull**2, axis=0) == pytest.approx((1 / 3,) * 3, abs=0.6 * within)
    assert drawn[0].docking.gravity == pytest.approx(tuple(9.81 * pull[0]))
    assert {"gravity.tilt", "gravity.azimuth"} <= set(scene.drawn())


def test_errors_of_vision_stay_within_the_limit_at_contact() -> None:
    content = {"shift": {"x": [-0.01, 0.01], "y": 0.009, "limit": 0.01}, "hand_eye": {"position_stddev": 0.005}}
    scene = parse_campaign_scene(content, "x")
    drawn = scattered(scene, 150)
    places = np.array([(one.world.target.x, one.world.target.y) for one in drawn])
    goals = np.array([one.goal.position for one in drawn])
    assert np.max(np.abs(places - goals[:, :2])) <= 0.01
    assert np.min(np.abs(places - goals[:, :2]), axis=0) == pytest.approx((0.0, 0.0), abs=0.001)
    assert np.std(goals[:, 2]) == pytest.approx(0.005, rel=0.2)


def test_near_zero_clearance_the_wrong_bars_nearly_touch() -> None:
    scene = parse_campaign_scene({"shift": {"y": [-0.006, 0.006], "beyond_zero": [-0.01, 0.01]}}, "x")
    below = sides = 0
    for one in scattered(scene, 60):
        target = one.world.target
        x, y = target.x - one.goal.position[0], target.y - one.goal.position[1]
        true = Overlap(one.world.terminal, x, y, target.roll).clearance
        assert abs(true) < 0.0008  # 0.01 rad · 35 mm and the formula's error against the geometry
        below += true < 0.0
        sides += target.roll > 0.0
    assert 12 < below < 48
    assert 18 < sides < 42
    assert math.degrees(zero_angle(0.0, 0.0037, 0.035)) == pytest.approx(12.07, abs=0.005)
    assert zero_angle(0.06, 0.0037, 0.035) == 0.0


def test_a_scene_inherits_the_keys_that_it_does_not_set(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("based_on: edge\nshift: {roll: null, x: 0.001}\nworld: {contact: {stiffness: 2.0e+4}}", "utf-8")
    mine, edge, everything = load_campaign_scene(str(path)), load_campaign_scene("edge"), load_campaign_scene("random")
    assert mine.name == "mine"
    assert mine.spreads["world.contact.stiffness"].numbers == (2e4,)
    assert mine.spreads["shift.x"].numbers == (0.001,)
    assert "shift.roll" not in mine.spreads
    assert mine.spreads["shift.limit"] == edge.spreads["shift.limit"] == everything.spreads["shift.limit"]
    assert parse_campaign_scene(mine.content, "again").spreads == mine.spreads
