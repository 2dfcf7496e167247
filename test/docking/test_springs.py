# SPDX-License-Identifier: Apache-2.0
"""What the servos' currents tell: the push, the stiffness of their springs, and an arm at ease for hours."""

import math

import pytest

from deltacharger_core import machine, servo_types
from deltacharger_docking import arm, observation, parameters
from deltacharger_driver.servos.controller import ThermalModel
from deltacharger_kinematics.geometry import Vector
from deltacharger_sim.parameters import ContactParameters, ServoParameters
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

from ..marks import rest
from .dockings import MILLIMETRE, charger, commands, decisions

STILL: Vector = (0.0, 0.0, 0.0)
PRESSED: Vector = (0.45, 0.6, 0.35)
"""Currents (A) of the servos in the band, with the arm's weight on the second."""


def feel(springs: arm.Springs, stiffness: float, currents: Vector = PRESSED, rates: Vector = STILL) -> None:
    """Give readings of springs of `stiffness` (N·m/rad) under currents (A) at rates (rad/s)."""
    goals = tuple(
        (machine.TORQUE_CONSTANT * current + machine.SERVO_DAMPING * rate) / stiffness
        for current, rate in zip(currents, rates, strict=True)
    )
    springs.add_reading((goals[0], goals[1], goals[2]), STILL, rates, currents)


def configured(stiffness: float) -> arm.Springs:
    return arm.Springs(parameters.DockingParameters(servo_stiffness=stiffness))


@pytest.mark.parametrize("true", [2.0, 15.0, 40.0])
@pytest.mark.parametrize("factor", [0.25, 4.0])
@pytest.mark.parametrize("rates", [STILL, (-0.05, -0.08, 0.02)], ids=["at rest", "moving"])
def test_the_estimated_stiffness_overrides_the_configured_one(true: float, factor: float, rates: Vector) -> None:
    springs = configured(factor * true)
    feel(springs, true, rates=rates)
    assert springs.is_estimated
    assert springs.stiffness == pytest.approx(true)
    assert springs.compliance == pytest.approx(machine.TORQUE_CONSTANT / true)
    assert springs.lag == pytest.approx(machine.SERVO_DAMPING / true)


SILENT: dict[str, tuple[Vector, Vector]] = {
    "no load": ((0.02, 0.02, 0.02), (0.01, 0.0, -0.01)),
    "driven the wrong way": ((-0.04, -0.06, -0.03), PRESSED),
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


def along_axes(gravity: Vector) -> dict[str, float]:
    """Return the world's parameters of this gravity (m/s²)."""
    return dict(zip(("gravity_x", "gravity_y", "gravity_z"), gravity, strict=True))


@pytest.mark.parametrize(("true", "given"), [rest(4.0, 16.0), rest(3.0, 0.75), (15.0, 60.0), rest(40.0, 10.0)])
def test_an_arm_of_unmeasured_stiffness_docks_in_its_band(true: float, given: float) -> None:
    run = charger(parameters={"servo_stiffness": given}, servo=ServoParameters(stiffness=true), coarse=True)
    sent = commands(run)
    outcome = run.dock()
    assert outcome.success, outcome.message
    assert 0.4 <= outcome.contact_current <= 0.5
    context = run.machine._context
    assert context.springs.stiffness == pytest.approx(true, rel=0.02)
    assert context.feed.lag == context.springs.lag, "lines are led by what was felt"
    (swing,) = (dict(each.values)["stiffness_Nm_per_rad"] for each in decisions(sent, "swing"))
    assert swing == pytest.approx(true, rel=0.2) or true < 5.0, "a soft servo brakes too much: then contact shows it"


DOWN = (0.0, -9.81, 0.0)
HELD = 1.8 * 3600.0
"""s for which the thermal model allows 0.57 A: the middle of the band, 0.09 A that the gears rub in free motion, which
the tare takes out of the contact current, and 0.03 A of easing's tolerance and noise."""


def resting(
    x: float, y: float, stiffness: float, gravity: Vector, believed: float | None = None, friction: float = 0.3
) -> VirtualCharger:
    """A charger before a target at (x, y) mm."""
    servo, contact = ServoParameters(stiffness=stiffness), ContactParameters(friction=friction)
    given = {"servo_stiffness": believed or stiffness, "gravity": gravity}
    return charger(x, y, parameters=given, coarse=True, servo=servo, contact=contact, **along_axes(gravity))


def currents(run: VirtualCharger) -> list[float]:
    """The servos' currents (A) without noise."""
    constant = run.world.parameters.servo.torque_constant
    return [torque / constant for torque in run.world.mechanics.torques]


CASES = [
    (3.0, -2.0, 15.0, DOWN, None),
    rest(-18.0, -18.0, 15.0, (-7.0, 7.0, 0.0), None),
    rest(3.0, -2.0, 10.0, DOWN, 16.0),
]


@pytest.mark.parametrize(("x", "y", "stiffness", "gravity", "believed"), CASES)
def test_every_servo_can_hold_its_pressing_current_for_hours(
    x: float, y: float, stiffness: float, gravity: Vector, believed: float | None
) -> None:
    run = resting(x, y, stiffness, gravity, believed)
    sent = commands(run)
    outcome = run.dock(observation.DockGoal(observation.ElectrodePose((x * MILLIMETRE, y * MILLIMETRE, 0.080), 0.0)))
    assert outcome.success, outcome.message
    assert 0.4 <= outcome.contact_current <= 0.5
    run.run(1.0)
    assert 0.4 <= run.machine.status.contact_current <= 0.5
    hottest = max(map(abs, currents(run)))
    eased = dict(decisions(sent, "eased")[0].values)
    assert eased["slip_m"] < 0.2 * MILLIMETRE, "one count of an encoder at most"
    assert hottest < 0.57
    model = ThermalModel(servo_types.MX_64)
    model.update(hottest, HELD)
    assert model.reserve() > 0.0
    before = ThermalModel(servo_types.MX_64)
    before.update(eased["hottest_before_A"], HELD)
    assert before.reserve() == 0.0, "with the weight on the servos it would have been too much"
