# SPDX-License-Identifier: Apache-2.0
"""An arm in virtual time with servo_node's behaviour: goals in whole ticks, angles and currents as in the registers.

Calibrations of hundreds of random arms need it: real time is too slow. It has servos and a world, but no docking.
"""

from collections.abc import Sequence

import numpy as np

from deltacharger_kinematics.calibration.servo_fit import ArmReadings, whole_ticks
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.world import World

PERIOD = 0.01  # s of a servo cycle


class VirtualArm:
    """A `ServoArm` in virtual time with its torque on.

    Args:
        parameters: of its world; a target in it would be in the way.
        seed: of the current noise.
        geometry: true dimensions.
        gains: of each servo's stiffness.
        assumed_constant: torque constant, N·m/A; converts torque bounds to current bounds.

    Attributes:
        now: elapsed time, s.
    """

    def __init__(
        self,
        parameters: WorldParameters,
        seed: int = 0,
        geometry: DeltaGeometry | None = None,
        gains: Vector = (1.0, 1.0, 1.0),
        assumed_constant: float | None = None,
    ) -> None:
        self.world = World(parameters, seed=seed, geometry=geometry)
        self.now = 0.0
        self._gains = gains
        self._constant = assumed_constant or parameters.servo.torque_constant
        self._goals = whole_ticks(self.world.mechanics.angles)
        self._bound: Vector = (1.0, 1.0, 1.0)
        self._let(1.0)

    def clock(self) -> float:
        """Return the time, s."""
        return self.now

    def goals(self) -> Vector:
        """Return the commanded angles, rad."""
        return self._goals

    def follow(self, line: Sequence[tuple[float, Vector]], bound: Vector) -> None:
        """Move the goals linearly from point to point (s from now, rad), with bounded torque (N·m)."""
        begin, start, since = self.now, self._goals, 0.0
        self._bound = (bound[0] / self._constant, bound[1] / self._constant, bound[2] / self._constant)
        for time, goals in line:
            while self.now - begin < time - 1e-9:
                share = min((self.now + PERIOD - begin - since) / (time - since), 1.0)
                between = [a + share * (b - a) for a, b in zip(start, goals, strict=True)]
                self._cycle(whole_ticks(between))
            start, since = goals, time
        self._goals = whole_ticks(start)
        self._cycle(self._goals)

    def read(self, seconds: float) -> ArmReadings:
        """Return the servos' readings in the next `seconds`."""
        rows = []
        for _ in range(round(seconds / PERIOD)):
            self._cycle(self._goals)
            rows.append([self.world.servo(index) for index in range(3)])
        states = np.array(rows)
        return ArmReadings(states[:, :, 0], states[:, :, 2])

    def _let(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self._cycle(self._goals)

    def _cycle(self, goals: Vector) -> None:
        self._goals = goals
        for index, (goal, bound, gain) in enumerate(zip(goals, self._bound, self._gains, strict=True)):
            self.world.command(index, True, goal, bound, gain)
        for _ in range(2):
            self.world.step(0.5 * PERIOD)
        self.now += PERIOD
