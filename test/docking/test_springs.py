# SPDX-License-Identifier: Apache-2.0
"""Docking's value of the servos' stiffness: as configured until it is estimated."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest

from deltacharger_core.machine import SERVO_DAMPING, TORQUE_CONSTANT
from deltacharger_core.script import Script
from deltacharger_docking.codes import Code, State
from deltacharger_docking.context import Context
from deltacharger_docking.observation import Decision, DockGoal, Observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.springs import Springs
from deltacharger_driver.servos.mx64 import TICK
from deltacharger_kinematics.geometry import Vector
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import MagnetParameters, ServoParameters

from .dockings import assert_safe_at_home, charger

STILL: Vector = (0.0, 0.0, 0.0)
PRESSED: Vector = (0.45, 0.6, 0.35)
"""Currents (A) of the servos in the band, with the arm's weight on the second."""


def feel(springs: Springs, stiffness: float, currents: Vector = PRESSED, rates: Vector = STILL) -> None:
    """Give readings of springs of `stiffness` (N·m/rad) under currents (A) at rates (rad/s)."""
    goals = tuple(
        (TORQUE_CONSTANT * current + SERVO_DAMPING * rate) / stiffness
        for current, rate in zip(currents, rates, strict=True)
    )
    springs.add_reading((goals[0], goals[1], goals[2]), STILL, rates, currents)


def configured(stiffness: float) -> Springs:
    return Springs(DockingParameters(servo_stiffness=stiffness))


def decisions(run: VirtualCharger) -> list[Decision]:
    """Every decision from now on."""
    found: list[Decision] = []
    step = run.machine.step

    def watched(observation: Observation):  # type: ignore[no-untyped-def]
        command = step(observation)
        found.extend(command.decisions)
        return command

    run.machine.step = watched  # type: ignore[method-assign]
    return found


@pytest.mark.parametrize("true", [2.0, 15.0, 40.0])
@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_the_estimated_stiffness_overrides_the_configured_one(true: float, factor: float) -> None:
    springs = configured(factor * true)
    feel(springs, true)
    assert springs.is_estimated
    assert springs.stiffness == pytest.approx(true)
    assert springs.compliance == pytest.approx(TORQUE_CONSTANT / true)
    assert springs.lag == pytest.approx(SERVO_DAMPING / true)


def test_a_moving_arm_gives_as_good_an_estimate_as_one_at_rest() -> None:
    springs = configured(40.0)
    feel(springs, 4.0, rates=(-0.05, -0.08, 0.02))
    assert springs.stiffness == pytest.approx(4.0)


def test_encoder_resolution_costs_little_accuracy() -> None:
    source = random.Random(1)
    worst = 0.0
    for _ in range(200):
        springs = configured(20.0)
        noise = [source.uniform(-0.5, 0.5) * TICK + source.uniform(-0.5, 0.5) * TICK for _ in range(3)]
        goals = [TORQUE_CONSTANT * current / 40.0 + each for current, each in zip(PRESSED, noise, strict=True)]
        springs.add_reading((goals[0], goals[1], goals[2]), STILL, STILL, PRESSED)
        worst = max(worst, abs(springs.stiffness / 40.0 - 1.0))
    assert worst < 0.08


SILENT: dict[str, tuple[Vector, Vector]] = {
    "no load": ((0.02, 0.02, 0.02), (0.01, 0.0, -0.01)),
    "less than encoders resolve": ((0.001, 0.001, 0.001), PRESSED),
    "driven the wrong way": ((-0.04, -0.06, -0.03), PRESSED),
    "no common spring": ((0.3, -0.2, 0.25), PRESSED),
    "softer than the parameter may be": ((9.0, 9.0, 9.0), PRESSED),
    "no angle": ((math.nan, 0.06, 0.03), PRESSED),
    "no current": ((0.04, 0.06, 0.03), (math.nan, math.nan, math.nan)),
}
"""Lags (rad) and currents (A) that do not fit a spring."""


@pytest.mark.parametrize(("lags", "currents"), SILENT.values(), ids=SILENT)
def test_readings_that_no_spring_explains_are_ignored(lags: Vector, currents: Vector) -> None:
    springs = configured(15.0)
    springs.add_reading(lags, STILL, STILL, currents)
    assert not springs.is_estimated
    assert springs.stiffness == pytest.approx(15.0)
    feel(springs, 5.0)
    springs.add_reading(lags, STILL, STILL, currents)
    assert springs.stiffness == pytest.approx(5.0), "what was felt stays"


def test_new_readings_soon_outweigh_old_ones() -> None:
    springs = configured(15.0)
    for _ in range(20):
        feel(springs, 30.0)
    for _ in range(3):
        feel(springs, 10.0)  # servo_node was started with other gains
    assert springs.stiffness == pytest.approx(10.0, rel=0.1)


