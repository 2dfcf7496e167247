# SPDX-License-Identifier: Apache-2.0
"""Inverse and forward kinematics, Jacobian and statics of the inverted delta.

Formulas per limb at azimuth φ, in frame ``charger_base``. θ is zero radially outward and positive toward +z; w is
measured from the motor plane. u = x cosφ + y sinφ − D, v = y cosφ − x sinφ, w = z + z_offset,
K = u² + w² + v² + a² − L², Q = 4a²(u² + w²) − K². A limb reaches the point if Q ≥ 0. Its angle is
θ = atan2(Kw − √Q·u, Ku + √Q·w), with the knee outward: one root, one arc tangent, no division. With unit rod
vectors r and levers b = √Q/(2L), differentiating |p − c(θ)| = L gives the Jacobian J = R⁻¹ diag(b). Statics is its
transpose, τ = Jᵀ f. A limb's adjustment shifts D, v and w, replaces a and L, and offsets the true angle from the
commanded one.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import GRAVITY
from deltacharger_kinematics.geometry import DeltaGeometry, Status
from deltacharger_kinematics.solve import ForwardSolver, InverseSolver, LimbArrays, cross, dot


def as_vectors(value: ArrayLike, name: str) -> Array:
    """Return `value` as float64 (..., 3).

    Raises:
        ValueError: the values are no numbers or ragged, or the last axis is not 3; then it names the argument.
    """
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name}: shape {array.shape}; give numbers (..., 3)")
    return array


class Inverse(NamedTuple):
    """Arm angles (..., 3) rad, status (...) of Status bits, margin (...) to the edge of reach.

    The margin is the smallest Q/(4a²(u² + w²)) of the limbs: 1 farthest from the edge, 0 on it, negative outside; NaN
    if the input is invalid or a limb's angle indeterminate. For one point status is a `Status` and margin a float.
    """

    angles: Array
    status: NDArray[np.uint32] | Status
    margin: Array | float


class Forward(NamedTuple):
    """Positions (..., 3) m in charger_base, status (...)."""

    position: Array
    status: NDArray[np.uint32] | Status


class Jacobian(NamedTuple):
    """dp/dangle (..., 3, 3) m/rad, determinant (...) of the unit rod vectors.

    NaN if the point is out of reach. If the rods lie in a plane, the matrix is NaN.
    """

    matrix: Array
    determinant: Array | float


class Delta:
    """The delta of one geometry. Takes arrays (..., 3), returns float64; a bad point does not affect other points.

    Args:
        geometry: dimensions; None = the defaults.
    """

    def __init__(self, geometry: DeltaGeometry | None = None) -> None:
        self.geometry = geometry = geometry or DeltaGeometry()
        self._arrays = LimbArrays(geometry)
        self._inverse = InverseSolver(geometry, self._arrays)
        self._forward = ForwardSolver(geometry, self._arrays)

    def inverse(self, position: ArrayLike) -> Inverse:
        """Return the arm angles for platform `position` (..., 3) m in charger_base.

        The error is at most 8e-16 rad in the workspace and 4e-16 rad near the edge of reach. Reachability is decided
        exactly.

        Raises:
            ValueError: `position` is not an array (..., 3) of numbers.
        """
        points = as_vectors(position, "position")
        angles, status, margin = self._inverse.solve(points.reshape(-1, 3))
        if points.ndim == 1:
            return Inverse(angles[0], Status(int(status[0])), float(margin[0]))
        shape = points.shape[:-1]
        return Inverse(angles.reshape(points.shape), status.reshape(shape), margin.reshape(shape))

    def forward(self, angles: ArrayLike) -> Forward:
        """Return the platform position for arm `angles` (..., 3) rad.

        Raises:
            ValueError: `angles` is not an array (..., 3) of numbers.
        """
        arms = as_vectors(angles, "angles")
        position, status = self._forward.solve(arms.reshape(-1, 3))
        if arms.ndim == 1:
            return Forward(position[0], Status(int(status[0])))
        return Forward(position.reshape(arms.shape), status.reshape(arms.shape[:-1]))

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
        return Jacobian(matrix, float(determinant) if points.ndim == 1 else determinant)

    def torque(self, position: ArrayLike, force: ArrayLike) -> Array:
        """Return the arm torques (..., 3) N·m for the platform to exert `force` (..., 3) N at `position`.

        Raises:
            ValueError: an argument is not an array (..., 3) of numbers, or does not match the other.
        """
        points, pushes = np.broadcast_arrays(as_vectors(position, "position"), as_vectors(force, "force"))
        with np.errstate(invalid="ignore", over="ignore", under="ignore"):
            return np.asarray((self.jacobian(points).matrix * pushes[..., :, None]).sum(-2))

    def holding_torque(self, position: ArrayLike, gravity: ArrayLike = GRAVITY) -> Array:
        """Return the arm torques (..., 3) N·m that carry platform and rods at rest.

        Half of each rod pair counts as platform and half as elbow: a uniform link loads both ends equally.

        Args:
            position: (..., 3) m in charger_base.
            gravity: (3,) or (..., 3) m/s² in charger_base.

        Raises:
            ValueError: an argument is not an array (..., 3) of numbers, or does not match the other.
        """
        points, pull = np.broadcast_arrays(as_vectors(position, "position"), as_vectors(gravity, "gravity"))
        geometry, arrays = self.geometry, self._arrays
        with np.errstate(invalid="ignore", over="ignore", under="ignore"):
            carried = self.torque(points, -(geometry.platform_mass + 1.5 * geometry.rod_mass) * pull)
            true = self.inverse(points).angles + arrays.angle_offset[:, 0]
            outward = pull[..., 0:1] * arrays.cosine[:, 0] + pull[..., 1:2] * arrays.sine[:, 0]
            rise = pull[..., 2:3] * np.cos(true) - outward * np.sin(true)
            return np.asarray(carried - 0.5 * geometry.rod_mass * arrays.arm[:, 0] * rise)

    def _rods(self, points: Array) -> tuple[Array, Array]:
        """Return unit rod vectors (3 axes, 3 limbs, ...) and levers (3 limbs, ...) m at `points` (..., 3)."""
        rods, lever = self._inverse.rods(points.reshape(-1, 3))
        shape = points.shape[:-1]
        return (rods / self._arrays.rod).reshape(3, 3, *shape), (lever / self._arrays.rod).reshape(3, *shape)
