# SPDX-License-Identifier: Apache-2.0
"""Check whether the light model has been verified for a world's step and stiffnesses."""

from __future__ import annotations

import math
from collections.abc import Sequence

from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.stability_map import CELLS, CONTACT_STIFFNESSES, PROVEN, SERVO_STIFFNESSES, STEPS


class UnprovenWarning(UserWarning):
    """The simulation has not been verified for this step and these stiffnesses."""


def doubts(parameters: WorldParameters) -> tuple[str, ...]:
    """Return the doubts about a world's step and stiffnesses; empty if they are verified.

    Between points of the map, all neighbours must be verified. The map comes from `deltacharger report simulation`:
    nothing diverged, the settled force is within 0.5 % of a bisection, path and peak force are within 0.3 mm rms and
    15 % of the converged reference on the axis.
    """
    asked = parameters.servo.stiffness, parameters.contact.stiffness, parameters.step
    axes = (SERVO_STIFFNESSES, CONTACT_STIFFNESSES, STEPS)
    around = [_around(axis, value) for axis, value in zip(axes, asked, strict=True)]
    if all(around) and all(proven(i, j, k) for i in around[0] for j in around[1] for k in around[2]):
        return ()
    servo, contact, step = nearest(*asked)
    return (
        f"step {asked[2]:g} s with contact.stiffness {asked[1]:g} N/m and servo.stiffness {asked[0]:g} N·m/rad has "
        f"not been verified; the nearest verified point: step {step:g} s, contact.stiffness {contact:g} N/m, "
        f"servo.stiffness {servo:g} N·m/rad",
    )


def proven(servo: int, contact: int, step: int) -> bool:
    """Return whether the map's point with these indices is verified."""
    return CELLS[servo][contact][step] == PROVEN


def nearest(servo: float, contact: float, step: float) -> tuple[float, float, float]:
    """Return servo stiffness (N·m/rad), contact stiffness (N/m) and step (s) of the nearest verified point by ratio."""
    points = [
        (SERVO_STIFFNESSES[i], CONTACT_STIFFNESSES[j], STEPS[k])
        for i in range(len(SERVO_STIFFNESSES))
        for j in range(len(CONTACT_STIFFNESSES))
        for k in range(len(STEPS))
        if proven(i, j, k)
    ]
    asked = (servo, contact, step)
    return min(points, key=lambda point: sum(abs(math.log(a / b)) for a, b in zip(point, asked, strict=True)))


def _around(axis: Sequence[float], value: float) -> list[int]:
    """Return the indices of the one or two points of an axis around `value`; none outside."""
    same = [index for index, point in enumerate(axis) if math.isclose(point, value, rel_tol=1e-9)]
    if same:
        return same
    return [index for index in range(len(axis)) if _holds(axis, index, value) or _holds(axis, index - 1, value)]


def _holds(axis: Sequence[float], index: int, value: float) -> bool:
    return 0 <= index < len(axis) - 1 and axis[index] < value < axis[index + 1]
