# SPDX-License-Identifier: Apache-2.0
"""Disturbances of a docking: taxels that read too high, faces askew, a nudge while charging, other pads."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns import docking, pads
from deltacharger_lab.campaigns.disturbances import LASTS, high_row, watched_after
from deltacharger_lab.campaigns.docking import columns, dock_once, make_charger
from deltacharger_lab.campaigns.draw import draw
from deltacharger_lab.campaigns.parts import build_parts
from deltacharger_lab.campaigns.scene import load_campaign_scene, parse_campaign_scene
from deltacharger_tactile import MODEL_PATHS
from deltacharger_tactile.second.parameters import SecondParameters
from deltacharger_tactile.source import ContactSource

from ..marks import rest
from .campaigns import QUICK, comparable


def test_a_high_row_is_ten_taxels_of_one_pad_drawn_per_docking() -> None:
    assert np.count_nonzero(high_row(1.5, 4)) == 10
    assert np.count_nonzero(high_row(1.5, 4).any(axis=2)) == 1
    rows = {tuple(np.argwhere(high_row(1.0, seed))[0][:2]) for seed in range(400)}
    assert len(rows) == 20
    np.testing.assert_array_equal(high_row(1.5, 4), 1.5 * high_row(1.0, 4))


@pytest.mark.parametrize("exact", [False, rest(True)])
def test_the_high_row_appears_after_the_tare_only(exact: bool) -> None:
    readings, content = [], {**QUICK, "taxels": {"high_row": 1.5}}
    for each in (content, QUICK):
        drawn = draw(parse_campaign_scene(each, "x"), 3, 0, "guarded")
        charger = make_charger(drawn, exact)
        charger.begin(docking.DockGoal(drawn.goal))
        assert not charger.observe().tactile_contact
        charger.until(lambda charger=charger: charger._tared, 30.0)
        charger.run(0.05)
        readings.append((charger.baseline, charger.observe().tactile_contact, charger.excess))
    (high, feels, excess), (low, feels_not, none) = readings
    assert (feels, feels_not) == (True, False)
    assert none is None
    alive = np.isfinite(low)
    # The baseline is too small by this much.
    np.testing.assert_allclose((low - high)[alive], excess[alive], atol=1e-9)


def test_a_heading_turns_the_faces_back() -> None:
    world, _, _ = build_parts({"parked.heading": 0.03, "world.target.tilt_y": 0.01}, "guarded")
    assert world.target.tilt_y == pytest.approx(-0.02)
    askew = dock_once(parse_campaign_scene({**QUICK, "parked": {"heading": 0.02}}, "x"), 3, 0, "guarded")
    faces = {**QUICK, "world": {**QUICK["world"], "target": {"tilt_y": -0.02}}}
    turned = dock_once(parse_campaign_scene(faces, "x"), 3, 0, "guarded")
    for row in askew, turned:
        row["parked.heading"] = row["world.target.tilt_y"] = 0.0
    assert comparable([askew]) == comparable([turned])


def test_docking_knows_that_there_are_no_magnets_but_not_how_strong_others_are() -> None:
    for force, assumed in ((0.0, 0.0), (50.0, DockingParameters().magnet_force)):
        assert build_parts({"world.magnets.force": force}, "guarded")[2].magnet_force == assumed
    assert build_parts({"world.magnets.force": 0.0, "docking.magnet_force": 40.0}, "guarded")[2].magnet_force == 40.0


def nudged(exact: bool = False, friction: float = 0.0, **nudge: float) -> dict[str, Any]:
    """Return the row of a docking with a nudged target."""
    world = {**QUICK["world"], "contact": {"friction": friction}}
    content = {**QUICK, "target": {}, "camera": {}, "world": world, "nudge": nudge}
    row = dock_once(parse_campaign_scene(content, "x"), 3, 0, "guarded", exact)
    assert row["error"] == ""
    return row


@pytest.mark.parametrize("exact", [False, rest(True)])
def test_turning_a_charging_target_ends_charging(exact: bool) -> None:
    row = nudged(exact, 0.3, roll=0.18, after=1.5)
    assert row["charged"]
    assert row["ended"] == "CRITICAL_ANGLE"
    # Two estimates detect it, two seconds apart; the first may be immediate.
    parameters = DockingParameters()
    assert parameters.clearance_period < row["nudge_opened"] < 2.0 * (parameters.clearance_period + 0.5)
    assert row["energised"] == pytest.approx(1.5 + row["nudge_opened"], abs=0.1)
    assert row["shorts"] == 0


def test_the_nudge_occurs_once_at_its_time() -> None:
    drawn = draw(parse_campaign_scene({**QUICK, "nudge": {"x": 0.002, "after": 1.0}}, "x"), 3, 0, "guarded")
    charger = make_charger(drawn, False)
    nudging = docking.Nudging(drawn.nudge, charger.world)
    charger.begin(docking.DockGoal(drawn.goal))
    start, places = charger.world.parameters.target.x, []
    while charger.now < 30.0:
        charger.tick()
        nudging.look()
        if (x := charger.world.parameters.target.x) != start or charger.world.record.energised < 1.0:
            places.append((charger.world.record.energised, x))
    began = [live for live, x in places if x == start][-1]
    assert began == pytest.approx(1.0, abs=0.09)
    assert places[-1][1] == pytest.approx(start + 0.002)
    assert [x for live, x in places if live > began + LASTS + 0.2] == pytest.approx(
        [start + 0.002] * sum(live > began + LASTS + 0.2 for live, _ in places)
    )
    assert math.isnan(nudging.opened)


def test_charging_continues_after_a_nudge_with_clearance() -> None:
    row = nudged(x=0.001, after=1.5)
    assert row["ended"] == ""
    assert math.isnan(row["nudge_opened"])
    assert row["energised"] > 1.5 + watched_after(DockingParameters())


def test_before_the_nudge_the_docking_is_unchanged() -> None:
    plain = dock_once(load_campaign_scene("default"), 7, 1, "guarded")
    content = {"based_on": "default", "nudge": {"y": 0.002, "roll": 0.02}}
    row = dock_once(parse_campaign_scene(content, "x"), 7, 1, "guarded")
    for name in ("seed", "goal_x", "place_y", "time", "final_vertical", "estimated_angle", "moves", "last_clearance"):
        assert row[name] == plain[name], name


def test_a_nudge_before_the_outcome_belongs_to_the_docking() -> None:
    row = nudged(friction=0.02, y=0.012, roll=0.15, after=0.3)
    assert not row["charged"]
    assert row["shorts"] == 1
    assert 0.0 < row["nudge_opened"] < 1.0


@pytest.mark.rest
def test_second_pads_are_made_by_name_and_pairs_stay_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def make(kind: str, tactile: Any, _: Any, *seeds: int) -> ContactSource:
        made.append(kind)
        return ContactSource(tactile, *seeds)

    monkeypatch.setattr(docking, "make_pads", make)
    scene = parse_campaign_scene({**QUICK, "pads": {"choose": ["first", "second"]}}, "x")
    rows = [dock_once(scene, 3, number, "guarded", exact=number == 0) for number in range(6)]
    assert [row["pads"] for row in rows] == made
    first = [number for number, kind in enumerate(made) if kind == "first"]
    assert set(made) == {"first", "second"}
    assert columns(scene)["pads"][0] is str
    plain = [
        dock_once(parse_campaign_scene(QUICK, "x"), 3, number, "guarded", exact=number == 0) for number in range(6)
    ]
    same = [{name: rows[number][name] for name in plain[0]} for number in first]
    assert comparable(same) == comparable([plain[number] for number in first])
    for name in ("seed", "rig_seed", "goal_x", "place_roll", "world.servo.stiffness"):
        assert [row[name] for row in rows] == [row[name] for row in plain]


def test_the_pose_model_is_the_named_one() -> None:
    for name, threshold in zip(("packaged", "1N"), MODEL_PATHS, strict=True):
        drawn = draw(parse_campaign_scene({**QUICK, "estimator": {"model": name}}, "x"), 3, 0, "guarded")
        charger = make_charger(drawn, False)
        docking.EstimateLog(charger, drawn.estimator, drawn.seed)
        assert charger.model.threshold == threshold
    assert pads.pose_model_from_one_newton() is pads.pose_model_from_one_newton()


@pytest.mark.parametrize("dead_band", [False, True])
def test_pads_with_a_dead_band_are_read_again(dead_band: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame of the first touch does not predict later ones if readings are not proportional to the force."""

    class Banded(ContactSource):
        def frames(self, *given: Any) -> Any:
            raw = super().frames(*given)
            return np.where(raw < 1.5, np.fmin(raw, 0.1), raw) if dead_band else raw

    monkeypatch.setattr(docking, "make_pads", lambda _, tactile, __, *seeds: Banded(tactile, *seeds))
    drawn = draw(parse_campaign_scene({**QUICK, "pads": "second"}, "x"), 3, 0, "guarded")
    charger = make_charger(drawn, False)
    charger.begin(docking.DockGoal(drawn.goal))
    found = []
    while charger.outcome is None and len(found) < 400:
        charger.tick()
        if charger._tared and charger.world.misalignment is not None:
            seen = charger.observe().tactile_contact
            most = float(np.nanmax(charger.feel(1, 0.0)[0] - charger.baseline))
            if abs(most - 1.0) > 0.4:
                found.append((seen, most >= 1.0))
    assert len(found) > 20
    assert all(seen is felt_now for seen, felt_now in found)


def test_the_second_family_yields_as_the_worlds_platform_unless_it_has_its_own() -> None:
    def compliance(world: float | None, own: float | None) -> float:
        content = {**QUICK, "pads": "second"}
        content |= {} if world is None else {"world": {"platform": {"compliance": world}}}
        content |= {} if own is None else {"second": {"platform": {"compliance": own}}}
        drawn = draw(parse_campaign_scene(content, "x"), 3, 0, "guarded")
        return (drawn.second or SecondParameters()).platform.compliance

    usual = SecondParameters().platform.compliance
    assert [compliance(*each) for each in ((None, None), (0.0, None), (0.03, None), (0.03, 0.01), (None, 0.01))] == [
        usual, usual, 0.03, 0.01, 0.01,
    ]  # fmt: skip
    assert compliance(1e-6, None) == 1e-4, "the stiffest that the family has"
    drawn = draw(
        parse_campaign_scene({"pads": "second", "second": {"sheet": {"dead_band": 0.5}}}, "x"), 3, 0, "guarded"
    )
    assert drawn.second.sheet.dead_band == 0.5
