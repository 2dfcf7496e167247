# SPDX-License-Identifier: Apache-2.0
"""Wrong assumptions about arm and gravity: docking uses them, and the world keeps the true values."""

from __future__ import annotations

import math
from typing import Any

import pytest

from deltacharger_core.machine import GRAVITY_STRENGTH, TORQUE_CONSTANT
from deltacharger_kinematics.geometry import DeltaGeometry, LimbAdjustment
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_lab.campaigns.assumed import assumed_geometry
from deltacharger_lab.campaigns.docking import dock_once, make_charger
from deltacharger_lab.campaigns.draw import draw
from deltacharger_lab.campaigns.parts import build_parts
from deltacharger_lab.campaigns.scene import load_campaign_scene, parse_campaign_scene

from ..marks import rest
from .campaigns import QUICK, comparable


def test_assumed_stiffness_and_torque_constant_do_not_change_the_true_ones() -> None:
    world, _, docking = build_parts({"world.servo.stiffness": 5.0, "assumed.servo_stiffness": 2.5}, "guarded")
    assert (world.servo.stiffness, docking.servo_stiffness) == (5.0, 12.5)
    world, _, docking = build_parts({"world.servo.torque_constant": 1.2}, "guarded")
    assert (world.servo.torque_constant, docking.torque_constant) == (1.2, 1.2)
    world, _, docking = build_parts({"assumed.torque_constant": 0.8}, "guarded")
    assert world.servo.torque_constant == TORQUE_CONSTANT
    assert docking.torque_constant == pytest.approx(0.8 * TORQUE_CONSTANT)


@pytest.mark.parametrize("exact", [False, True])
def test_a_servos_current_bound_follows_from_the_assumed_constant(exact: bool) -> None:
    scene = parse_campaign_scene({**QUICK, "assumed": {"torque_constant": 0.8}}, "x")
    charger = make_charger(draw(scene, 3, 0, "guarded"), exact)
    charger._trajectory = (Waypoint(1.0, (0.0, 0.0, 0.0), (0.3, 0.6, 0.9)),)
    charger._servos()
    constant = 0.8 * TORQUE_CONSTANT
    assert charger._bound == pytest.approx([0.3 / constant, 0.6 / constant, 0.9 / constant])


def angle(one: Any, two: Any) -> float:
    return math.acos(min(sum(a * b for a, b in zip(one, two, strict=True)) / GRAVITY_STRENGTH**2, 1.0))


@pytest.mark.parametrize("true", [(0.0, 0.0), (0.3, 1.0), (math.pi, 0.0), (2.0, -2.0)])
def test_assumed_gravity_differs_by_the_given_angle(true: tuple[float, float]) -> None:
    stands = {"gravity.tilt": true[0], "gravity.azimuth": true[1]}
    assumed = []
    for azimuth in (0.0, 0.5 * math.pi):
        world, _, docking = build_parts(
            {**stands, "assumed.gravity_tilt": 0.2, "assumed.gravity_azimuth": azimuth}, "guarded"
        )
        down = world.gravity_x, world.gravity_y, world.gravity_z
        assert angle(docking.gravity, down) == pytest.approx(0.2)
        assert math.hypot(*docking.gravity) == pytest.approx(GRAVITY_STRENGTH)
        assumed.append(docking.gravity)
    assert angle(*assumed) == pytest.approx(math.acos(math.cos(0.2) ** 2))
    world, _, docking = build_parts({**stands, "assumed.gravity_tilt": 0.0}, "guarded")
    assert docking.gravity == pytest.approx((world.gravity_x, world.gravity_y, world.gravity_z))
    level, _, docking = build_parts({"assumed.gravity_tilt": 0.2, "assumed.gravity_azimuth": 0.5 * math.pi}, "guarded")
    assert docking.gravity[0] == pytest.approx(GRAVITY_STRENGTH * math.sin(0.2))
    assert (level.gravity_x, level.gravity_z) == (0.0, 0.0)


def test_assumed_geometry_is_the_true_one_plus_error() -> None:
    assert assumed_geometry({"target.x": 0.01}) is None
    assert assumed_geometry({"assumed.geometry.arm": 0.0}) is None
    values = {
        "assumed.geometry.arm": 0.001,
        "assumed.geometry.limb_1.arm": 0.0005,
        "assumed.geometry.limb_2.angle_offset": 0.01,
    }
    assumed, true = assumed_geometry(values), DeltaGeometry()
    assert assumed is not None
    assert assumed.limb(0).arm == pytest.approx(true.arm + 0.001)
    assert assumed.limb(1).arm == pytest.approx(true.arm + 0.0015)
    assert assumed.limbs[2] == LimbAdjustment(angle_offset=0.01)
    assert assumed.limb(0).rod == assumed.limb(1).rod == true.rod


@pytest.mark.parametrize("exact", [False, rest(True)])
def test_docking_moves_by_the_assumed_geometry_in_the_true_world(exact: bool) -> None:
    content = {**QUICK, "assumed": {"geometry": {"limb_0": {"angle_offset": 0.01}}}}
    drawn = draw(parse_campaign_scene(content, "x"), 3, 0, "guarded")
    charger = make_charger(drawn, exact)
    assert charger.world.geometry == DeltaGeometry()
    charger.dock(limit=120.0)
    mechanics, delta = charger.world.mechanics, ScalarDelta(drawn.geometry)
    believed = charger.machine._context.position
    assert believed == pytest.approx(delta.forward(*mechanics.angles), abs=1e-4)
    assert math.dist(believed, mechanics.position) == pytest.approx(
        math.dist(delta.forward(*mechanics.angles), ScalarDelta().forward(*mechanics.angles)), abs=1e-4
    )
    assert math.dist(believed, mechanics.position) > 0.0003


def test_pairs_stay_pairs() -> None:
    base, wrong = load_campaign_scene("default"), load_campaign_scene("assumed_geometry")
    for number in range(4):
        one, two = (draw(scene, 7, number, "guarded") for scene in (base, wrong))
        assert (one.world, one.goal, one.docking, one.seed) == (two.world, two.goal, two.docking, two.seed)
        assert one.geometry is None
        assert two.geometry is not None


def test_true_assumptions_change_no_row() -> None:
    true = {"servo_stiffness": 1.0, "torque_constant": 1.0, "geometry": {"arm": 0.0, "limb_1": {"rod": 0.0}}}
    plain, told = (
        dock_once(parse_campaign_scene({**QUICK, **more}, "x"), 3, 0, "guarded") for more in ({}, {"assumed": true})
    )
    assert comparable([{name: told[name] for name in plain}]) == comparable([plain])
