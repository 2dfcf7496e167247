"""Inverse and forward kinematics, Jacobian and statics of the inverted delta over arrays of points.

Formulas, with θ from radially outward toward +z and per limb at azimuth φ (frame ``charger_base``; w is measured from
the motor plane): u = x cosφ + y sinφ − D, v = y cosφ − x sinφ, w = z + z_offset, K = u² + w² + v² + a² − L²,
Q = 4a²(u² + w²) − K². A limb reaches the point where Q ≥ 0, and θ = atan2(Kw − √Q·u, Ku + √Q·w) is its knee-out
angle: one root, one arc tangent, no division. The velocity relation follows from r·(p − c(θ)) = const with rod
vectors r: J = R⁻¹ diag(b). Statics is its transpose, τ = Jᵀ f.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_kinematics.geometry import LIMB_DIRECTIONS, DeltaGeometry
from deltacharger_kinematics.statics import GRAVITY, TORQUE_CONSTANT
from deltacharger_kinematics.status import KinematicsError, Status

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_COSINE = np.array([direction[0] for direction in LIMB_DIRECTIONS])
_SINE = np.array([direction[1] for direction in LIMB_DIRECTIONS])
_LIMB_BITS = np.array([Status.LIMB_0, Status.LIMB_1, Status.LIMB_2], dtype=np.uint32)
_LARGEST = 1e6  # m; squares of larger coordinates lose every digit that matters, far beyond that they overflow
_NEAR_TYPE_1 = 0.02  # of the arm: lever |b| below which a limb is nearly stretched or folded
_NEAR_TYPE_2 = 0.02  # |det| of the unit rod vectors below which the platform is nearly unheld


@dataclass(frozen=True)
class Inverse:
    """Arm angles (..., 3) rad, status (...) of Status bits, margin (...) to the edge of reach."""

    angles: Array
    status: NDArray[np.uint32] | Status
    margin: Array


@dataclass(frozen=True)
class Forward:
    """Positions (..., 3) m in charger_base, status (...), determinant (...) of the unit rod vectors."""

    position: Array
    status: NDArray[np.uint32] | Status
    determinant: Array


@dataclass(frozen=True)
class Jacobian:
    """dp/dangle (..., 3, 3) m/rad, determinant (...) of the unit rod vectors, condition number (...)."""

    matrix: Array
    determinant: Array
    condition: Array


class Delta:
    """The delta of one geometry. Arrays are (..., 3) in and float64 out; a bad point never fails the others."""

    def __init__(self, geometry: DeltaGeometry | None = None) -> None:
        self.geometry = geometry or DeltaGeometry()

    def inverse(self, position: ArrayLike, *, strict: bool = False) -> Inverse:
        """Return the arm angles that put the platform at `position` (..., 3) m.

        Raises:
            ValueError: the last axis is not 3.
            KinematicsError: only with `strict`, where any status is not OK.
        """
        points, shape = _flat(position)
        geometry = self.geometry
        status = np.zeros(len(points), dtype=np.uint32)
        finite: Mask = np.asarray(np.isfinite(points).all(axis=1))
        far: Mask = finite & np.asarray((np.abs(np.where(finite[:, None], points, 0.0)) > _LARGEST).any(axis=1))
        status[~finite] |= np.uint32(Status.INVALID_INPUT)
        status[far] |= np.uint32(Status.UNREACHABLE_FAR | Status.LIMB_0 | Status.LIMB_1 | Status.LIMB_2)
        safe = np.where((finite & ~far)[..., None], points, 0.0)
        u, v, w, k, q = self._limb_terms(safe)
        reach = u * u + w * w
        scale = 4.0 * geometry.arm**2 * reach
        with np.errstate(divide="ignore", invalid="ignore"):
            margin = np.where(scale > 0.0, q / scale, np.nan).min(-1)
        indeterminate = (reach == 0.0) & (q == 0.0)
        reachable = (q >= 0.0) & ~indeterminate
        root = np.sqrt(np.where(reachable, q, 0.0))
        angles = np.where(reachable, np.arctan2(k * w - root * u, k * u + root * w), np.nan)
        usable = finite & ~far
        angles[~usable] = np.nan
        margin = np.where(usable, margin, np.where(finite, -np.inf, np.nan))
        self._flag_reach(status, usable, reachable, indeterminate, v, reach)
        solved = usable & reachable.all(-1)
        status[solved] |= self._flags(safe[solved], angles[solved], root[solved], v[solved])
        _raise_if(strict, status)
        return Inverse(angles.reshape(*shape, 3), _shaped(status, shape), margin.reshape(shape))

    def forward(self, angles: ArrayLike, *, strict: bool = False) -> Forward:
        """Return the platform position for arm `angles` (..., 3) rad, on the side ahead of the elbows.

        Raises:
            ValueError: the last axis is not 3.
            KinematicsError: only with `strict`, where any status is not OK.
        """
        arms, shape = _flat(angles)
        geometry = self.geometry
        status = np.zeros(len(arms), dtype=np.uint32)
        finite: Mask = np.asarray(np.isfinite(arms).all(axis=1))
        status[~finite] |= np.uint32(Status.INVALID_INPUT)
        arms = np.where(finite[..., None], arms, 0.0)
        elbows = self._elbows(arms)
        a, b = elbows[..., 1, :] - elbows[..., 0, :], elbows[..., 2, :] - elbows[..., 0, :]
        normal = np.cross(a, b)
        square = (normal * normal).sum(-1)
        extent = np.maximum((a * a).sum(-1), (b * b).sum(-1))
        degenerate = finite & (square <= (1e-12 * extent) ** 2)
        half = np.where(degenerate | (square == 0.0), np.nan, 0.5 / np.where(square == 0.0, 1.0, square))[..., None]
        centre = half * (
            (b * b).sum(-1, keepdims=True) * np.cross(normal, a) + (a * a).sum(-1, keepdims=True) * np.cross(b, normal)
        )
        height = geometry.rod**2 - (centre * centre).sum(-1)
        apart = finite & ~degenerate & (height < 0.0)
        status[degenerate] |= np.uint32(Status.DEGENERATE)
        status[apart] |= np.uint32(Status.NOT_ASSEMBLABLE)
        solved = finite & ~degenerate & ~apart
        with np.errstate(invalid="ignore", divide="ignore"):
            along = np.sqrt(np.where(solved, height / square, np.nan))[..., None]
        position = elbows[..., 0, :] + centre + along * normal
        position[..., 2] -= geometry.z_offset
        determinant = np.full(len(arms), np.nan)
        if solved.any():
            rods = (self._motor_frame(position[solved])[:, None, :] - elbows[solved]) / geometry.rod
            determinant[solved] = np.linalg.det(rods)
            _, v, _, _, q = self._limb_terms(position[solved])
            status[solved] |= self._flags(position[solved], arms[solved], np.sqrt(np.maximum(q, 0.0)), v)
        _raise_if(strict, status)
        return Forward(position.reshape(*shape, 3), _shaped(status, shape), determinant.reshape(shape))

    def jacobian(self, position: ArrayLike) -> Jacobian:
        """Return the Jacobian at `position` (..., 3) m; NaN where out of reach or where the rods lie in a plane."""
        points, shape = _flat(position)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            rods, lever = self._rods(points)
            r0, r1, r2 = rods[..., 0, :], rods[..., 1, :], rods[..., 2, :]
            columns = np.stack([np.cross(r1, r2), np.cross(r2, r0), np.cross(r0, r1)], axis=-1)
            determinant = (r0 * columns[..., 0]).sum(-1)
            matrix = columns * (lever / np.where(determinant == 0.0, np.nan, determinant)[..., None])[..., None, :]
        condition = np.full(len(points), np.inf)
        usable = np.isfinite(matrix).all((-2, -1))
        condition[usable] = np.linalg.cond(matrix[usable])
        return Jacobian(matrix.reshape(*shape, 3, 3), determinant.reshape(shape), condition.reshape(shape))

    def torque(self, position: ArrayLike, force: ArrayLike) -> Array:
        """Return the arm torques (..., 3) N·m with which the platform exerts `force` (..., 3) N at `position`."""
        matrix = self.jacobian(position).matrix
        return np.asarray(np.einsum("...ji,...j->...i", matrix, np.asarray(force, dtype=np.float64)), dtype=np.float64)

    def force(self, position: ArrayLike, torque: ArrayLike) -> Array:
        """Return the force (..., 3) N that the platform exerts for arm `torque` (..., 3) N·m; NaN where singular."""
        rods, lever = self._rods(np.asarray(position, dtype=np.float64))
        with np.errstate(invalid="ignore", divide="ignore"):
            along = np.asarray(torque, dtype=np.float64) / lever
        # f = J⁻ᵀ τ = Rᵀ diag(b)⁻¹ τ: the rods' own directions, so no matrix is inverted.
        return np.asarray((rods * along[..., None]).sum(-2), dtype=np.float64)

    def holding_torque(self, position: ArrayLike, gravity: ArrayLike = GRAVITY) -> Array:
        """Return the arm torques (..., 3) N·m that carry platform and rods at rest against `gravity` (3,) m/s²."""
        points = np.asarray(position, dtype=np.float64)
        geometry = self.geometry
        pull = np.asarray(gravity, dtype=np.float64)
        carried = self.torque(points, -(geometry.platform_mass + 1.5 * geometry.rod_mass) * pull)
        angles = self.inverse(points).angles
        outward = pull[0] * _COSINE + pull[1] * _SINE
        rise = pull[2] * np.cos(angles) - outward * np.sin(angles)
        return np.asarray(carried - 0.5 * geometry.rod_mass * geometry.arm * rise, dtype=np.float64)

    def contact_force(self, position: ArrayLike, current: ArrayLike, gravity: ArrayLike = GRAVITY) -> Array:
        """Return the force (..., 3) N on the target for servo `current` (..., 3) A, the weight of the arm removed."""
        torque = np.asarray(current, dtype=np.float64) * TORQUE_CONSTANT
        return self.force(position, torque - self.holding_torque(position, gravity))

    def _motor_frame(self, points: Array) -> Array:
        return np.asarray(points + np.array([0.0, 0.0, self.geometry.z_offset]), dtype=np.float64)

    def _limb_terms(self, points: Array) -> tuple[Array, Array, Array, Array, Array]:
        geometry = self.geometry
        x, y, z = points[..., 0:1], points[..., 1:2], points[..., 2:3]
        u = x * _COSINE + y * _SINE - geometry.radius_difference
        v = y * _COSINE - x * _SINE
        w = np.broadcast_to(z + geometry.z_offset, u.shape)
        reach = u * u + w * w
        k = reach + v * v + geometry.arm**2 - geometry.rod**2
        return u, v, w, k, 4.0 * geometry.arm**2 * reach - k * k

    def _elbows(self, angles: Array) -> Array:
        """Return the elbows (..., 3 limbs, 3) in delta_motor, shifted inward by the platform's radius."""
        geometry = self.geometry
        radius = geometry.radius_difference + geometry.arm * np.cos(angles)
        height = geometry.arm * np.sin(angles)
        return np.asarray(np.stack([radius * _COSINE, radius * _SINE, height], axis=-1), dtype=np.float64)

    def _rods(self, points: Array) -> tuple[Array, Array]:
        """Return unit rod vectors (..., 3 limbs, 3) and levers (..., 3) m at `points`."""
        _, _, _, _, q = self._limb_terms(points)
        elbows = self._elbows(self.inverse(points).angles)
        rods = (self._motor_frame(points)[..., None, :] - elbows) / self.geometry.rod
        with np.errstate(invalid="ignore"):
            lever = np.sqrt(q) / (2.0 * self.geometry.rod)
        return rods, lever

    def _flag_reach(
        self,
        status: NDArray[np.uint32],
        usable: Mask,
        reachable: Mask,
        indeterminate: Mask,
        v: Array,
        reach: Array,
    ) -> None:
        geometry = self.geometry
        missed = ~reachable & ~indeterminate & usable[..., None]
        lateral = missed & (np.abs(v) > geometry.rod)
        radius = np.sqrt(np.maximum(geometry.rod**2 - v * v, 0.0))
        near = missed & ~lateral & (np.sqrt(reach) < np.abs(geometry.arm - radius))
        far = missed & ~lateral & ~near
        for mask, bit in (
            (lateral, Status.UNREACHABLE_LATERAL),
            (near, Status.UNREACHABLE_NEAR),
            (far, Status.UNREACHABLE_FAR),
            (indeterminate & usable[..., None], Status.INDETERMINATE),
        ):
            status |= np.where(mask.any(-1), np.uint32(bit), np.uint32(0))
            status |= (mask * _LIMB_BITS).sum(-1).astype(np.uint32)

    def _flags(self, points: Array, angles: Array, root: Array, v: Array) -> NDArray[np.uint32]:
        """Return the warnings (n,) of solved points (n, 3)."""
        geometry = self.geometry
        rods = (self._motor_frame(points)[:, None, :] - self._elbows(angles)) / geometry.rod
        determinant = np.linalg.det(rods)
        limb_checks = (
            (root / (2.0 * geometry.rod) < _NEAR_TYPE_1 * geometry.arm, Status.NEAR_TYPE_1),
            ((angles < geometry.joint_min) | (angles > geometry.joint_max), Status.JOINT_LIMIT),
            (np.abs(v) > geometry.rod * np.sin(geometry.swing_max), Status.SWING_LIMIT),
        )
        box = (points < np.array(geometry.workspace_min)) | (points > np.array(geometry.workspace_max))
        point_checks = (
            (determinant < 0.0, Status.WRONG_ASSEMBLY),
            (np.abs(determinant) < _NEAR_TYPE_2, Status.NEAR_TYPE_2),
            (box.any(-1), Status.OUTSIDE_WORKSPACE),
        )
        status = np.zeros(len(points), dtype=np.uint32)
        for mask, bit in limb_checks:
            status |= np.where(mask.any(-1), np.uint32(bit), np.uint32(0))
            status |= (mask * _LIMB_BITS).sum(-1).astype(np.uint32)
        for mask, bit in point_checks:
            status |= np.where(mask, np.uint32(bit), np.uint32(0))
        return status


def _flat(values: ArrayLike) -> tuple[Array, tuple[int, ...]]:
    """Return a copy as (n, 3) and the leading shape to give back."""
    points = np.array(values, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 3:
        raise ValueError(f"give an array (..., 3), not of shape {points.shape}")
    return points.reshape(-1, 3), points.shape[:-1]


def _shaped(status: NDArray[np.uint32], shape: tuple[int, ...]) -> NDArray[np.uint32] | Status:
    return status.reshape(shape) if shape else Status(int(status[0]))


def _raise_if(strict: bool, status: NDArray[np.uint32]) -> None:
    if strict and status.any():
        bad = np.flatnonzero(status)
        raise KinematicsError(bad.tolist(), [Status(int(value)) for value in status[bad]])
