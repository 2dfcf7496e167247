# SPDX-License-Identifier: Apache-2.0
"""Kinematic calibration: estimates the dimensions of an arm from measured poses of the platform.

Six numbers per limb are fitted (`LimbAdjustment`). Base and platform radius are observable only as their difference,
and the measuring frame counts as charger_base. Each number has a tolerance, used as a Gaussian prior of that standard
deviation, so unobserved numbers stay near their nominal values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics.calibration.checks import check_near, check_reached, check_spread
from deltacharger_kinematics.calibration.data import Measurements
from deltacharger_kinematics.calibration.problem import (
    COUNT,
    NAMES,
    Problem,
    Uncertainty,
    errors,
    numbers,
    rms,
)
from deltacharger_kinematics.calibration.table import CalibrationError
from deltacharger_kinematics.delta import Delta
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry

Rows = Mask

FEWEST_ROWS = COUNT // 3
_UNOBSERVED = 1e-8  # of the largest singular value; exact degeneracy gives less than 1e-10
_OUTLIER = 6.0  # times the scatter of the other rows
_CELLS = 6  # along each edge of the workspace box, for means over the box
_MEDIAN_LENGTH = 1.538  # median length of three standard normal numbers


@dataclass(frozen=True)
class GeometryFit:
    """One least-squares fit.

    Attributes:
        geometry: the fitted geometry.
        residuals: (n, 3) m, measured minus predicted.
        covariance: (18, 18) of the fitted numbers, in units of their tolerances.
        singular_values: (18,) descending, of the data without the prior: change in standard deviations of the
            measurements per change by one tolerance. Below 1 the tolerance dominates the data.
        weakest: (18,) unit vector, in tolerances, of the last singular value.
        scatter: scatter of the residuals relative to the stated uncertainties; 1 = as stated. Above 1 it has widened
            the standard deviations of the measurements, also in covariance and singular values.
    """

    geometry: DeltaGeometry
    residuals: Array
    covariance: Array
    singular_values: Array
    weakest: Array
    scatter: float


@dataclass(frozen=True)
class GeometryCalibration:
    """Result of a calibration: geometry from all rows, held-out error from a fit without the held-out rows.

    Attributes:
        nominal: the geometry before.
        measurements: all rows.
        uncertainty: as given.
        fit: fit to all rows.
        before: (n, 3) m, measured minus predicted by the nominal geometry.
        held_out: (n,) mask of the held-out rows.
        held_out_after: (n held out, 3) m, measured minus predicted by a fit to the other rows.
        outliers: (n,) mask of rows that contradict the others.
        expected: (rms, largest) m over the workspace box: 1σ of the distance between predicted and true position.
    """

    nominal: DeltaGeometry
    measurements: Measurements
    uncertainty: Uncertainty
    fit: GeometryFit
    before: Array
    held_out: Rows
    held_out_after: Array
    outliers: Rows
    expected: tuple[float, float]

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations of the 18 fitted numbers (m, rad)."""
        return np.asarray(np.sqrt(np.diag(self.fit.covariance)) * self.uncertainty.tolerances)

    @property
    def held_out_rms(self) -> tuple[float, float]:
        """Error (m) on the held-out rows before and after."""
        return rms(self.before[self.held_out]), rms(self.held_out_after)

    @property
    def improves(self) -> bool:
        """Whether the held-out error is smaller than with the nominal geometry."""
        before, after = self.held_out_rms
        return after < before


def calibrate(
    measurements: Measurements,
    nominal: DeltaGeometry | None = None,
    uncertainty: Uncertainty | None = None,
    held_out: float = 0.25,
    seed: int = 0,
) -> GeometryCalibration:
    """Fit the 18 numbers and judge the fit.

    Args:
        measurements: at least seven rows that span the workspace.
        nominal: the geometry as drawn, or as calibrated before.
        uncertainty: of measurement and manufacture.
        held_out: share of rows held out to judge the fit, if the measurements do not select them.
        seed: seed of the random selection.

    Raises:
        CalibrationError: the measurements cannot be used; states why and names the lines.
    """
    nominal, uncertainty = nominal or DeltaGeometry(), uncertainty or Uncertainty()
    before = errors(nominal, measurements)
    check_reached(before, measurements, nominal)
    explained = Problem(measurements, nominal, uncertainty).sensitivity(np.zeros(COUNT))
    check_near(before, measurements, rms(np.linalg.norm(explained, axis=2)))
    rows = measurements.held_out if measurements.held_out is not None else _draw(len(measurements), held_out, seed)
    if 3 * int((~rows).sum()) < COUNT or not rows.any():
        raise CalibrationError(
            f"{(~rows).sum()} rows to fit {COUNT} numbers and {rows.sum()} to judge the fit are too few: measure more "
            f"poses, at least {FEWEST_ROWS} and 1, better 27 and 9"
        )
    check_spread(measurements.positions[~rows], nominal)
    judged, final = fit(measurements.subset(~rows), nominal, uncertainty), fit(measurements, nominal, uncertainty)
    return GeometryCalibration(
        nominal,
        measurements,
        uncertainty,
        final,
        before,
        rows,
        errors(judged.geometry, measurements.subset(rows)),
        find_outliers(measurements, nominal, uncertainty),
        _expected(final, nominal, uncertainty),
    )


