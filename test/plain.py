# SPDX-License-Identifier: Apache-2.0
"""Servos for laws that have a closed form: springs, dampers and Coulomb friction, without what real gears add."""

from typing import Any

from deltacharger_sim.parameters import ServoParameters


def plain_servo(**changes: Any) -> ServoParameters:
    """Return a servo without viscosity, friction by load and noise by load."""
    return ServoParameters(**{"viscosity": 0.0, "friction_share": 0.0, "current_noise_share": 0.0} | changes)
