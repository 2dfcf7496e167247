# SPDX-License-Identifier: Apache-2.0
"""How hard the servos really push on the target: their force along z at the platform, gravity and impacts apart."""

from __future__ import annotations

from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_lab.campaigns.virtual_charger import VirtualCharger
from deltacharger_sim.linkage import Linkage
from deltacharger_sim.mechanics import Mechanics


class Effort:
    """Largest push so far while in contact.

    The force of arms that turn by dθ = R dp is f = Rᵀ τ, here with τ of motors and gears less what holds the arm's
    weight. What the platform's own mass adds when it strikes a stiff target, which depends on the step, is not in it.

    Attributes:
        most: N along z, 0 where the electrodes were never in contact.
    """

    def __init__(self, charger: VirtualCharger) -> None:
        world = charger.world
        self._world = world
        self._linkage = Linkage(world.geometry)
        self._statics = ScalarDelta(world.geometry)
        parameters = world.parameters
        self._gravity = parameters.gravity_x, parameters.gravity_y, parameters.gravity_z
        self._of: tuple[object, ...] = ()
        self.most = 0.0

    def look(self) -> None:
        """Take the present push where it is larger."""
        mechanics = self._world.mechanics
        if not mechanics.contact_force > 0.0 or not isinstance(mechanics, Mechanics):
            return
        if self._of == (mechanics.torques, mechanics.gear):
            return
        self._of = mechanics.torques, mechanics.gear
        here = self._linkage.linearise(*mechanics.position)
        if here is None:
            return
        held = self._statics.holding_torque(*mechanics.position, self._gravity)
        push = sum(
            row[2] * (motor + gear - weight)
            for row, motor, gear, weight in zip(here[1], mechanics.torques, mechanics.gear, held, strict=True)
        )
        self.most = max(self.most, push)
