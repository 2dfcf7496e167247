# SPDX-License-Identifier: Apache-2.0
"""What the arm shows of itself before it touches, and what robots that yield or roll do to it.

An arm that could not stop, press or let go is refused before contact, by the name of what is wrong.
"""

import random
from itertools import permutations
from typing import Any

import pytest

from deltacharger_core import machine, servo_types
from deltacharger_docking import codes, observation
from deltacharger_driver.servos.registers import TICK
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.swing import fit_swing, swing_readings
from deltacharger_sim.parameters import CableParameters, MagnetParameters, ServoParameters, StandParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from .dockings import assert_safe_at_home, charger, commands, decisions

SWUNG = ((12.0, 0.4), (15.0, 0.75), (20.0, 1.0))
"""Stiffness (N·m/rad) and damping (N·m·s/rad) of three servos."""


def swing(draw: random.Random, goal: float = 0.09, friction: float = 0.12) -> list[tuple[float, Vector, Vector]]:
    """Readings of three servos after a jump of their goals (rad): in counts, noisy, with 1 mrad of play."""
    seen, angles, rates, dt = [], [0.0] * 3, [0.0] * 3, 1e-4
    for step in range(1500):
        torques = [k * (goal - a - 0.001) - d * rate for (k, d), a, rate in zip(SWUNG, angles, rates, strict=True)]
        if step % 100 == 0:
            counts = [round(angle / TICK) * TICK for angle in angles]
            noisy = [torque / machine.TORQUE_CONSTANT + draw.gauss(0.0, 0.01) for torque in torques]
            currents = [
                round(current / servo_types.MX_64.current_unit) * servo_types.MX_64.current_unit for current in noisy
            ]
            seen.append((step * dt, tuple(counts), tuple(currents)))
        for index, torque in enumerate(torques):
            rubbed = torque - friction if rates[index] >= 0.0 else torque + friction
            rates[index] += dt * rubbed / machine.SERVO_INERTIA
            angles[index] += dt * rates[index]
    return seen  # type: ignore[return-value]


def test_a_swing_shows_how_each_of_three_servos_springs_and_brakes() -> None:
    draw, goals, most = random.Random(1), (0.09,) * 3, (2.0,) * 3
    readings = [each for _ in range(4) for each in swing_readings(swing(draw), goals, most)]
    for found, (stiffness, damping) in zip(fit_swing(readings, machine.TORQUE_CONSTANT), SWUNG, strict=True):
        assert found.stiffness == pytest.approx(stiffness, rel=0.2)
        assert found.damping == pytest.approx(damping, rel=0.2)


def refused(run: VirtualCharger, code: codes.Code, *words: str, home: float = 0.01) -> None:
    """Dock: it is refused before contact for this reason, and the arm is limp, within `home` (m) of its home."""
    outcome = run.dock(observation.DockGoal(GOAL))
    assert outcome.code is code, outcome.message
    assert all(word in outcome.message for word in words), outcome.message
    assert run.world.record.contacts == 0
    assert run.world.snapshot().position[2] < home
    assert not run.observe().torque_enabled


@pytest.mark.parametrize(("number", "braking", "wrong"), [(1, 0.0, "swings"), (2, 0.0, "swings"), (3, 6.0, "creeps")])
def test_a_servo_with_a_wrong_d_gain_is_named_before_contact(number: int, braking: float, wrong: str) -> None:
    run = charger(coarse=True)
    command = run.world.command

    def braked(index: int, enabled: bool, goal: float, bound: float, *gains: float) -> None:
        command(index, enabled, goal, bound, 1.0, braking if index == number - 1 else 1.0)

    run.world.command = braked  # type: ignore[method-assign]
    refused(run, codes.Code.SERVO_FAULT, f"servo {number} {wrong}", "position_d_gain")


@pytest.mark.parametrize("limbs", list(permutations(range(3)))[1:])
def test_exchanged_servos_are_named_before_contact(limbs: tuple[int, ...]) -> None:
    """Each reaches its goal; only the arm's weight shows that they move other limbs."""
    run = charger(coarse=True)
    servo, command = run.world.servo, run.world.command
    run.world.servo = lambda index: servo(limbs[index])  # type: ignore[method-assign]
    run.world.command = lambda index, *order: command(limbs[index], *order)  # type: ignore[method-assign]
    wrong = [f"servo {number} limb {limb}" for number, limb in enumerate(limbs, 1) if limb != number - 1]
    refused(run, codes.Code.SERVO_FAULT, *wrong, "gravity")


