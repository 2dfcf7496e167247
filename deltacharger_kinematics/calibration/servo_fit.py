# SPDX-License-Identifier: Apache-2.0
"""Estimates stiffness, torque constant and friction of each servo by one least-squares fit over all readings at rest.

At rest, a servo that last turned in direction s holds the torque T = w L + s (f + g |T|). L is its share of the weight
of platform and rods, known from the pose up to a common factor w near 1; f is its friction without load, and g the
share of the torque that all gears take besides. The torque is visible twice: current = T / Kt, and goal − angle = T /
k. Unknown are k, Kt and f of each servo, g, and w, of which only the tolerance is known. As k, Kt and f all depend on
w, it enters all their standard errors. Also unknown is each arm's offset from its encoder, caused by play (the arm
hangs on one side of it) and by remaining errors of the geometry.

Interface to an arm whose servos are measured, and its readings at rest.
The same procedure runs over ROS and in virtual time; each provides a `ServoArm`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from deltacharger_core import arrays, machine
from deltacharger_kinematics.calibration.data import TICK
from deltacharger_kinematics.delta import Delta
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, Vector

WEIGHT_TOLERANCE = 0.02
"""Default relative standard deviation of the weight of platform and rods."""


class ServoTrouble(RuntimeError):
    """The servos cannot be measured, or the result is not credible. The message states the reason and the remedy."""


@dataclass(frozen=True)
class ServoTask:
    """Task of a measurement: known properties of the arm, duration, seed.

    Attributes:
        geometry: dimensions and masses.
        gravity: in charger_base, m/s².
        torque_constant: N·m/A by which servo_node converts torque bounds to currents.
        weight_tolerance: relative standard deviation of the weight of platform and rods.
        seconds: duration of the measurement.
        seed: seed of the order of the poses.
    """

    geometry: DeltaGeometry = field(default_factory=DeltaGeometry)
    gravity: Vector = machine.GRAVITY
    torque_constant: float = machine.TORQUE_CONSTANT
    weight_tolerance: float = WEIGHT_TOLERANCE
    seconds: float = 150.0
    seed: int = 0


@dataclass(frozen=True)
class ArmReadings:
    """Readings over some time, one per row: angles (n, 3) rad and signed currents (n, 3) A, as in servo_state."""

    angles: arrays.Array
    currents: arrays.Array


class ServoArm(Protocol):
    """An arm with its torque on and free to move."""

    def clock(self) -> float:
        """Return the time, s, from an arbitrary zero."""

    def goals(self) -> Vector:
        """Return the commanded angles, rad."""

    def follow(self, line: Sequence[tuple[float, Vector]], bound: Vector) -> None:
        """Move the goals linearly from point to point (s from now, rad), torque bounded (N·m); return at the end."""

    def read(self, seconds: float) -> ArmReadings:
        """Return the servo readings of the next `seconds`."""


@dataclass(frozen=True)
class StaticReading:
    """The arm at rest.

    Attributes:
        goals: commanded angles, rad, whole ticks.
        angles: encoder angles, rad.
        currents: means, A.
        current_errors: their standard errors, A.
        directions: last direction of rotation of each servo, +1 or −1, which gives the sign of friction; 0 = unknown.
    """

    goals: Vector
    angles: Vector
    currents: Vector
    current_errors: Vector
    directions: tuple[int, int, int]


def whole_ticks(angles: Sequence[float]) -> Vector:
    """Return angles (rad) rounded to whole encoder ticks."""
    first, second, third = (round(angle / TICK) * TICK for angle in angles)
    return first, second, third


def at_rest(goals: Vector, readings: ArmReadings, directions: tuple[int, int, int]) -> StaticReading:
    """Average readings at rest."""
    count = len(readings.currents)
    spread = np.std(readings.currents, axis=0, ddof=1)
    # Noise dithers the register's steps of 3.36 mA; a reading without noise is no more precise than the steps.
    errors = np.maximum(spread, 2e-3) / math.sqrt(count)
    return StaticReading(
        goals,
        _vector(np.mean(readings.angles, axis=0)),
        _vector(np.mean(readings.currents, axis=0)),
        _vector(errors),
        directions,
    )


def _vector(row: arrays.Array) -> Vector:
    return float(row[0]), float(row[1]), float(row[2])


ANGLE_ERROR = TICK / math.sqrt(12.0)
"""rad; goals are whole ticks, and readings are rounded to ticks."""
OFFSET_ERROR = 0.003
"""rad, standard deviation of an arm's offset from its encoder: half of the vendor's play of 20 arcminutes."""
_CREEP = 1e-4  # rad that an arm may still be short of rest
_ROUNDS = 12
_PRIORS = LIMB_COUNT + 2  # rows: of weight, offsets and share
_TURNED = 1e-4  # rad, for slopes of the loads
_WEIGHT = 3 * LIMB_COUNT  # index of the weight's factor; the three offsets and the share of the load follow
_SHARE, _SHARE_ERROR = 0.2, 0.15  # of the torque that a gear takes, and its standard deviation before the fit (BAM)
_TOO_FEW = "too few readings of servo {}: give more --seconds"
_FEWEST = 6  # readings of a servo, at least 2 per direction

STIFFNESS, CONSTANT, FRICTION = range(3)
"""Index of a servo's numbers."""


