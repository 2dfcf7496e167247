# SPDX-License-Identifier: Apache-2.0
"""Scenes of campaigns: values within bounds, a world with the drawn values, and what is refused by key."""

import hashlib
import math
import random
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_bringup.scenes.scene import SceneError
from deltacharger_core.parameters import Declaration, ParameterError, declared
from deltacharger_lab.campaigns.draw import draw
from deltacharger_lab.campaigns.keys import TAKEN, EstimatorErrors, known_keys
from deltacharger_lab.campaigns.parts import build_parts, read_spread
from deltacharger_lab.campaigns.scene import (
    CampaignScene,
    load_campaign_scene,
    packaged_campaigns,
    parse_campaign_scene,
)
from deltacharger_sim.parameters import WorldParameters
from test.marks import night

METRES = Declaration("x", float, None, "a place", "m", -0.06, 0.06)


@pytest.mark.parametrize(
    ("value", "mean", "stddev"),
    [
        (0.01, 0.01, 0.0),
        ([-0.03, 0.03], 0.0, 0.06 / math.sqrt(12.0)),
        ({"mean": 0.055, "stddev": 0.05}, 0.02017, 0.0281),
        ({"choose": [-0.02, 0.02]}, 0.0, 0.02),
        ({"either_sign": [0.02, 0.02]}, 0.0, 0.02),
        ({"log": [0.01, 0.04]}, 0.03 / math.log(4.0), 0.00864),
    ],
)
def test_a_spread_has_its_mean_and_its_width(value: Any, mean: float, stddev: float) -> None:
    source = random.Random(5)
    drawn = np.array([read_spread(value, METRES, "x").draw(source) for _ in range(4000)])
    assert np.abs(drawn).max() <= 0.06
    assert np.mean(drawn) == pytest.approx(mean, abs=0.001)
    assert np.std(drawn) == pytest.approx(stddev, abs=0.001)


def test_every_number_of_the_world_can_be_drawn_or_names_its_replacement() -> None:
    for each in declared(WorldParameters, "world"):
        assert each.name in set(known_keys()) | set(TAKEN), each.name


def test_the_goal_is_the_cameras_pose_and_the_world_has_the_true_one() -> None:
    content = {
        "target": {"x": 0.01, "y": -0.005, "z": 0.002, "roll": 0.04},
        "shift": {"x": 0.003, "z": -0.001, "roll": -0.02},
        "estimator": {"angle_stddev": 0.01},
    }
    drawn = draw(parse_campaign_scene(content, "x"), 1, 0)
    assert drawn.goal.position == pytest.approx((0.01, -0.005, 0.082))
    assert (drawn.goal.roll, drawn.goal.roll_stddev) == (0.04, 0.0)
    target = drawn.world.target
    assert (target.x, target.y, target.z, target.roll) == pytest.approx((0.013, -0.005, 0.081, 0.02))
    assert drawn.estimator == EstimatorErrors(angle_stddev=0.01)


def scattered(scene: CampaignScene, count: int) -> list[Any]:
    return [draw(scene, 1, number) for number in range(count)]


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
    world, _, docking = build_parts(values)
    assert math.hypot(world.gravity_x, world.gravity_y, world.gravity_z) == pytest.approx(9.81)
    assert world.gravity_x == pytest.approx(9.81 * math.sin(0.1) * expected[0])
    assert docking.gravity == (0.0, -9.81, 0.0)
    _, _, docking = build_parts({**values, "gravity.known": True})
    assert docking.gravity == pytest.approx((world.gravity_x, world.gravity_y, world.gravity_z))


def test_a_listed_docking_is_as_listed_and_the_rest_is_drawn() -> None:
    entries = [{"shift": {"x": 0.001 * index}} for index in range(3)]
    scene = parse_campaign_scene({"target": {"roll": [-0.1, 0.1]}, "dockings": entries}, "x")
    drawn = [draw(scene, 1, number) for number in range(3)]
    assert [each.values["shift.x"] for each in drawn] == [0.0, 0.001, 0.002]
    assert len({each.values["target.roll"] for each in drawn}) == 3
    assert scene.drawn() == ["shift.x", "target.roll"]


@pytest.mark.parametrize(
    ("name", "digest"),
    [("default", "10db3d8d7a55674d3755374e1c245db3"), ("steep", "3ccbb147a44b58a2f9a11252f85e2936")],
)
def test_a_seed_always_draws_the_same_values(name: str, digest: str) -> None:
    scene = load_campaign_scene(name)
    found = hashlib.sha256()
    for number in range(40):
        one = draw(scene, 21, number)
        world = one.world
        bodies = (world.servo, world.contact, world.magnets, world.target, world.cable, world.stand, one.goal)
        parts = list(map(astuple, bodies))
        gravity = (world.gravity_x, world.gravity_y, world.gravity_z)
        found.update(repr((sorted(one.values.items()), *parts, *gravity, one.seed, one.rig_seed)).encode())
    assert found.hexdigest()[:32] == digest


