# SPDX-License-Identifier: Apache-2.0
"""Faults of hostile dockings: the table is complete, each fault acts, comes and goes, and leaves nothing behind."""

import dataclasses
import math
import random
from typing import Any

import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_docking import codes, parameters
from deltacharger_docking.observation import Observation, Request, Service
from deltacharger_lab.campaigns import docking
from deltacharger_lab.campaigns.docking import columns, dock_once, run
from deltacharger_lab.campaigns.draw import draw
from deltacharger_lab.campaigns.faults import Acting
from deltacharger_lab.campaigns.hostile import FAULTS, SCENES, allowed, draw_fault, draw_faults
from deltacharger_lab.campaigns.scene import load_campaign_scene, parse_campaign_scene
from deltacharger_lab.campaigns.trial import ExactHostile, QuickHostile, Trial
from deltacharger_sim.pads import ContactSource
from deltacharger_sim.parameters import StandParameters, TargetParameters, WorldParameters
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

from .campaigns import comparable, scene

BY_NAME = {fault.name: fault for fault in FAULTS}
CHANNELS = ("order", "reading", "frame", "seen", "reply", "late", "target", "world", "steps")
TOUCHING = WorldParameters(target=TargetParameters(z=0.0), stand=StandParameters(stiffness=5e4))
FREE = WorldParameters(stand=StandParameters(stiffness=5e4))
LEFT = (-0.66, -0.68, -0.70)  # rad, 5 mm before home


def one(name: str, **changes: Any) -> Acting:
    """Return a fault as drawn, that begins at 0.1 s and stays."""
    drawn = draw_fault(BY_NAME[name], random.Random(5))
    given: dict[str, Any] = {"flicker": 0.0, "lasts": math.inf, "pad": 1, "ramp": 0.1, **changes}
    acting = dataclasses.replace(drawn, **given)
    acting.begin(0.1)
    return acting


def never(name: str) -> Acting:
    """Return a fault that does not begin."""
    acting = one(name)
    acting.since = math.inf
    return acting


class Bench:
    """A charger whose electrodes touch a target from the beginning, without a goal; a moving target is far away."""

    def __init__(self, *faults: Acting, exact: bool = False) -> None:
        world = FREE if any(a.fault.target is not None for a in faults) else TOUCHING
        self.trial = Trial("default", 1, list(faults))
        pads, used = self.trial.pads(ContactSource(None, 900, 1)), parameters.DockingParameters()
        self.charger = (
            ExactHostile(self.trial, world, used, 1, 900, pads)
            if exact
            else QuickHostile(self.trial, world, used, pads, 1, 900)
        )
        self.seen: list[Observation] = []
        self.charger.distort = self.see

    def see(self, observation: Observation) -> Observation:
        self.seen.append(self.trial.distort(observation))
        return self.seen[-1]

    def use(self) -> list[str]:
        """Use everything that a docking uses, and return what there was to see and what the world did."""
        charger, world = self.charger, self.charger.world
        charger._accept(Request(1, Service.TORQUE_ON))
        charger.run(0.15)
        charger._accept(Request(2, Service.TORQUE_ON))
        charger._goal = list(LEFT)
        for number, service in enumerate((Service.TARE, Service.ESTIMATE, Service.PROBE), 3):
            charger._accept(Request(number, service, frames=3))
            charger.run(0.25)
        close(charger)
        charger.run(0.3)
        charger.machine._context.energise = False
        charger.run(0.02)
        target, mechanics = world.parameters.target, world.mechanics
        true = (target, mechanics.position, mechanics.rubs, world.circuit.closed, mechanics.gap, mechanics.torques)
        return [*map(repr, self.seen), repr(true), repr(vars(mechanics._stand))]


def close(charger: VirtualCharger) -> None:
    """Close the contactor as if a probe had found a live port."""
    charger.power._probed, charger.power._probe_deadline = (math.nan, 24.0), math.inf
    charger.power.heartbeat(charger.now)
    assert not charger.power.close(ChargeLimits(10.0, 29.4), charger.now)
    charger._energised = charger.machine._context.energise = True


def test_the_table_is_complete() -> None:
    assert len(FAULTS) >= 40
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
    for fault in FAULTS:
        assert fault.codes.split(), fault.name
        assert {*fault.codes.split()} <= {code.name for code in codes.Code} - {"INTERNAL", "REJECTED"}, fault.name
        assert any(getattr(fault, channel) for channel in CHANNELS), fault.name
    assert set(SCENES) == {base.name for base in load_campaign_scene("hostile").bases}


@pytest.mark.parametrize("name", BY_NAME)
def test_each_fault_acts(name: str) -> None:
    assert Bench(one(name)).use() != Bench(never(name)).use()


def test_before_its_onset_no_fault_acts() -> None:
    assert Bench(never("servo_stays")).use() == Bench(never("pads_half")).use() == Bench().use()


def observed(name: str, exact: bool, seconds: float = 0.4, **changes: Any) -> tuple[Bench, Acting]:
    """Return a bench after some time of moving under a fault."""
    acting = one(name, **changes)
    bench = Bench(acting, exact=exact)
    bench.charger._accept(Request(1, Service.TORQUE_ON))
    bench.charger.run(0.05)
    bench.charger._goal = [-0.71, -0.71, -0.71]
    bench.charger.run(0.07)
    bench.charger._goal = list(LEFT)
    bench.charger.run(seconds)
    return bench, acting


