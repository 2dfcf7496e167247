# SPDX-License-Identifier: Apache-2.0
"""Inverse and forward kinematics, Jacobian and statics of the inverted delta.

Formulas per limb at azimuth φ, in frame ``charger_base``. θ is zero radially outward and positive toward +z; w is
measured from the motor plane. u = x cosφ + y sinφ − D, v = y cosφ − x sinφ, w = z + z_offset,
K = u² + w² + v² + a² − L², Q = 4a²(u² + w²) − K². A limb reaches the point if Q ≥ 0. Its angle is
θ = atan2(Kw + σ√Q·u, Ku − σ√Q·w) with σ = −1 for a knee outward: one root, one arc tangent, no division. With unit rod
vectors r and levers b = −σ√Q/(2L), differentiating |p − c(θ)| = L gives the Jacobian J = R⁻¹ diag(b). Statics is its
transpose, τ = Jᵀ f. A limb's adjustment shifts D, v and w, replaces a and L, and offsets the true angle from the
commanded one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import GRAVITY, TORQUE_CONSTANT
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.solve import ForwardSolver, InverseSolver, LimbArrays, cross, dot
from deltacharger_kinematics.status import AHEAD, KNEE_OUT, KinematicsError, Status, WorkingMode

_DOUBLE = np.dtype(np.float64)


def as_point(value: Any) -> Vector | None:
    """Return the three floats of a single point without numpy's cost; None = use `as_vectors`."""
    kind = type(value)
    if kind is np.ndarray:
        return tuple(value.tolist()) if value.shape == (3,) and value.dtype is _DOUBLE else None
    if (kind is tuple or kind is list) and len(value) == 3:
        x, y, z = value
        return (x, y, z) if type(x) is type(y) is type(z) is float else None
    return None


def as_vectors(value: Any, name: str) -> Array:
    """Return `value` as float64 (..., 3).

    Raises:
        ValueError: names the argument; the values are no numbers or ragged, or the last axis is not 3.
    """
    try:
        array = np.asarray(np.ma.filled(value.astype(float), np.nan) if np.ma.isMaskedArray(value) else value)
    except ValueError as error:
        raise ValueError(f"{name}: rows of different lengths; give numbers (..., 3)") from error
    if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
        array = _converted(array, name)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name}: shape {array.shape}; give numbers (..., 3)")
    return array.astype(np.float64, copy=False)


def _converted(array: NDArray[np.generic], name: str) -> Array:
    if array.dtype.kind not in "fO" or (array.dtype.kind == "O" and not _all_numbers(array)):
        raise ValueError(f"{name}: {array.dtype} is not a supported number type; give floats (..., 3)")
    try:
        with np.errstate(over="ignore"):
            return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name}: {error}; give floats (..., 3)") from error


def _all_numbers(array: NDArray[np.generic]) -> bool:
    return all(isinstance(item, int | float | np.integer | np.floating) for item in array.flat)


def broadcast(first: Array, second: Array, name: str) -> tuple[Array, Array]:
    """Return both arrays with their common shape.

    Raises:
        ValueError: names the second argument; the shapes do not match.
    """
    try:
        shape = np.broadcast_shapes(first.shape, second.shape)
    except ValueError as error:
        raise ValueError(f"{name}: shape {second.shape} does not fit {first.shape} of position") from error
    return np.broadcast_to(first, shape), np.broadcast_to(second, shape)


class Inverse(NamedTuple):
    """Arm angles (..., 3) rad, status (...) of Status bits, margin (...) to the edge of reach.

    The margin is the smallest Q/(4a²(u² + w²)) of the limbs: 1 farthest from the edge, 0 on it, negative outside; NaN
    if the input is invalid or a limb's angle indeterminate. For one point status is a `Status` and margin a float.
    """

    angles: Array
    status: NDArray[np.uint32] | Status
    margin: Array | float


class Forward(NamedTuple):
    """Positions (..., 3) m in charger_base, status (...), determinant (...) of the unit rod vectors."""

    position: Array
    status: NDArray[np.uint32] | Status
    determinant: Array | float


class Jacobian(NamedTuple):
    """dp/dangle (..., 3, 3) m/rad, determinant (...) of the unit rod vectors, condition number (...).

    NaN if the point is out of reach. If the rods lie in a plane, the matrix is NaN and the condition infinite.
    """

    matrix: Array
    determinant: Array | float
    condition: Array | float