def wear(run: VirtualCharger, number: int, friction: float) -> None:
    """Give the gear of one servo this friction (N·m)."""
    mechanics, set_inputs = run.world.mechanics, run.world.mechanics._set_inputs  # type: ignore[attr-defined]

    def worn(*given: Any) -> None:
        set_inputs(*given)
        servos = list(mechanics._servos)  # type: ignore[attr-defined]
        spring, damper, bound, _, goal = servos[number - 1]
        servos[number - 1] = spring, damper, bound, friction, goal
        mechanics._servos = tuple(servos)  # type: ignore[attr-defined]

    mechanics._set_inputs = worn  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("world", "worn", "culprit"),
    [
        ({}, 2, "servo 2"),
        ({"cable": CableParameters(drag=20.0)}, 0, "the cable or all gears rubs"),
        ({"servo": ServoParameters(friction=0.8)}, 0, "is farther from its goal"),
    ],
)
def test_friction_that_takes_what_pushing_needs_is_refused_by_its_culprit(
    world: dict[str, Any], worn: int, culprit: str
) -> None:
    run = charger(coarse=True, **world)
    if worn:
        wear(run, worn, 0.9)
    refused(run, codes.Code.SERVO_FAULT, culprit, home=0.04)


@pytest.mark.parametrize(("drag", "stronger"), [(0.0, False), (8.0, True)])
def test_friction_is_measured_although_it_holds_the_arm_on_a_short_way(drag: float, stronger: bool) -> None:
    """Free motion takes 4 N; a cable's 8 N, and what its load adds in the gears, hold the arm for more than 4 mm."""
    run = charger(coarse=True, cable=CableParameters(drag=drag))
    sent = commands(run)
    assert run.dock(observation.DockGoal(GOAL, start_charging=False)).success
    (found,) = (dict(each.values)["friction_force_N"] for each in decisions(sent, "friction"))
    assert (10.0 if stronger else 3.0) < found < (14.5 if stronger else 5.0)


def test_magnets_that_the_arm_could_not_leave_are_not_touched() -> None:
    run = charger(parameters={"magnet_force": 90.0}, magnets=MagnetParameters(force=90.0), coarse=True)
    refused(run, codes.Code.STUCK, "could not let go")


@pytest.mark.parametrize("coarse", [True, False])
def test_robots_that_yield_with_play_are_left_without_another_contact(coarse: bool) -> None:
    """Relieved, they swing back through their play and beyond: farther than they followed the magnets."""
    run = charger(0.0, 0.0, 0.0, coarse=coarse, stand=StandParameters(stiffness=5e3, play=0.002))
    outcome = run.dock()
    assert outcome.success, outcome.message
    contacts = run.world.record.contacts
    assert contacts == 1 + outcome.alignments + outcome.redockings
    outcome = run.undock()
    assert outcome.success, outcome.message
    assert run.world.record.contacts == contacts
    assert_safe_at_home(run)


def test_a_target_that_rolls_away_from_the_push_is_not_charged() -> None:
    run = charger(0.0, 0.0, 0.0, coarse=True, stand=StandParameters(stiffness=5e3, brakes=5.0))
    assert run.dock().code is codes.Code.TARGET_ROLLS
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


@pytest.mark.parametrize("brakes", [15.0, 20.0])
def test_a_target_that_comes_along_is_never_left_as_undocked_while_it_touches(brakes: float) -> None:
    run = charger(0.0, 0.0, 0.0, coarse=True, stand=StandParameters(stiffness=5e3, mass=10.0, brakes=brakes))
    assert run.dock().success
    outcome = run.undock()
    touches = run.world.mechanics.contact_force > 0.0
    assert outcome.code is (codes.Code.TARGET_ROLLS if touches else codes.Code.NONE), outcome.message
    assert run.machine.status.docked is touches