@pytest.mark.parametrize("exact", [False, True])
def test_faults_distort_as_their_names_say(exact: bool) -> None:
    bench, _ = observed("servo_stays", exact, servo=1)
    assert bench.charger.world._reference == pytest.approx((LEFT[0], -0.71, LEFT[2]))
    bench, _ = observed("servo_limp", exact, servo=2)
    assert bench.charger.world._enabled == (True, True, False)
    bench, _ = observed("servo_slow", exact, servo=0, size=0.1)
    assert bench.charger.world._reference[0] == pytest.approx(-0.71 + 0.1 * 0.41, abs=0.003)
    bench, _ = observed("encoder_slips", exact, servo=1, size=0.02)
    world = bench.charger.world
    assert bench.seen[-1].angles[1] == pytest.approx(world.mechanics.angles[1] + 0.02, abs=0.001)
    assert world._reference[1] == pytest.approx(LEFT[1] - 0.02)
    bench, acting = observed("encoder_frozen", exact, servo=1)
    assert len({seen.angles[1] for seen in bench.seen[-20:]}) == 1
    assert bench.charger.world.mechanics.angles[1] != pytest.approx(acting.memory["angle"], abs=1e-4)
    bench, _ = observed("servo_late", exact, 0.6, size=0.3)
    late = bench.seen[-1]
    assert late.servo_age == pytest.approx(0.3, abs=0.02)
    then = min(bench.trial._log, key=lambda seen: abs(seen.time - late.time + late.servo_age))
    assert late.angles == then.angles
    bench, _ = observed("power_silent", exact)
    assert bench.seen[-1].power_age == pytest.approx(0.42, abs=0.03)
    bench, acting = observed("target_shakes", exact, size=0.003, ramp=0.5)
    assert abs(bench.charger.world.parameters.target.y) <= 0.003
    assert len({acting.world is bench.charger.world, acting.on}) == 1


@pytest.mark.parametrize(
    "name", ["target_shakes", "target_leaves", "target_turns", "gear_friction", "contactor_welded"]
)
def test_a_removed_fault_leaves_nothing_behind(name: str) -> None:
    bench = Bench(one(name))
    charger, world = bench.charger, bench.charger.world
    charger.run(0.2)
    close(charger)
    charger.run(0.3)
    bench.trial.remove()
    charger.run(0.5)
    charger.machine._context.energise = False
    charger.run(0.1)
    target = world.parameters.target
    assert (target.x, target.y, target.z % 0.08, target.roll) == pytest.approx((0.0,) * 4, abs=1e-9)
    assert world.mechanics.rubs == (world.parameters.servo.friction,) * 3
    assert not world.circuit.closed
    assert bench.trial.next_onset() == math.inf


def test_a_suspended_docking_is_not_stepped_and_loses_its_lease() -> None:
    bench = Bench(one("suspended", lasts=0.6))
    close(bench.charger)
    bench.charger.run(0.3)
    assert bench.charger.world.circuit.closed
    before = len(bench.seen)
    bench.charger.run(0.2)
    assert len(bench.seen) == before
    assert not bench.charger.world.circuit.closed


def test_codes_are_allowed_by_the_scene_and_by_faults_that_acted() -> None:
    assert allowed("lean5", [one("probe_silent"), never("tare_silent")]) == {
        "NONE",
        "LEANING",
        "NO_CHARGE_CURRENT",
        "POWER_STALE",
    }


def test_hostile_scenes_draw_from_one_of_their_bases() -> None:
    hostile, drawn = load_campaign_scene("hostile"), []
    for number in range(20):
        found = draw(hostile, 3, number)
        drawn.append(found.scene)
        plain = draw(load_campaign_scene(found.scene), 3, number)
        assert (found.world, found.goal, found.docking, found.seed) == (
            *(plain.world, plain.goal, plain.docking, plain.seed),
        )
    assert set(drawn) == set(SCENES)
    again = parse_campaign_scene(hostile.content, "hostile")
    assert (again.spreads, again.bases[1].spreads) == (hostile.spreads, hostile.bases[1].spreads)
    with pytest.raises(ValueError, match="no other packaged campaign"):
        parse_campaign_scene({"based_on": {"choose": ["default", "nowhere"]}}, "x")


def test_without_faults_a_trial_changes_no_docking() -> None:
    drawn = draw(scene(), 3, 0)
    trial = Trial("default", drawn.seed, [])
    plain, row = run(drawn), run(drawn, trial=trial)
    same = ("code", "time", "moves", "final_horizontal", "estimated_angle", "true_push", "clearance", "estimates")
    assert {name: row[name] for name in same} == {name: plain[name] for name in same}
    judged = trial.judged(row)
    assert (judged["goals"], judged["outcomes"], row["next_code"], judged["broken"]) == (3, 3, "NONE", "")


def test_a_hostile_docking_has_every_column_and_its_faults_even_if_it_crashes(monkeypatch: pytest.MonkeyPatch) -> None:
    hostile = load_campaign_scene("hostile")

    def fails(*_: Any) -> None:
        raise ZeroDivisionError("of the test")

    monkeypatch.setattr(docking.QuickHostile, "tick", fails)
    row = dock_once(hostile, 501, 3)
    assert set(row) == set(columns(hostile))
    assert all(isinstance(row[name], kind) or kind is float for name, (kind, _) in columns(hostile).items())
    assert (row["code_name"], row["broken"].split()[0]) == ("CRASHED", "crashed")
    assert row["faults"] == " ".join(a.fault.name for a in draw_faults(row["seed"]))
    assert comparable([row]) == comparable([dock_once(hostile, 501, 3)])
