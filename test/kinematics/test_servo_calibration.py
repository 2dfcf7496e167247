# SPDX-License-Identifier: Apache-2.0
"""Servos measured in virtual time: values, stated errors and refusals."""

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from deltacharger_core.machine import GRAVITY, TORQUE_CONSTANT
from deltacharger_kinematics.calibration import servo_fit, servo_procedure, servo_walk
from deltacharger_kinematics.delta import Delta
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_sim.parameters import ServoParameters, TargetParameters, WorldParameters
from test.plain import plain_servo

from ..marks import night, rest
from ..virtual_arm import VirtualArm

ALONE = TargetParameters(present=False)
SERVO = plain_servo(stiffness=12.0, friction=0.08, friction_share=0.2, backlash=0.004, torque_constant=1.3)
QUICK = servo_fit.ServoTask(seconds=80.0)


def arm(
    servo: ServoParameters = SERVO, gains: Vector = (1.0, 1.0, 1.0), weight: float = 1.0, **world: Any
) -> VirtualArm:
    known = DeltaGeometry()
    true = dataclasses.replace(known, platform_mass=weight * known.platform_mass, rod_mass=weight * known.rod_mass)
    parameters = WorldParameters(**{"servo": servo, "target": ALONE, **world})
    return VirtualArm(parameters, 1, true, gains, TORQUE_CONSTANT)


@pytest.fixture(scope="module")
def measured() -> servo_procedure.MeasuredArm:
    return servo_procedure.measure_servos(arm(), QUICK)


@pytest.mark.rest
def test_measured_values_match_the_servos(measured: servo_procedure.MeasuredArm) -> None:
    fit = measured.fit
    assert fit.stiffness == pytest.approx(SERVO.stiffness, rel=0.05)
    assert fit.torque_constant == pytest.approx(SERVO.torque_constant, rel=0.03)
    assert fit.friction == pytest.approx(SERVO.friction, rel=0.1)
    assert fit.friction_share == pytest.approx(SERVO.friction_share, abs=0.05)
    # The gears' friction takes its share of the swing: damping is the coarsest figure.
    assert [each.damping for each in measured.swings] == pytest.approx([SERVO.damping] * 3, rel=0.3)
    assert 0.7 < fit.scatter < 1.4
    assert not servo_procedure.doubts(measured, servo_procedure.Gains())
    assert not servo_procedure.differing(measured)
    saved = servo_procedure.to_file(measured, servo_procedure.Gains(500, 2))
    assert (saved.position_p_gain, saved.position_d_gain) == (500, 2)
    *servos, (mean, error) = servo_procedure.figures(measured)["stiffness"]
    assert min(servos)[0] <= saved.stiffness <= max(servos)[0]
    assert saved.stiffness == pytest.approx(mean, rel=1e-5)
    assert 0.015 < error / mean < 0.03  # the weight's tolerance, for any readings


@pytest.mark.rest
def test_a_servo_that_differs_is_named() -> None:
    found = servo_procedure.measure_servos(arm(gains=(1.0, 0.7, 1.0)), QUICK)
    assert found.fit.stiffness[1] == pytest.approx(0.7 * SERVO.stiffness, rel=0.05)
    (remark,) = servo_procedure.differing(found)
    assert "servo 2" in remark


def test_too_few_readings_are_refused() -> None:
    with pytest.raises(servo_fit.ServoTrouble, match="too few readings of servo 1"):
        servo_fit.fit_servos([], QUICK)


def test_every_move_turns_every_servo_and_stays_in_the_workspace() -> None:
    planner, delta = servo_walk.PosePlanner(QUICK), Delta(QUICK.geometry)
    model = servo_walk.ServoModel(np.full(3, 12.0), np.full(3, 0.08))
    angles = np.asarray(delta.inverse((0.0, 0.0, 0.05)).angles)
    goals = servo_fit.whole_ticks(angles)
    low, high = np.array(QUICK.geometry.workspace_min) - 0.005, np.array(QUICK.geometry.workspace_max) + 0.005
    for _ in range(50):
        way = planner.next(goals, angles, model, 0.03, 1.0)
        assert tuple(way.goals) == tuple(servo_fit.whole_ticks(np.array(way.goals)))
        assert (np.array(way.directions) * (way.angles - angles) >= 0.03).all()
        between = angles + np.linspace(0.0, 1.0, 9)[:, None] * (way.angles - angles)
        points = delta.forward(between).position
        assert ((points >= low) & (points <= high)).all()
        planner.learn(servo_fit.loads_at(way.angles[None], QUICK)[0], way.directions)
        goals, angles = way.goals, way.angles


def test_the_error_for_an_arm_out_of_reach_says_to_push_it() -> None:
    with pytest.raises(servo_fit.ServoTrouble, match="by hand"):
        servo_walk.PosePlanner(QUICK).middle(
            np.array((3.0, -3.0, 0.0)), servo_walk.ServoModel(np.full(3, 15.0), np.full(3, 0.1))
        )


LIGHT = dataclasses.replace(SERVO, torque_constant=TORQUE_CONSTANT)


@pytest.mark.parametrize(
    ("made", "gravity", "problem"),
    [
        rest(arm, (0.0, 9.81, 0.0), "does not grow with the weight"),
        night(arm, (0.0, -9.81 * 0.985, -9.81 * 0.174), "correct gravity"),
        night(lambda: arm(LIGHT, weight=0.6), GRAVITY, "weighs 0.6"),
        rest(lambda: arm(target=TargetParameters(z=0.045)), GRAVITY, "block"),
        night(lambda: arm(gains=(5.0, 5.0, 5.0)), GRAVITY, r"position_p_gain of servo_node to about [456]\d\d"),
    ],
)
def test_a_bad_arm_is_doubted_or_ends_it(made: Callable[[], VirtualArm], gravity: Vector, problem: str) -> None:
    task = dataclasses.replace(QUICK, gravity=gravity)
    try:
        found = servo_procedure.doubts(
            servo_procedure.measure_servos(made(), task),
            servo_procedure.Gains(2170 if "p_gain" in problem else servo_procedure.Gains().p),
        )[0]
    except servo_fit.ServoTrouble as trouble:
        found = str(trouble)
    assert re.search(problem, found)