@pytest.mark.parametrize(
    "more",
    [
        {"estimator": {"tail": 3.0, "stddev_scale": 0.5, "bias_vertical": 0.0005, "paper": False}},
        {"gravity": {"anywhere": True, "known": True}},
    ],
)
def test_a_new_key_does_not_change_the_values_of_others(more: dict[str, Any]) -> None:
    base = {"target": {"x": [-0.02, 0.02]}, "camera": {"position_stddev": 0.001}, "hand_eye": {"rotation_stddev": 0.01}}
    for number in range(5):
        one = draw(parse_campaign_scene(base, "x"), 4, number)
        two = draw(parse_campaign_scene({**base, **more}, "x"), 4, number)
        assert {name: two.values[name] for name in one.values} == one.values
        assert (one.goal, one.seed, one.rig_seed) == (two.goal, two.seed, two.rig_seed)


def test_errors_of_vision_stay_within_the_limit_at_contact() -> None:
    content = {"shift": {"x": [-0.01, 0.01], "y": 0.009, "limit": 0.01}, "hand_eye": {"position_stddev": 0.005}}
    scene = parse_campaign_scene(content, "x")
    drawn = scattered(scene, 150)
    places = np.array([(one.world.target.x, one.world.target.y) for one in drawn])
    goals = np.array([one.goal.position for one in drawn])
    assert np.max(np.abs(places - goals[:, :2])) <= 0.01
    assert np.min(np.abs(places - goals[:, :2]), axis=0) == pytest.approx((0.0, 0.0), abs=0.001)
    assert np.std(goals[:, 2]) == pytest.approx(0.005, rel=0.2)


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


def x(spread: Any) -> dict[str, Any]:
    return {"target": {"x": spread}}


def second(**family: Any) -> dict[str, Any]:
    return {"pads": "second", "second": family}


def assumed(**values: Any) -> dict[str, Any]:
    return {"assumed": values}


TILTED = {"parked": {"heading": [-0.08, 0.08]}, "world": {"target": {"tilt_y": {"either_sign": [0.01, 0.03]}}}}


@pytest.mark.parametrize(
    ("content", "key", "problem"),
    [
        ([], "(top)", "not a mapping"),
        ({"wrold": {}}, "wrold", "'world'"),
        ({"world": {"servo": {"stiffness": [1, 15]}}}, "world.servo.stiffness[0]", "2 to 40"),
        (x([0.01, -0.01]), "target.x", "above"),
        (x({"log": [0.0, 0.01]}), "target.x.log", "no logarithm"),
        ({"gravity": {"anywhere": True, "tilt": 0.1}}, "gravity.tilt", "gravity.anywhere"),
        ({"dockings": [x([0.0, 0.01])]}, "dockings[0].target.x", "fixed"),
        ({"docking": {"current_min": [0.40, 0.48]}}, "docking.current_min", "current_max must be"),
        (assumed(geometry={"limb_0": {"arm": 0.01}}), "assumed.geometry.limb_0.arm", "-0.005 to 0.005"),
        ({**assumed(gravity_tilt=0.1), "gravity": {"tilt": 0.1, "known": False}}, "gravity.known", "contradicts"),
        ({"docking": {"servo_stiffness": 9.0}}, "docking.servo_stiffness", "assumed.servo_stiffness"),
        (TILTED, "parked.heading", "world.target.tilt_y"),
        ({"nudge": {"after": 3.0, "x": 0.0}}, "nudge.after", "no effect"),
        (second(sheet={"dead_band": [0.0, 1.0]}), "second.sheet.dead_band_spread", "half"),
        ({"estimator": {"model": "1N", "paper": True}}, "estimator.model", "estimator.paper"),
    ],
)
def test_impossible_content_is_refused_by_its_key(content: Any, key: str, problem: str) -> None:
    with pytest.raises(ParameterError) as refusal:
        parse_campaign_scene(content, "bad")
    assert refusal.value.key == key
    assert problem in refusal.value.problem


@pytest.mark.rest
def test_packaged_scenes_load() -> None:
    assert {"default", "steep"} <= set(packaged_campaigns())
    assert all(load_campaign_scene(name).description for name in packaged_campaigns())


@pytest.mark.parametrize(("text", "key"), [("target: {x: 9}", "target.x"), ("based_on: rnadom", "based_on")])
def test_a_file_names_itself(tmp_path: Path, text: str, key: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text, "utf-8")
    with pytest.raises(SceneError) as refusal:
        load_campaign_scene(str(path))
    assert (refusal.value.file, refusal.value.key) == (str(path), key)