def test_a_reading_that_contradicts_earlier_ones_replaces_them() -> None:
    springs = configured(15.0)
    for wrong in (60.0, 1.5):
        feel(springs, wrong)
        feel(springs, 15.0, (0.1, 0.12, -0.05))
        assert springs.stiffness == pytest.approx(15.0), "even where it is lighter"


@pytest.mark.parametrize("after", [0.3, 0.6])
def test_a_repeated_servo_state_is_ignored(after: float) -> None:
    up = {"gravity_y": 0.0, "gravity_z": -9.81}  # equal load on all three servos, as under a push
    run = charger(parameters=up, **up)
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.CONTACT, 30.0)
    run.run(after)
    held = run.observe()
    run.distort = lambda now: replace(now, angles=held.angles, currents=held.currents)
    run.run(6.0)
    assert run.machine.planner.springs.stiffness == pytest.approx(15.0, rel=0.1)


@pytest.mark.parametrize(
    ("given", "felt", "named"), [(15.0, 15.0, False), (15.0, 11.0, False), (15.0, 4.0, True), (15.0, 40.0, True)]
)
def test_a_wrong_stiffness_is_reported_with_the_command_that_measures_it(
    given: float, felt: float, named: bool
) -> None:
    springs = configured(given)
    assert springs.contradiction == ""
    feel(springs, felt)
    assert ("calibrate servos" in springs.contradiction) is named
    if named:
        assert f"{felt:.1f} N·m/rad, but servo_stiffness is {given:g}" in springs.contradiction


@pytest.mark.parametrize(("true", "given"), [(2.0, 8.0), (3.0, 0.75), (15.0, 60.0), (40.0, 10.0)])
def test_an_arm_of_unmeasured_stiffness_docks_in_its_band(true: float, given: float) -> None:
    run = charger(parameters={"servo_stiffness": given}, servo=ServoParameters(stiffness=true))
    found = decisions(run)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert 0.4 <= outcome.contact_current <= 0.5
    context = run.machine._context
    assert context.springs.stiffness == pytest.approx(true, rel=0.02)
    assert context.feed.lag == context.springs.lag, "lines are led by what was felt"
    weighed = [dict(each.values)["estimated_Nm_per_rad"] for each in found if each.kind == "stiffness"]
    # The weight hardly bends a stiff arm; the contact gives the estimate.
    assert weighed == ([] if true == 40.0 else [pytest.approx(true, rel=0.2)])


def test_the_estimate_is_kept_for_the_next_docking() -> None:
    run = charger(parameters={"servo_stiffness": 40.0}, servo=ServoParameters(stiffness=10.0))
    first = run.dock()
    assert first.success, first.message
    assert run.undock().success
    assert_safe_at_home(run)
    before, found = run.machine._context.springs.stiffness, decisions(run)
    second = run.dock()
    assert second.success, second.message
    weighed = next(each for each in found if each.kind == "stiffness")
    assert dict(weighed.values)["estimated_Nm_per_rad"] == pytest.approx(before, rel=0.1)


def test_readings_during_a_motion_are_ignored() -> None:
    run, found = charger(), []

    def script(context: Context) -> Script[str]:
        yield from context.torque_on()
        context.follow(context.planner.line(context.measured(), (0.0, 0.0, 0.05), 0.25))
        while context.feed.is_under_way(context.time):
            yield from context.read()
            found.append(context.springs.stiffness)
        return ""

    run.start(script)
    run.finish(10.0)
    assert len(found) > 2
    assert found == [15.0] * len(found)


def test_servos_at_their_current_bound_are_ignored() -> None:
    """The goal is farther and farther behind the target while the currents stay at their bound."""
    run, pushed = charger(0.0, 0.0, 0.0), []

    def script(context: Context) -> Script[str]:
        yield from context.torque_on()
        context.commanded = context.position
        for z in (0.090, 0.100, 0.108):
            yield from context.move((0.0, 0.0, z), 0.02)
            pushed.append(min(context.contact.currents))
        return ""

    run.start(script)
    run.finish(60.0)
    assert min(pushed[1:]) > 0.5
    assert run.machine._context.springs.stiffness == pytest.approx(15.0, rel=0.05)


def test_a_soft_arm_leaves_the_magnets_so_far_that_they_do_not_pull_it_back() -> None:
    run = charger(-8.0, -8.0, 8.0, 5, parameters={"servo_stiffness": 2.0}, servo=ServoParameters(stiffness=2.0))
    assert run.dock().success
    outcome = run.undock()
    assert outcome.success, outcome.message
    assert_safe_at_home(run)


@pytest.mark.parametrize(("given", "named"), [(15.0, False), (50.0, True)])
def test_a_stuck_arm_reports_a_wrong_stiffness(given: float, named: bool) -> None:
    run = charger(0.0, 0.0, parameters={"servo_stiffness": given}, magnets=MagnetParameters(force=200.0))
    run.dock()
    outcome = run.undock()
    assert outcome.code is Code.STUCK
    assert ("calibrate servos" in outcome.message) is named