def fit(measurements: Measurements, nominal: DeltaGeometry, uncertainty: Uncertainty) -> GeometryFit:
    """Fit the 18 numbers to all rows by Levenberg–Marquardt.

    If the rows scatter more than stated, for example because of gear play, their actual scatter weights them.

    Raises:
        CalibrationError: there are fewer than 18 measured numbers, or a direction is not observable.
    """
    from scipy.optimize import least_squares

    if 3 * len(measurements) < COUNT:
        raise CalibrationError(f"{len(measurements)} poses cannot fit {COUNT} numbers: measure {FEWEST_ROWS} or more")
    x, scatter = np.zeros(COUNT), 1.0
    for _ in range(2):
        problem = Problem(measurements, nominal, uncertainty, max(scatter, 1.0))
        x = least_squares(problem.residuals, x, problem.jacobian, method="lm").x
        _, values, directions = np.linalg.svd(problem.jacobian(x)[:-COUNT], full_matrices=False)
        if values[-1] < _UNOBSERVED * values[0]:
            raise CalibrationError(
                f"the poses do not determine {describe(directions[-1])}: measure more poses, different in all three "
                "coordinates"
            )
        from_data = values**2 / (1.0 + values**2)  # share of each direction that the data determine
        squares = float(np.sum(problem.residuals(x)[:-COUNT] ** 2))
        scatter = problem.scatter * math.sqrt(squares / (3 * len(measurements) - float(from_data.sum())))
        if scatter <= 1.0:
            break
    return GeometryFit(
        problem.geometry(x),
        measurements.positions - problem.predict(x),
        directions.T * (1.0 - from_data) @ directions,
        values,
        directions[-1],
        scatter,
    )


def find_outliers(measurements: Measurements, nominal: DeltaGeometry, uncertainty: Uncertainty) -> Rows:
    """Return the rows (n,) that deviate from a fit by more than six times the scatter of the others.

    The fit is robust, so that a few wrong rows do not distort it.
    """
    from scipy.optimize import least_squares

    x, scatter = np.zeros(COUNT), 1.0
    for _ in range(2):
        problem = Problem(measurements, nominal, uncertainty, scatter)
        x = least_squares(problem.residuals, x, problem.jacobian, method="trf", loss="soft_l1").x
        lengths = np.linalg.norm(problem.residuals(x)[:-COUNT].reshape(-1, 3), axis=1) * scatter
        scatter = max(1.0, float(np.median(lengths)) / _MEDIAN_LENGTH)
    return np.asarray(lengths > _OUTLIER * scatter)


def describe(direction: Array) -> str:
    """Return as text which of the 18 numbers a direction changes by at least half the largest share."""
    shares = direction.reshape(LIMB_COUNT, len(NAMES)).T * np.sign(direction[np.abs(direction).argmax()])
    parts = []
    for word, signed in (("larger", shares), ("smaller", -shares)):
        for name, share in zip(NAMES, signed, strict=True):
            limbs = [str(limb) for limb in range(LIMB_COUNT) if share[limb] >= 0.5 * np.abs(direction).max()]
            if limbs:
                parts.append(f"{name} of limb{'s' if len(limbs) > 1 else ''} {', '.join(limbs)} {word}")
    return " with ".join(parts)


def _draw(count: int, share: float, seed: int) -> Rows:
    rows = np.zeros(count, dtype=bool)
    rows[np.random.default_rng(seed).permutation(count)[: max(1, round(share * count))]] = True
    return rows


def _expected(fit: GeometryFit, nominal: DeltaGeometry, uncertainty: Uncertainty) -> tuple[float, float]:
    """Return the standard deviation (m) of a predicted position: rms over the workspace box, and maximum in it."""
    low, high = np.array(nominal.workspace_min), np.array(nominal.workspace_max)
    cells = (np.arange(_CELLS) + 0.5) / _CELLS
    shares = [np.stack(np.meshgrid(*[along] * 3), axis=-1).reshape(-1, 3) for along in (cells, np.array([0.0, 1.0]))]
    angles = Delta(nominal).inverse(low + (high - low) * np.concatenate(shares)).angles
    x = (numbers(fit.geometry) - numbers(nominal)) / uncertainty.tolerances
    slope = Problem(Measurements(np.zeros_like(angles), angles, None, ()), nominal, uncertainty).sensitivity(x)
    deviation = np.sqrt(np.einsum("nij,jk,nik->n", slope, fit.covariance, slope))
    inside = deviation[: len(shares[0])]  # without the corners, which have the largest deviation but no volume
    return math.sqrt(float(np.nanmean(inside**2))), float(np.nanmax(deviation))
