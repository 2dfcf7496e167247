# SPDX-License-Identifier: Apache-2.0
"""Disturbances of a docking: wrong assumptions about arm and gravity, high taxels, faces askew, nudges, other pads."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from deltacharger_core.machine import GRAVITY_STRENGTH, TORQUE_CONSTANT
from deltacharger_kinematics import geometry, scalar, trajectory_feed
from deltacharger_lab.campaigns import disturbances, docking, parts
from deltacharger_lab.campaigns.draw import Drawn, draw
from deltacharger_lab.campaigns.scene import load_campaign_scene
from test.marks import rest

from .campaigns import QUICK, comparable, scene

exactly_too = pytest.mark.parametrize("exact", [False, rest(True)])


def drawn(**more: Any) -> Drawn:
    """Return the first docking of the quick scene with more keys."""
    return draw(scene({**QUICK, **more}), 3, 0)


def docked(exact: bool = False, number: int = 0, **more: Any) -> dict[str, Any]:
    """Return a row of the quick scene with more keys."""
    row = docking.dock_once(scene({**QUICK, **more}), 3, number, exact)
    assert row["error"] == ""
    return row


@pytest.mark.parametrize("exact", [False, True])
def test_a_servos_current_bound_follows_from_the_assumed_constant(exact: bool) -> None:
    charger = docking.make_charger(drawn(assumed={"torque_constant": 0.8}), exact)
    charger._trajectory = (trajectory_feed.Waypoint(1.0, (0.0, 0.0, 0.0), (0.3, 0.6, 0.9)),)
    charger._servos()
    assert charger._bound == pytest.approx([torque / (0.8 * TORQUE_CONSTANT) for torque in (0.3, 0.6, 0.9)])


@pytest.mark.parametrize("true", [(0.0, 0.0), (0.3, 1.0), (math.pi, 0.0), (2.0, -2.0)])
def test_assumed_gravity_differs_by_the_given_angle(true: tuple[float, float]) -> None:
    stands = {"gravity.tilt": true[0], "gravity.azimuth": true[1]}
    found = []
    for tilt, azimuth in ((0.0, 0.0), (0.2, 0.0), (0.2, 0.5 * math.pi)):
        told = {"assumed.gravity_tilt": tilt, "assumed.gravity_azimuth": azimuth}
        world, _, used = parts.build_parts({**stands, **told})
        found.append(np.array(used.gravity) / GRAVITY_STRENGTH)
    down = np.array((world.gravity_x, world.gravity_y, world.gravity_z)) / GRAVITY_STRENGTH
    assert found[0] == pytest.approx(down)
    assert np.linalg.norm(found, axis=1) == pytest.approx(1.0)
    assert found @ down == pytest.approx([1.0, math.cos(0.2), math.cos(0.2)])
    assert found[1] @ found[2] == pytest.approx(math.cos(0.2) ** 2)
    assert any(true) or found[2][0] == pytest.approx(math.sin(0.2))


def test_assumed_geometry_is_the_true_one_plus_error() -> None:
    assert parts.assumed_geometry({"target.x": 0.01}) is parts.assumed_geometry({"assumed.geometry.arm": 0.0}) is None
    errors = {"arm": 0.001, "limb_1.arm": 0.0005, "limb_2.angle_offset": 0.01}
    found, true = (
        parts.assumed_geometry({f"assumed.geometry.{name}": each for name, each in errors.items()}),
        geometry.DeltaGeometry(),
    )
    assert found is not None
    assert [found.limb(index).arm - true.arm for index in range(2)] == pytest.approx([0.001, 0.0015])
    assert found.limbs[2] == geometry.LimbAdjustment(angle_offset=0.01)
    assert found.limb(0).rod == found.limb(1).rod == true.rod


@exactly_too
def test_docking_moves_by_the_assumed_geometry_in_the_true_world(exact: bool) -> None:
    one = drawn(assumed={"geometry": {"limb_0": {"angle_offset": 0.01}}})
    charger = docking.make_charger(one, exact)
    assert charger.world.geometry == geometry.DeltaGeometry()
    charger.dock(limit=120.0)
    mechanics, believed = charger.world.mechanics, charger.machine._context.position
    wrong, right = (
        each.forward(*mechanics.angles) for each in (scalar.ScalarDelta(one.geometry), scalar.ScalarDelta())
    )
    assert believed == pytest.approx(wrong, abs=1e-4)
    assert math.dist(believed, mechanics.position) == pytest.approx(math.dist(wrong, right), abs=1e-4)
    assert math.dist(believed, mechanics.position) > 0.0003


def test_pairs_stay_pairs_and_true_assumptions_change_no_row() -> None:
    for number in range(4):
        one, two = (draw(load_campaign_scene(name), 7, number) for name in ("default", "assumed_geometry"))
        assert (one.world, one.goal, one.docking, one.seed) == (two.world, two.goal, two.docking, two.seed)
        assert one.geometry is None is not two.geometry
    true = {"servo_stiffness": 1.0, "torque_constant": 1.0, "geometry": {"arm": 0.0, "limb_1": {"rod": 0.0}}}
    plain, told = docked(), docked(assumed=true)
    assert comparable([{name: told[name] for name in plain}]) == comparable([plain])


@exactly_too
def test_the_high_row_appears_after_the_tare_only(exact: bool) -> None:
    baselines, feels = [], []
    for taxels in ({"high_row": 1.5}, {}):
        one = drawn(taxels=taxels)
        charger = docking.make_charger(one, exact)
        charger.begin(docking.DockGoal(one.goal))
        assert not charger.observe().tactile_contact
        charger.until(lambda charger=charger: charger._tared, 30.0)
        charger.run(0.05)
        baselines.append(charger.baseline)
        feels.append(charger.observe().tactile_contact)
    assert feels == [True, False]
    alive = np.isfinite(baselines[1])
    np.testing.assert_allclose(
        (baselines[1] - baselines[0])[alive], disturbances.high_row(1.5, one.seed)[alive], atol=1e-9
    )


def nudged(exact: bool = False, friction: float = 0.0, **nudge: float) -> dict[str, Any]:
    """Return the row of a docking with a nudged target."""
    world = {**QUICK["world"], "contact": {"friction": friction}}
    return docked(exact, target={}, camera={}, world=world, nudge=nudge)


@exactly_too
def test_turning_a_charging_target_ends_charging(exact: bool) -> None:
    row = nudged(exact, 0.3, roll=0.18, after=1.5)  # 0.19 shorts one that lies askew
    assert (row["charged"], row["ended"], row["shorts"]) == (True, "NO_CONTACT", 0)
    assert row["nudge_opened"] < disturbances.LASTS
    assert row["energised"] == pytest.approx(1.5 + row["nudge_opened"], abs=0.1)


def test_the_nudge_occurs_once_at_its_time() -> None:
    one = drawn(nudge={"x": 0.002, "after": 1.0})
    charger = docking.make_charger(one, False)
    nudging = docking.Nudging(one.nudge, charger.world)
    charger.begin(docking.DockGoal(one.goal))
    places = [(0.0, charger.world.parameters.target.x)]
    while charger.now < 30.0:
        charger.tick()
        nudging.look()
        places.append((charger.world.record.energised, charger.world.parameters.target.x))
    moves = [live for (live, before), (_, x) in pairwise(places) if x != before]
    assert moves[0] == pytest.approx(1.0, abs=0.14)
    assert moves[-1] <= moves[0] + disturbances.LASTS + 0.2
    assert places[-1][1] == pytest.approx(places[0][1] + 0.002)
    assert math.isnan(nudging.opened)
