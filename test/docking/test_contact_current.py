# SPDX-License-Identifier: Apache-2.0
"""The contact current is the servos' force along z less the holding force."""

from __future__ import annotations

import math
import random

import pytest

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_docking.contact_current import ContactCurrent
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.scalar import ScalarDelta


@pytest.mark.parametrize("gravity", [(0.0, -9.81, 0.0), (3.0, -5.0, 7.0)])
def test_force_comes_from_the_torques_less_the_holding_torques(gravity: tuple[float, float, float]) -> None:
    source, delta = random.Random(3), ScalarDelta()
    x, y, z = gravity
    parameters = DockingParameters(gravity_x=x, gravity_y=y, gravity_z=z)
    for _ in range(200):
        place = source.uniform(-0.06, 0.06), source.uniform(-0.06, 0.06), source.uniform(0.0, 0.11)
        angles = delta.inverse(*place)
        currents = (source.uniform(-1.0, 2.0), source.uniform(-1.0, 2.0), source.uniform(-1.0, 2.0))
        contact = ContactCurrent(delta, parameters)
        contact.update(0.0, angles, currents)
        held = delta.holding_torque(*contact.position, gravity)
        a, b, c = (current * TORQUE_CONSTANT - hold for current, hold in zip(currents, held, strict=True))
        assert contact.force == pytest.approx(delta.force(*contact.position, (a, b, c))[2], rel=1e-9, abs=1e-9)


def test_invalid_angles_give_nan_and_no_error() -> None:
    contact = ContactCurrent(ScalarDelta(), DockingParameters())
    for angles in ((math.nan, 0.0, 0.0), (math.inf, 0.0, 0.0)):
        contact.update(0.0, angles, (0.0, 0.0, 0.0))
        assert math.isnan(contact.value)
        assert math.isnan(contact.position[0])
    contact.update(0.1, ScalarDelta().inverse(0.0, 0.0, 0.08), (0.2, 0.2, 0.2))
    assert math.isfinite(contact.value)
