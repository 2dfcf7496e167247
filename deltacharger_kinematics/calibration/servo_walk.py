# SPDX-License-Identifier: Apache-2.0
"""Lead an arm that stands free from place to place, read it at rest, and notice what should not be in its way."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import SERVO_DAMPING, SERVO_STIFFNESS
from deltacharger_kinematics.calibration.data import TICK
from deltacharger_kinematics.calibration.servo_arm import (
    ArmReadings,
    ServoArm,
    ServoTask,
    ServoTrouble,
    StaticReading,
    at_rest,
)
from deltacharger_kinematics.calibration.servo_fit import ServoFit, loads_at
from deltacharger_kinematics.calibration.servo_plan import SHORTEST, ServoModel, Way, seconds_of
from deltacharger_kinematics.geometry import LIMB_COUNT, Vector

PUSH = 0.6  # A beyond the arm's weight that a servo may use, as everywhere before contact
_SETTLED = 7.0  # time constants of the servos until what is left of a motion is less than a thousandth
_SOONEST, _LATEST = 0.1, 4.0  # s until the arm counts as settled
_READ = (0.2, 0.6)  # s of reading
_POINTS = 0.02  # s between points of a way
_STILL = 1.5 * TICK  # rad; what an encoder may vary at rest
_PATIENCE = 5  # readings until an arm that does not come to rest is given up
_FEWEST = 3  # messages in a reading
_TOLD = 0.03  # A; a current that tells something of the stiffness
_NEAR_BOUND = 0.93  # of a current bound that nobody should reach at rest
_STRANGE, _SHARE = 0.15, 0.3  # N·m, and share of the weight, that nothing but an obstacle explains
_SOFTEST, _STIFFEST = 1.0, 100.0  # N·m/rad that the search reckons with


class ArmWalk:
    """An arm between its places.

    Args:
        arm: with its torque on and nothing in its way.
        task: what is known of it.

    Attributes:
        model: what is known of its servos so far.
        fitted: whether that is more than a guess.
    """

    def __init__(self, arm: ServoArm, task: ServoTask) -> None:
        self.arm = arm
        self.task = task
        self.model = ServoModel(np.full(3, SERVO_STIFFNESS), np.full(3, 0.1))
        self.fitted = False
        self._began = arm.clock()
        self._constant = np.full(3, task.torque_constant)
        self._bound = np.full(3, np.inf)

    @property
    def spent(self) -> float:
        """How long it has taken so far, s."""
        return self.arm.clock() - self._began

    @property
    def settling(self) -> float:
        """How long the softest servo needs to come to rest, s."""
        return float(np.clip(_SETTLED * SERVO_DAMPING / self.model.stiffness.min(), _SOONEST, _LATEST))

    @property
    def reading_time(self) -> float:
        """How long it is read at rest, s."""
        return float(np.clip(self.settling, *_READ))

    def learn(self, fit: ServoFit) -> None:
        """Take over what is known of the servos."""
        self.model = ServoModel(np.clip(fit.stiffness, _SOFTEST, _STIFFEST), np.clip(np.abs(fit.friction), 0.005, 0.5))
        self._constant = fit.torque_constant
        self.fitted = True

    def look(self, reading: StaticReading) -> None:
        """Take a first idea of the stiffness from one place: torque over error of those servos that bear something."""
        errors, currents = np.subtract(reading.goals, reading.angles), np.array(reading.currents)
        tells = (np.abs(currents) > _TOLD) & (np.abs(errors) > 0.0)
        if tells.any():
            found = np.median(np.abs(self._constant[tells] * currents[tells] / errors[tells]))
            self.model = self.model._replace(stiffness=np.full(3, np.clip(found, _SOFTEST, _STIFFEST)))

    def loads(self, angles: Array) -> Array:
        """Return the weight's share of each servo (3,), N·m."""
        return np.asarray(loads_at(np.array([angles]), self.task)[0])

    def visit(self, way: Way) -> StaticReading:
        """Go a way and read the arm at rest at its end.

        Raises:
            ServoTrouble: it does not come to rest, or bears something other than its own weight.
        """
        self.lead(way.goals, way.angles)
        reading = self.rest(way.directions)
        self._check(reading)
        return reading

    def lead(self, goals: Vector, angles: Array) -> None:
        """Lead the goals to others, with which the arm will stand at `angles`; its torque is bounded."""
        here = np.abs(self.loads(self.arm.read(0.02).angles[-1]))
        most = np.fmax(here, np.abs(self.loads(angles))) + PUSH * self.task.torque_constant
        self._bound = most / self.task.torque_constant
        begin = self.arm.goals()
        seconds = max(float(seconds_of(np.subtract(goals, begin))), SHORTEST)
        self.arm.follow(eased(begin, goals, seconds), (float(most[0]), float(most[1]), float(most[2])))

    def step(self, goals: Vector, wait: float, read: float) -> StaticReading:
        """Set the goals at once and read after a while, whether at rest or not."""
        most = self._bound * self.task.torque_constant
        self.arm.follow([(0.02, goals)], (float(most[0]), float(most[1]), float(most[2])))
        self.arm.read(wait)
        return self._reading(self.arm.read(read), (0, 0, 0))

    def rest(self, directions: tuple[int, int, int] = (0, 0, 0)) -> StaticReading:
        """Wait until the arm is at rest and read it.

        Raises:
            ServoTrouble: it does not come to rest, or tells too little.
        """
        self.arm.read(self.settling)
        for _ in range(_PATIENCE):
            readings = self.arm.read(self.reading_time)
            if np.ptp(readings.angles, axis=0).max() <= _STILL:
                return self._reading(readings, directions)
        raise ServoTrouble(
            "the arm does not come to rest: take the target away and whatever pushes it, and look for a loose platform "
            "or rod, or for a position gain too high for it"
        )

    def _reading(self, readings: ArmReadings, directions: tuple[int, int, int]) -> StaticReading:
        if len(readings.currents) < _FEWEST:
            raise ServoTrouble("servo_state comes too rarely to measure by: look at `rate` of servo_node")
        return at_rest(self.arm.goals(), readings, directions)

    def _check(self, reading: StaticReading) -> None:
        """Stop where something other than the arm's own weight is borne."""
        currents, bound = np.abs(reading.currents), self._bound
        for servo in range(LIMB_COUNT):
            if currents[servo] > _NEAR_BOUND * bound[servo]:
                raise ServoTrouble(
                    f"servo {servo + 1} presses with its current bound of {bound[servo]:.2f} A and does not reach its "
                    "place: take away what blocks the platform, look for a jammed rod, and begin again"
                )
        if not self.fitted:
            return
        borne = self.loads(np.array(reading.angles))
        extra = np.abs(self._constant * np.array(reading.currents) - borne) - self.model.friction
        for servo in map(int, np.flatnonzero(extra > _STRANGE + _SHARE * np.abs(borne))):
            raise ServoTrouble(
                f"servo {servo + 1} bears {extra[servo]:.2f} N·m more than weight and friction at one place: something "
                "blocks the platform there; take it away, and begin again"
            )


def eased(begin: Vector, end: Vector, seconds: float) -> list[tuple[float, Vector]]:
    """Return points of a way that comes in ever slower, 1 − (1 − t)³: an arm that swung past would sit on less than its
    whole friction."""
    points = []
    for share in np.linspace(0.0, 1.0, max(4, round(seconds / _POINTS)) + 1)[1:]:
        way = 1.0 - (1.0 - share) ** 3
        first, second, third = (a + way * (b - a) for a, b in zip(begin, end, strict=True))
        points.append((float(share * seconds), (first, second, third)))
    return points
