# SPDX-License-Identifier: Apache-2.0
"""Measures the servos of a free arm until the time is over, checks whether they are credible, builds their file."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deltacharger_core import arrays, machine, servo_types
from deltacharger_kinematics import geometry, swing
from deltacharger_kinematics.calibration import servo_fit, servo_walk

_FIRST_TURN, _TURN = 0.12, 0.03  # rad, smallest rotation of a servo before and after its friction is known
_ROUGH = 8  # readings between fits of the model
_SURELY_TURNED = 0.015  # rad of encoder rotation, more than any play
_SWING, _SWINGS = 0.9, 2  # A by which the goals jump, forward and back


@dataclass(frozen=True)
class MeasuredArm:
    """Measured servos of an arm.

    Attributes:
        readings: at rest, in order.
        fit: stiffness, torque constant and friction.
        swings: how each servo springs and brakes.
        seconds: duration of the measurement.
    """

    readings: tuple[servo_fit.StaticReading, ...]
    fit: servo_fit.ServoFit
    swings: tuple[swing.Swung, swing.Swung, swing.Swung]
    seconds: float


def measure_servos(
    arm: servo_fit.ServoArm, task: servo_fit.ServoTask, progress: Callable[[float], None] = lambda share: None
) -> MeasuredArm:
    """Measure the servos of an arm.

    Args:
        arm: with torque on and free to move.
        task: known properties of the arm.
        progress: called with the share done, 0 to 1.

    Raises:
        ServoTrouble: the arm is blocked or does not come to rest, or the currents do not follow the weight.
    """
    walk, planner, readings = (
        servo_walk.ArmWalk(arm, task),
        servo_walk.PosePlanner(task),
        list[servo_fit.StaticReading](),
    )
    angles = _begin(walk, planner)
    while walk.spent < task.seconds:
        progress(walk.spent / task.seconds)
        turn = _TURN if walk.fitted else _FIRST_TURN
        way = planner.next(arm.goals(), angles, walk.model, turn, walk.settling + walk.reading_time)
        reading = _surely_turned(walk.visit(way), angles)
        angles = np.array(reading.angles)
        if not any(reading.directions):
            continue
        readings.append(reading)
        planner.learn(walk.loads(angles), reading.directions)
        if len(readings) % _ROUGH == 0:
            walk.learn(servo_fit.fit_servos(readings, task))
    fit = servo_fit.fit_servos(readings, task)
    walk.learn(fit)
    swings = _swing(walk, planner, fit)
    progress(1.0)
    return MeasuredArm(tuple(readings), fit, swings, walk.spent)


def _swing(
    walk: servo_walk.ArmWalk, planner: servo_walk.PosePlanner, fit: servo_fit.ServoFit
) -> tuple[swing.Swung, swing.Swung, swing.Swung]:
    """Let the arm swing in the middle, forward and back."""
    walk.visit(planner.middle(walk.arm.read(0.1).angles[-1], walk.model))
    turn = _SWING * float(fit.common(servo_fit.CONSTANT)[0] / fit.common(servo_fit.STIFFNESS)[0])
    rows: list[swing.SwingReading] = []
    for sign in (1.0, -1.0) * _SWINGS:
        rows += walk.swing(sign * turn)
    return swing.fit_swing(rows, float(fit.common(servo_fit.CONSTANT)[0]))


def _begin(walk: servo_walk.ArmWalk, planner: servo_walk.PosePlanner) -> arrays.Array:
    """Estimate the stiffness roughly, and move to the middle."""
    reading = walk.rest()
    walk.look(reading)
    for _ in range(2):  # the first move uses a guess
        reading = walk.visit(planner.middle(np.array(reading.angles), walk.model))
        walk.look(reading)
    return np.array(reading.angles)


def _surely_turned(reading: servo_fit.StaticReading, before: arrays.Array) -> servo_fit.StaticReading:
    """Return a reading that counts only for the servos that turned in the planned direction."""
    turned = np.subtract(reading.angles, before) * reading.directions
    first, second, third = (
        direction if turn > _SURELY_TURNED and math.isfinite(turn) else 0
        for direction, turn in zip(reading.directions, turned, strict=True)
    )
    return servo_fit.StaticReading(
        reading.goals, reading.angles, reading.currents, reading.current_errors, (first, second, third)
    )


NAMES = ("stiffness", "torque constant", "friction")
UNITS = ("N·m/rad", "N·m/A", "N·m")
SOFTEST, STIFFEST = 2.0, 40.0
"""N·m/rad, range of stiffness with which docking was tested."""
UNEXPLAINED = 2.0
"""Scatter above which the weight does not explain the torques."""
FAR_CONSTANT = 0.3
"""Largest relative difference of a torque constant from the vendor's."""
_DIFFERS, _NOTICED = 4.0, 0.08  # standard errors and share above which a servo differs from the others
_UNSURE = 0.15  # largest relative standard error of a stiffness


@dataclass(frozen=True)
class Gains:
    """Gains of the position loop during the measurement."""

    p: int = machine.POSITION_P_GAIN
    d: int = machine.POSITION_D_GAIN