@dataclass(frozen=True)
class ServoFit:
    """Fitted values of all servos.

    Attributes:
        stiffness: N·m/rad, (3,).
        torque_constant: N·m/A, (3,).
        friction: N·m, (3,).
        weight: factor of the weight, near 1.
        friction_share: share of the torque that friction takes besides.
        covariance: of 3 × (stiffness, torque_constant, friction) and weight, (10, 10), in their units.
        current_residuals: in standard deviations, (n readings, 3); NaN if a servo's reading was not used.
        angle_residuals: the same for goal − angle.
        loads: each servo's share of the weight, N·m, (n, 3).
    """

    stiffness: arrays.Array
    torque_constant: arrays.Array
    friction: arrays.Array
    weight: float
    friction_share: float
    covariance: arrays.Array
    current_residuals: arrays.Array
    angle_residuals: arrays.Array
    loads: arrays.Array

    @property
    def scatter(self) -> float:
        """Root mean square of all residuals; about 1 if the assumed errors are correct."""
        both = np.concatenate([self.current_residuals, self.angle_residuals])
        return float(np.sqrt(np.nanmean(both**2)))

    def error(self, what: int) -> arrays.Array:
        """Return the standard errors (3,) of STIFFNESS, CONSTANT or FRICTION, in its unit."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[what : 3 * LIMB_COUNT : 3]))

    def common(self, what: int) -> tuple[float, float]:
        """Return the mean of STIFFNESS, CONSTANT or FRICTION over the servos, and its standard error.

        Less precise servos have less weight, unless the servos differ by more than their errors.
        """
        rows = slice(what, 3 * LIMB_COUNT, 3)
        values = (self.stiffness, self.torque_constant, self.friction)[what]
        own = self.own_error(what) ** 2
        between = max(0.0, float(np.var(values, ddof=1) - own.mean()))
        weights = 1.0 / (own + between)
        weights /= weights.sum()
        return float(weights @ values), float(np.sqrt(weights @ self.covariance[rows, rows] @ weights))

    def own_error(self, what: int) -> arrays.Array:
        """Return the standard errors (3,) for an exactly known weight, for comparing servos with each other."""
        rows = slice(what, 3 * LIMB_COUNT, 3)
        shared = self.covariance[rows, -1] ** 2 / self.covariance[-1, -1]
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance)[rows] - shared, 1e-18)))


@dataclass(frozen=True)
class _Table:
    """The readings as arrays (n, 3)."""

    loads: arrays.Array
    signs: arrays.Array
    currents: arrays.Array
    current_errors: arrays.Array
    errors: arrays.Array
    turning: arrays.Array  # (n, 3, 3): derivative of each servo's load by each arm's angle, N·m/rad


def loads_at(angles: arrays.Array, task: ServoTask) -> arrays.Array:
    """Return each servo's share of the weight (n, 3) N·m at arm angles (n, 3) rad; NaN for impossible angles."""
    delta = Delta(task.geometry)
    return delta.holding_torque(delta.forward(angles).position, task.gravity)


def fit_servos(readings: Sequence[StaticReading], task: ServoTask) -> ServoFit:
    """Fit all servos at once.

    Args:
        readings: at rest.
        task: known properties of the arm.

    Raises:
        ServoTrouble: there are too few readings, or the currents do not follow the weight.
    """
    if len(readings) < _FEWEST:
        raise ServoTrouble(_TOO_FEW.format(1))
    table = _table(readings, task)
    numbers = _first_guess(table)
    for _ in range(_ROUNDS):
        residuals, slopes = _linearise(numbers, table, task.weight_tolerance)
        step, *_ = np.linalg.lstsq(slopes, -residuals, rcond=None)
        numbers = numbers + np.clip(step, -0.7, 0.7)
        if np.abs(step).max() < 1e-10:
            break
    return _result(numbers, table, task)


def _table(readings: Sequence[StaticReading], task: ServoTask) -> _Table:
    encoders = np.array([reading.angles for reading in readings])
    turning = []
    for arm in np.eye(LIMB_COUNT) * _TURNED:
        turning.append((loads_at(encoders + arm, task) - loads_at(encoders - arm, task)) / (2.0 * _TURNED))
    return _Table(
        loads_at(encoders, task),
        np.array([reading.directions for reading in readings], dtype=float),
        np.array([reading.currents for reading in readings]),
        np.array([reading.current_errors for reading in readings]),
        np.array([reading.goals for reading in readings]) - encoders,
        np.stack(turning, axis=-1),
    )