class Delta:
    """The delta of one geometry. Takes arrays (..., 3), returns float64; a bad point does not affect other points.

    Args:
        geometry: dimensions; None = the defaults.
        working_mode: side of each knee, −1 out, +1 in; `status.WORKING_MODES` lists all eight.
        assembly: +1 with the platform ahead of the elbows, −1 the mirror assembly.

    Raises:
        ValueError: names the argument.
    """

    def __init__(
        self, geometry: DeltaGeometry | None = None, *, working_mode: WorkingMode = KNEE_OUT, assembly: int = AHEAD
    ) -> None:
        self._scalar = ScalarDelta(geometry, working_mode=working_mode, assembly=assembly)
        self.geometry = geometry = self._scalar.geometry
        self._inverse = InverseSolver(geometry, working_mode, assembly)
        self._forward = ForwardSolver(geometry, working_mode, assembly)
        self._arrays = LimbArrays(geometry, working_mode)

    def inverse(self, position: ArrayLike, *, strict: bool = False, precise: bool = False) -> Inverse:
        """Return the arm angles for platform `position` (..., 3) m.

        The error is at most 8e-16 rad in the workspace and 4e-16 rad near the edge of reach. Reachability is decided
        exactly.

        Args:
            position: (..., 3) m in charger_base.
            strict: raise if any status is not OK.
            precise: solve every point in double-double: 4e-16 rad everywhere, at about ten times the cost.

        Raises:
            ValueError: `position` is not an array (..., 3) of numbers.
            KinematicsError: only with `strict`.
        """
        if point := as_point(position):
            solved = self._scalar.solve(*point, precise)
            if solved and not (strict and solved[1]):
                return Inverse(np.array(solved[0]), _STATUS.get(solved[1]) or Status(solved[1]), solved[2])
        points = as_vectors(position, "position")
        angles, status, margin = self._inverse.solve(points.reshape(-1, 3), precise)
        _raise_if(strict, status)
        if points.ndim == 1:
            return Inverse(angles[0], Status(int(status[0])), float(margin[0]))
        shape = points.shape[:-1]
        return Inverse(angles.reshape(points.shape), status.reshape(shape), margin.reshape(shape))

    def forward(self, angles: ArrayLike, *, strict: bool = False) -> Forward:
        """Return the platform position for arm `angles` (..., 3) rad.

        Raises:
            ValueError: `angles` is not an array (..., 3) of numbers.
            KinematicsError: only with `strict`, if any status is not OK.
        """
        if point := as_point(angles):
            solved = self._scalar.solve_forward(*point)
            if solved and not (strict and solved[1]):
                return Forward(np.array(solved[0]), _STATUS.get(solved[1]) or Status(solved[1]), solved[2])
        arms = as_vectors(angles, "angles")
        position, status, determinant = self._forward.solve(arms.reshape(-1, 3))
        _raise_if(strict, status)
        if arms.ndim == 1:
            return Forward(position[0], Status(int(status[0])), float(determinant[0]))
        shape = arms.shape[:-1]
        return Forward(position.reshape(arms.shape), status.reshape(shape), determinant.reshape(shape))

    def jacobian(self, position: ArrayLike) -> Jacobian:
        """Return the Jacobian at `position` (..., 3) m.

        Raises:
            ValueError: `position` is not an array (..., 3) of numbers.
        """
        points = as_vectors(position, "position")
        with np.errstate(invalid="ignore", divide="ignore", over="ignore", under="ignore"):
            rods, lever = self._rods(points)
            # Inverse by cross products: numpy's solver fails the entire batch for one singular point.
            r0, r1, r2 = rods[:, 0], rods[:, 1], rods[:, 2]
            columns = np.stack([cross(r1, r2), cross(r2, r0), cross(r0, r1)], axis=1)
            determinant = dot(r0, columns[:, 0])
            matrix = np.moveaxis(
                columns * (lever / np.where(determinant == 0.0, np.nan, determinant)), (0, 1), (-2, -1)
            )
        condition = np.where(np.isnan(determinant), np.nan, np.inf)
        usable = np.isfinite(matrix).all((-2, -1))
        condition[usable] = np.linalg.cond(matrix[usable])
        if points.ndim == 1:
            return Jacobian(matrix, float(determinant), float(condition))
        return Jacobian(matrix, determinant, condition)

    def torque(self, position: ArrayLike, force: ArrayLike) -> Array:
        """Return the arm torques (..., 3) N·m for the platform to exert `force` (..., 3) N at `position`.

        Raises:
            ValueError: names the argument that is not an array (..., 3) of numbers or does not match the other.
        """
        if (point := as_point(position)) and (push := as_point(force)):
            return np.array(self._scalar.torque(*point, push))
        points, pushes = _pair(position, force, "force")
        with np.errstate(invalid="ignore", over="ignore", under="ignore"):
            return np.asarray((self.jacobian(points).matrix * pushes[..., :, None]).sum(-2))

    def force(self, position: ArrayLike, torque: ArrayLike) -> Array:
        """Return the force (..., 3) N that the platform exerts for arm `torque` (..., 3) N·m.

        NaN if the point is out of reach, or a limb is at its edge, where a force along its rod needs no torque.

        Raises:
            ValueError: names the argument that is not an array (..., 3) of numbers or does not match the other.
        """
        if (point := as_point(position)) and (share := as_point(torque)):
            return np.array(self._scalar.force(*point, share))
        points, torques = _pair(position, torque, "torque")
        with np.errstate(invalid="ignore", divide="ignore", over="ignore", under="ignore"):
            rods, lever = self._rods(points)
            # f = J⁻ᵀ τ = Rᵀ diag(b)⁻¹ τ acts along the rods, so no matrix is inverted.
            along = np.moveaxis(torques, -1, 0) / np.where(lever == 0.0, np.nan, lever)
            return np.moveaxis((rods * along).sum(axis=1), 0, -1)

    def holding_torque(self, position: ArrayLike, gravity: ArrayLike = GRAVITY) -> Array:
        """Return the arm torques (..., 3) N·m that carry platform and rods at rest.

        Half of each rod pair counts as platform and half as elbow: a uniform link loads both ends equally.

        Args:
            position: (..., 3) m in charger_base.
            gravity: (3,) or (..., 3) m/s² in charger_base.

        Raises:
            ValueError: names the argument that is not an array (..., 3) of numbers or does not match the other.
        """
        if (point := as_point(position)) and (weight := as_point(gravity)):
            return np.array(self._scalar.holding_torque(*point, weight))
        points, pull = _pair(position, gravity, "gravity")
        geometry, arrays = self.geometry, self._arrays
        with np.errstate(invalid="ignore", over="ignore", under="ignore"):
            carried = self.torque(points, -(geometry.platform_mass + 1.5 * geometry.rod_mass) * pull)
            true = self.inverse(points).angles + arrays.angle_offset[:, 0]
            outward = pull[..., 0:1] * arrays.cosine[:, 0] + pull[..., 1:2] * arrays.sine[:, 0]
            rise = pull[..., 2:3] * np.cos(true) - outward * np.sin(true)
            return np.asarray(carried - 0.5 * geometry.rod_mass * arrays.arm[:, 0] * rise)

    def contact_force(self, position: ArrayLike, current: ArrayLike, gravity: ArrayLike = GRAVITY) -> Array:
        """Return the force (..., 3) N on the target for signed servo `current` (..., 3) A, without the arm's weight.

        Raises:
            ValueError: names the argument that is not an array (..., 3) of numbers or does not match the others.
        """
        points, currents = _pair(position, current, "current")
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            spare = currents * TORQUE_CONSTANT - self.holding_torque(points, gravity)
        return self.force(points, spare)

    def _rods(self, points: Array) -> tuple[Array, Array]:
        """Return unit rod vectors (3 axes, 3 limbs, ...) and levers (3 limbs, ...) m at `points` (..., 3)."""
        rods, lever = self._inverse.rods(points.reshape(-1, 3))
        shape = points.shape[:-1]
        return (rods / self._arrays.rod).reshape(3, 3, *shape), (lever / self._arrays.rod).reshape(3, *shape)


# Common results of the one-point path, cached because creating a Status costs as much as solving a limb.
_STATUS = {int(status): status for status in (Status.OK, Status.OUTSIDE_WORKSPACE)}


def _pair(position: ArrayLike, other: ArrayLike, name: str) -> tuple[Array, Array]:
    return broadcast(as_vectors(position, "position"), as_vectors(other, name), name)


def _raise_if(strict: bool, status: NDArray[np.uint32]) -> None:
    if strict and status.any():
        bad = np.flatnonzero(status)
        raise KinematicsError(bad.tolist(), [Status(int(value)) for value in status[bad]])
