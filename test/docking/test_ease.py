# SPDX-License-Identifier: Apache-2.0
"""The arm at ease: no servo carries more than its share for hours, as far as friction holds."""

from __future__ import annotations

import math

import pytest

from deltacharger_docking.observation import Decision, DockGoal, ElectrodePose
from deltacharger_docking.parameters import DockingParameters
from deltacharger_driver.servos.thermal import ThermalModel
from deltacharger_kinematics.geometry import Vector
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import ContactParameters, ServoParameters, TargetParameters, WorldParameters

from ..marks import rest

MILLIMETRE = 1e-3
DOWN = (0.0, -9.81, 0.0)
HOURS = 4 * 3600.0


def charger(
    x: float, y: float, stiffness: float, gravity: Vector, believed: float | None = None, friction: float = 0.3
) -> VirtualCharger:
    """A charger before a target at (x, y) mm."""
    world = WorldParameters(
        target=TargetParameters(x=x * MILLIMETRE, y=y * MILLIMETRE, roll=math.radians(2.0)),
        servo=ServoParameters(stiffness=stiffness),
        contact=ContactParameters(friction=friction),
        gravity_x=gravity[0],
        gravity_y=gravity[1],
        gravity_z=gravity[2],
    )
    parameters = DockingParameters(
        servo_stiffness=believed or stiffness, gravity_x=gravity[0], gravity_y=gravity[1], gravity_z=gravity[2]
    )
    return VirtualCharger(world, parameters)


def decisions(run: VirtualCharger) -> list[Decision]:
    """Collect the machine's decisions from now on."""
    found: list[Decision] = []
    step = run.machine.step

    def listen(observation):  # type: ignore[no-untyped-def]
        command = step(observation)
        found.extend(command.decisions)
        return command

    run.machine.step = listen  # type: ignore[method-assign]
    return found


def currents(run: VirtualCharger) -> list[float]:
    """The servos' currents (A) without noise."""
    constant = run.world.parameters.servo.torque_constant
    return [torque / constant for torque in run.world.mechanics.torques]


SIDEWAYS = [DOWN, (9.81, 0.0, 0.0), (-7.0, 7.0, 0.0)]
CASES = [
    *((3.0, -2.0, 15.0, gravity, None) for gravity in SIDEWAYS),
    rest(-18.0, -18.0, 15.0, DOWN, None),
    rest(18.0, 18.0, 10.0, DOWN, None),
    rest(3.0, -2.0, 2.5, DOWN, None),
    (3.0, -2.0, 20.0, DOWN, 15.0),
    rest(3.0, -2.0, 10.0, DOWN, 16.0),
]


@pytest.mark.parametrize(("x", "y", "stiffness", "gravity", "believed"), CASES)
def test_every_servo_can_hold_its_pressing_current_for_four_hours(
    x: float, y: float, stiffness: float, gravity: Vector, believed: float | None
) -> None:
    run = charger(x, y, stiffness, gravity, believed)
    found = decisions(run)
    outcome = run.dock(DockGoal(ElectrodePose((x * MILLIMETRE, y * MILLIMETRE, 0.080), 0.0)))
    assert outcome.success, outcome.message
    assert 0.4 <= outcome.contact_current <= 0.5
    run.run(1.0)
    assert 0.4 <= run.machine.status.contact_current <= 0.5
    hottest = max(map(abs, currents(run)))
    eased = dict(next(each for each in found if each.kind == "eased").values)
    assert eased["slip_m"] < 0.1 * MILLIMETRE
    assert hottest < 0.52
    model = ThermalModel()
    model.update(hottest, HOURS)
    assert model.reserve() == math.inf
    before = ThermalModel()
    before.update(eased["hottest_before_A"], HOURS)
    assert before.reserve() == 0.0, "with the weight on the servos it would have been too much"


def test_four_hours_in_the_simulated_world_change_nothing() -> None:
    run = charger(3.0, -2.0, 15.0, DOWN)
    assert run.dock().success
    run.run(0.5)
    place, force, load = run.world.mechanics.position, run.world.snapshot().contact_force, currents(run)
    for _ in range(int(HOURS / 10.0)):
        run.world.step(10.0)
    assert math.dist(place, run.world.mechanics.position) < 0.01 * MILLIMETRE
    assert run.world.snapshot().contact_force == pytest.approx(force, abs=0.1)
    assert currents(run) == pytest.approx(load, abs=0.005)
    assert run.world.record.energised_unsafe == 0.0
    assert max(run.world.servo(index)[4] for index in range(3)) < 40.0


def test_weight_along_the_push_remains_on_the_servos() -> None:
    """No friction carries it: it adds 0.09 A to each servo."""
    for gravity, expected in (((0.0, 0.0, 9.81), 0.36), ((0.0, 0.0, -9.81), 0.54)):
        run = charger(3.0, -2.0, 15.0, gravity)
        assert run.dock().success
        assert max(map(abs, currents(run))) == pytest.approx(expected, abs=0.04)


@pytest.mark.parametrize("stiffness", [5.0, 15.0])
def test_if_friction_does_not_hold_the_weight_remains_on_the_servos(stiffness: float) -> None:
    run = charger(3.0, -2.0, stiffness, DOWN, friction=0.01)
    found = decisions(run)
    outcome = run.dock()
    assert outcome.success, outcome.message
    kinds = [each.kind for each in found]
    assert "slipped" in kinds
    eased = dict([each for each in found if each.kind == "eased"][-1].values)
    assert eased["slip_m"] < 1.5 * MILLIMETRE
    assert eased["hottest_A"] > 0.55
    assert 0.4 <= outcome.contact_current <= 0.5
    rests = run.world.mechanics.position
    run.run(3.0)
    assert math.dist(rests, run.world.mechanics.position) < 0.1 * MILLIMETRE, "it does not go on slipping"
    assert run.world.record.energised_unsafe == 0.0


def test_clearance_is_measured_after_easing_and_before_probing() -> None:
    run = charger(3.0, -2.0, 15.0, DOWN)
    found = decisions(run)
    assert run.dock().success
    kinds = [each.kind for each in found]
    last = len(kinds) - 1 - kinds[::-1].index("eased")
    assert "measured" in kinds[last : kinds.index("probe")]
    assert kinds.index("close") > kinds.index("probe") > last


@pytest.mark.parametrize("changes", [{"approach": "paper"}, rest({"current_signal": "max"})])
def test_approaches_as_published_are_not_eased(changes: dict[str, str]) -> None:
    world = WorldParameters(servo=ServoParameters(stiffness=2.5))
    run = VirtualCharger(world, DockingParameters(servo_stiffness=2.5, **changes))  # type: ignore[arg-type]
    found = decisions(run)
    run.dock(DockGoal(GOAL, start_charging=False))
    assert "eased" not in [each.kind for each in found]