def _first_guess(table: _Table) -> arrays.Array:
    """Return a first estimate of all numbers by linear fits to each servo's readings."""
    numbers = [1.0] * (_WEIGHT + 1) + [0.0] * LIMB_COUNT + [_SHARE]
    for servo in range(LIMB_COUNT):
        used = table.signs[:, servo] != 0.0
        signs = table.signs[used, servo]
        if used.sum() < _FEWEST or min((signs > 0).sum(), (signs < 0).sum()) < 2:
            raise ServoTrouble(_TOO_FEW.format(servo + 1))
        rows = np.stack([table.loads[used, servo], signs], axis=-1)
        (per_torque, rubbing), *_ = np.linalg.lstsq(rows, table.currents[used, servo], rcond=None)
        (softness, _), *_ = np.linalg.lstsq(rows, table.errors[used, servo], rcond=None)
        if per_torque <= 0.0 or softness <= 0.0:
            raise ServoTrouble(
                f"the current of servo {servo + 1} does not grow with the weight it should carry: correct gravity of "
                "docking_node or `direction` of servo_node, or fasten the platform"
            )
        numbers[3 * servo : 3 * servo + 3] = -math.log(softness), -math.log(per_torque), rubbing / per_torque
    return np.array(numbers)


def _linearise(numbers: arrays.Array, table: _Table, tolerance: float) -> tuple[arrays.Array, arrays.Array]:
    """Return residuals (rows) in standard deviations and their slopes (rows, 14); the priors are last."""
    residuals, slopes = [], []
    weight, offsets = numbers[_WEIGHT], numbers[_WEIGHT + 1 : -1]
    angle_error = math.hypot(ANGLE_ERROR, _CREEP)
    for servo in range(LIMB_COUNT):
        used = table.signs[:, servo] != 0.0
        turning, sign = table.turning[used, servo], table.signs[used, servo]
        load = table.loads[used, servo] + turning @ offsets
        ln_k, ln_constant, _ = numbers[3 * servo : 3 * servo + 3]
        torque, grip = _torques(numbers, servo, load, sign)
        measured = (
            (ln_k, STIFFNESS, table.errors[used, servo], np.full(load.shape, angle_error)),
            (ln_constant, CONSTANT, table.currents[used, servo], table.current_errors[used, servo]),
        )
        for logarithm, what, values, errors in measured:
            per_torque = math.exp(-logarithm) / errors
            rows = np.zeros((len(load), len(numbers)))
            rows[:, 3 * servo + what] = -torque * per_torque
            rows[:, 3 * servo + FRICTION] = sign * grip * per_torque
            rows[:, _WEIGHT] = load * grip * per_torque
            rows[:, _WEIGHT + 1 : -1] = weight * turning * (grip * per_torque)[:, None]
            rows[:, -1] = np.abs(torque) * sign * grip * per_torque
            residuals.append(torque * per_torque - values / errors)
            slopes.append(rows)
    priors = np.zeros((_PRIORS, len(numbers)))
    priors[:, _WEIGHT:] = np.diag([1.0 / tolerance] + [1.0 / OFFSET_ERROR] * LIMB_COUNT + [1.0 / _SHARE_ERROR])
    expected = np.zeros(len(numbers))
    expected[_WEIGHT], expected[-1] = 1.0, _SHARE
    residuals.append(priors @ (numbers - expected))
    return np.concatenate(residuals), np.concatenate([*slopes, priors])


def _torques(
    numbers: arrays.Array, servo: int, load: arrays.Array, sign: arrays.Array
) -> tuple[arrays.Array, arrays.Array]:
    """Return the motor's torques (N·m) that hold `load` after turning in a direction, and their slope by the load."""
    unloaded = numbers[_WEIGHT] * load + sign * numbers[3 * servo + FRICTION]
    grip = 1.0 / (1.0 - sign * np.sign(unloaded) * _share(numbers))
    return unloaded * grip, grip


def _share(numbers: arrays.Array) -> float:
    return min(max(float(numbers[-1]), -0.9), 0.9)


def _result(numbers: arrays.Array, table: _Table, task: ServoTask) -> ServoFit:
    residuals, slopes = _linearise(numbers, table, task.weight_tolerance)
    logarithms = numbers[:_WEIGHT].reshape(LIMB_COUNT, 3)
    by_reading = np.full((2, *table.signs.shape), math.nan)
    start = 0
    for servo in range(LIMB_COUNT):
        used = table.signs[:, servo] != 0.0
        for kind in range(2):
            by_reading[kind, used, servo] = residuals[start : start + used.sum()]
            start += int(used.sum())
    rows = len(residuals) - _PRIORS
    scatter = float(np.sum(residuals[:rows] ** 2) / max(1, rows - _WEIGHT))
    information = slopes[:rows].T @ slopes[:rows] / max(1.0, scatter) + slopes[rows:].T @ slopes[rows:]
    covariance: arrays.Array = np.asarray(np.linalg.inv(information)[: _WEIGHT + 1, : _WEIGHT + 1], dtype=float)
    stiffness, constant = np.exp(logarithms[:, STIFFNESS]), np.exp(logarithms[:, CONSTANT])
    units = np.append(np.stack([stiffness, constant, np.ones(LIMB_COUNT)], axis=-1).ravel(), 1.0)
    covariance *= np.outer(units, units)
    return ServoFit(
        np.asarray(stiffness),
        np.asarray(constant),
        logarithms[:, FRICTION],
        float(numbers[_WEIGHT]),
        _share(numbers),
        np.asarray(covariance),
        by_reading[1],
        by_reading[0],
        table.loads,
    )