def doubts(measured: MeasuredArm, gains: Gains) -> list[str]:
    """Return the reasons not to use the measurement; empty = use it."""
    return [*_of_the_weight(measured.fit), *_of_the_numbers(measured, gains), *_of_the_swings(measured, gains)]


def _of_the_weight(fit: servo_fit.ServoFit) -> list[str]:
    found = []
    if fit.scatter > UNEXPLAINED:
        found.append(
            f"the torques do not match the arm's weight: they scatter {fit.scatter:.1f} times as much as noise and "
            "ticks explain; correct gravity of docking_node, remove the target, and check for a loose platform, rod or "
            "horn, a pulling cable and another geometry"
        )
    mean = fit.common(servo_fit.CONSTANT)[0]
    if abs(mean / machine.TORQUE_CONSTANT - 1.0) > FAR_CONSTANT:
        share = machine.TORQUE_CONSTANT / mean
        found.append(
            f"the torque constant of {mean:.2f} N·m/A is far from the vendor's {machine.TORQUE_CONSTANT:.2f}: probably "
            f"the arm weighs {share:.2f} times platform_mass and rod_mass; weigh the end effector, or screw it on"
        )
    return found


def _of_the_numbers(measured: MeasuredArm, gains: Gains) -> list[str]:
    fit, found = measured.fit, []
    for servo, (value, error) in enumerate(zip(fit.stiffness, fit.error(servo_fit.STIFFNESS), strict=True)):
        if value + 2.0 * error < SOFTEST or value - 2.0 * error > STIFFEST:
            better = max(1, round(gains.p * machine.SERVO_STIFFNESS / value))
            found.append(
                f"servo {servo + 1} has {value:.1f} N·m/rad, but docking was tested with {SOFTEST:g} to {STIFFEST:g}: "
                f"set position_p_gain of servo_node to about {better}, and measure again"
            )
    for servo, (value, error) in enumerate(zip(fit.stiffness, fit.error(servo_fit.STIFFNESS), strict=True)):
        if error > _UNSURE * value:
            found.append(
                f"the stiffness of servo {servo + 1} has an error of {100 * error / value:.0f} %: give more --seconds, "
                "or lower position_p_gain"
            )
    for servo, value in enumerate(fit.friction):
        if value <= 0.0:
            found.append(
                f"the friction of servo {servo + 1} is {value:.3f} N·m, which is not positive: something pulls the arm "
                "along, such as a cable or a hand; remove it"
            )
    return found


def _of_the_swings(measured: MeasuredArm, gains: Gains) -> list[str]:
    return [
        f"servo {number} swings: its damping is {each.damping:.2f} N·m·s/rad, below {swing.LEAST_DAMPING}: raise "
        f"position_d_gain of servo_node ({gains.d}), and measure again"
        for number, each in enumerate(measured.swings, 1)
        if swing.surely_swings(each)
    ]


def differing(measured: MeasuredArm) -> list[str]:
    """Return as text which servos differ from the other two by more than errors explain, and how."""
    fit, found = measured.fit, []
    for what, values in (
        (servo_fit.STIFFNESS, fit.stiffness),
        (servo_fit.CONSTANT, fit.torque_constant),
        (servo_fit.FRICTION, fit.friction),
    ):
        errors = fit.own_error(what)
        for servo in range(geometry.LIMB_COUNT):
            others = [other for other in range(geometry.LIMB_COUNT) if other != servo]
            mean, spread = float(values[others].mean()), float(np.hypot(*errors[others])) / 2.0
            alike = abs(values[others[0]] - values[others[1]]) <= 0.5 * abs(values[servo] - mean)
            sigmas = abs(values[servo] - mean) / math.hypot(errors[servo], spread)
            if alike and sigmas > _DIFFERS and abs(values[servo] / mean - 1.0) > _NOTICED:
                found.append(
                    f"the {NAMES[what]} of servo {servo + 1} differs from the others: {values[servo]:.3g} against "
                    f"{mean:.3g} {UNITS[what]}"
                )
    return found


def to_file(measured: MeasuredArm, gains: Gains) -> servo_types.MeasuredServos:
    """Return the content of the servos file.

    Raises:
        ParameterError: a value lies outside the bounds of the nodes.
    """
    stiffness, constant = (
        float(f"{measured.fit.common(what)[0]:.6g}") for what in (servo_fit.STIFFNESS, servo_fit.CONSTANT)
    )
    return servo_types.MeasuredServos(stiffness, constant, gains.p, gains.d)


def figures(measured: MeasuredArm) -> dict[str, list[tuple[float, float]]]:
    """Return value and standard error of each servo and then, but for damping, of the arm; NaN = not measured."""
    fit = measured.fit
    found = {
        name: [*zip(values.tolist(), fit.error(what).tolist(), strict=True), fit.common(what)]
        for name, what, values in (
            ("stiffness", servo_fit.STIFFNESS, fit.stiffness),
            ("torque_constant", servo_fit.CONSTANT, fit.torque_constant),
            ("friction", servo_fit.FRICTION, fit.friction),
        )
    }
    return {**found, "damping": [(each.damping, each.damping_stddev) for each in measured.swings]}
