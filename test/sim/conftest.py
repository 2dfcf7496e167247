# SPDX-License-Identifier: Apache-2.0
"""An arm in simulated time: commanded by platform positions, in the real world model."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_core.machine import TORQUE_CONSTANT, ChargeLimits
from deltacharger_kinematics.geometry import LIMB_DIRECTIONS, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.emulators.power import EmulatedPower
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.world import World
from test.plain import plain_servo

DELTA = ScalarDelta()


class Arm:
    """A world whose commands compensate the arm's weight; `delta` is its kinematics."""

    delta = DELTA

    def __init__(self, parameters: WorldParameters | None = None, step: float = 0.005, tactile: Any = None) -> None:
        self.world = World(parameters or WorldParameters(servo=plain_servo()), tactile)
        self.power = EmulatedPower(self.world.circuit, self.world.parameters.stage, 0.0)
        self.step = step
        values = self.world.parameters
        self.gravity = (values.gravity_x, values.gravity_y, values.gravity_z)

    def aim(self, point: Vector, bound: float = 4.1, lead: bool = True) -> None:
        held = DELTA.holding_torque(*point, self.gravity)
        stiffness = self.world.parameters.servo.stiffness
        for index, (angle, torque) in enumerate(zip(DELTA.inverse(*point), held, strict=True)):
            self.world.command(index, True, angle + (torque / stiffness if lead else 0.0), bound)

    def release(self) -> None:
        for index in range(3):
            self.world.command(index, False, 0.0, 0.0)

    def run(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / self.step))):
            self.world.step(self.step)
            self.power.heartbeat(self.world.time)
            self.power.poll(self.world.time)

    def go(self, point: Vector, seconds: float = 1.0, bound: float = 4.1, lead: bool = True) -> None:
        self.aim(point, bound, lead)
        self.run(seconds)

    def dock(self, push: float = 0.0065) -> None:
        """Approach the default target and press with a command `push` (m) beyond its faces."""
        target = self.world.parameters.target
        self.go((target.x, target.y, target.z - 0.01), 0.6)
        self.go((target.x, target.y, target.z + push), 0.8)

    def charge(self, seconds: float = 1.0) -> None:
        """Dock, probe and close the contactor."""
        self.dock()
        self.power.start_probe(self.world.time)
        self.power.poll_probe(self.world.time)
        assert not self.power.close(ChargeLimits(10.0, 29.4), self.world.time)
        self.run(seconds)

    def energy(self) -> float:
        """Kinetic energy, weight and elastic energy of joint stops and electrodes of a limp arm (J)."""
        mechanics, geometry = self.world.mechanics, self.world.geometry
        mass = geometry.platform_mass + 1.5 * geometry.rod_mass
        total = 0.5 * mass * sum(v * v for v in mechanics.velocity)
        total += 0.5 * self.world.parameters.servo.inertia * sum(rate * rate for rate in mechanics.rates)
        total -= mass * sum(g * p for g, p in zip(self.gravity, mechanics.position, strict=True))
        elbow = 0.5 * geometry.rod_mass * geometry.arm
        for angle, (cosine, sine) in zip(mechanics.angles, LIMB_DIRECTIONS, strict=True):
            outward = self.gravity[0] * cosine + self.gravity[1] * sine
            total -= elbow * (self.gravity[2] * math.sin(angle) + outward * math.cos(angle))
            beyond = max(geometry.joint_min - angle, angle - geometry.joint_max, 0.0)
            total += 0.5 * 2000.0 * beyond * beyond
        return total + self.world.parameters.contact.stiffness * max(-mechanics.gap, 0.0) ** 2

    @property
    def contact_current(self) -> float:
        """Per-servo current (A) that pushes along +z, without the weight."""
        mechanics = self.world.mechanics
        held = DELTA.holding_torque(*mechanics.position, self.gravity)
        push = [torque - hold for torque, hold in zip(mechanics.torques, held, strict=True)]
        force = DELTA.force(*mechanics.position, (push[0], push[1], push[2]))[2]
        return force * sum(DELTA.jacobian(*mechanics.position)[6:]) / (3.0 * TORQUE_CONSTANT)


@pytest.fixture
def arm() -> Callable[..., Arm]:
    return Arm
