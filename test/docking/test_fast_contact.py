# SPDX-License-Identifier: Apache-2.0
"""Laws of press: contact is fast where nothing can be struck, and bounded wherever the target may be."""

from dataclasses import replace

import pytest

from deltacharger_docking import codes, observation
from deltacharger_sim.parameters import ContactParameters, ServoParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, TICK, VirtualCharger

from ..marks import rest
from .dockings import MILLIMETRE, assert_safe_at_home, charger, commands

STRIKE_MOST = 130.0
"""N without the magnets, on electrodes of 1e5 N/m, with impact. The magnets' snap takes 40 to 60. At the 0.12 m/s of
free travel, platform and rotors (0.012 kg·m², 0.11 m/rad together: 3.3 kg) take 69, and the servos push on."""


def until_lifted(run: VirtualCharger) -> None:
    """Dock up to where the electrodes have been lifted off to move sideways."""
    run.begin(observation.DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is codes.State.ALIGN, 60.0)
    z = run.world.snapshot().position[2]
    run.until(lambda: run.world.snapshot().position[2] < z - 4.0 * MILLIMETRE, 10.0)


def pushed(run: VirtualCharger) -> float:
    """Largest push (N) so far without the magnets' force, with impact, converted to electrodes of 1e5 N/m.

    At a given speed the impact grows with the root of the stiffness. Soft electrodes bottom out at their stop.
    """
    contact = run.world.parameters.contact
    bottoms = contact.stiffness * contact.hard_stop < 30.0  # N of one electrode under half of the magnets' pull
    stiffness = 0.5 * contact.hard_stop_stiffness if bottoms else contact.stiffness
    return max(run.world.record.peak_push, 0.0) / max(stiffness / 1e5, 1.0) ** 0.5


@pytest.mark.parametrize(
    ("servo", "contact"), [(15.0, 1e5), *(rest(servo, contact) for servo in (2.5, 5.0, 20.0) for contact in (1e4, 1e7))]
)
def test_the_search_ends_within_the_servos_reaction_after_touch(servo: float, contact: float) -> None:
    parameters = {"servo_stiffness": servo}
    run = charger(
        parameters=parameters,
        servo=ServoParameters(stiffness=servo),
        contact=ContactParameters(stiffness=contact),
    )
    sent = commands(run)
    run.begin(observation.DockGoal(GOAL))
    run.until(lambda: run.observe().tactile_contact, 60.0)
    earlier = len(sent) - 1
    run.run(2 * TICK)
    (first, *_) = [command.trajectory for command in sent[earlier:] if command.trajectory is not None]
    assert len(first) <= 1, "the goal stands still, or goes back to where the arm is"
    run.finish(120.0)
    assert run.world.record.contacts >= 1
    assert pushed(run) < STRIKE_MOST


@pytest.mark.parametrize("z", [rest(-8.0), rest(-3.0), rest(3.0), 8.0])
def test_a_wrong_known_place_does_no_harm(z: float) -> None:
    run = charger(9, 6, seed=2)
    until_lifted(run)
    context = run.machine._context
    assert context.known_contact is not None
    wrong = -z * MILLIMETRE  # the target is nearer or farther by z than its known place
    known = context.known_contact
    context.known_contact = replace(known, commanded=known.commanded + wrong, measured=known.measured + wrong)
    assert run.finish(120.0).success
    assert run.world.record.contacts >= 2
    assert pushed(run) < STRIKE_MOST


def test_a_target_that_disappeared_between_two_presses_is_reported() -> None:
    run = charger(9, 6, seed=2, coarse=True)
    until_lifted(run)
    target = run.world.parameters.target
    run.world.parameters = replace(run.world.parameters, target=replace(target, z=target.z + 0.060))
    run.world.mechanics._target_z = target.z + 0.060  # type: ignore[attr-defined]
    assert run.finish(120.0).code is codes.Code.NO_CONTACT
    assert_safe_at_home(run)
