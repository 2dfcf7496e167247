# SPDX-License-Identifier: Apache-2.0
"""Kinematic calibration: estimates the dimensions of an arm from measured poses of the platform.

Six numbers per limb are fitted (`LimbAdjustment`). Base and platform radius are observable only as their difference,
and the measuring frame counts as charger_base. Each number has a tolerance, used as a Gaussian prior of that standard
deviation, so unobserved numbers stay near their nominal values.

The least-squares problem of a calibration: 18 numbers of the geometry, measured poses, and prior knowledge.
The model is `Delta.forward`. Its derivatives by the 18 numbers are central differences: with steps of 1/1000 of a
tolerance they have ten correct digits, so no second set of formulas is needed.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics.calibration.data import MILLIMETRE, CalibrationError, Measurements
from deltacharger_kinematics.delta import Delta
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, LimbAdjustment

NAMES = ("radius_offset", "tangential_offset", "height_offset", "arm", "rod", "angle_offset")
"""The numbers of one limb, in the order of every vector of 18: limb 0's six, then limb 1's, then limb 2's."""
COUNT = LIMB_COUNT * len(NAMES)
_STEP = 1e-3  # of a tolerance
_UNREACHED = 1e6  # standard deviations; cost of an impossible arm, so that the solver avoids the step


@dataclass(frozen=True)
class Uncertainty:
    """Prior knowledge, as standard deviations.

    Attributes:
        measurement: each coordinate of a measured position (m).
        length: each length and offset of the built arm (m).
        angle: each arm's angle (rad).

    Raises:
        CalibrationError: a value is not positive and finite.
    """

    measurement: float = 0.05e-3
    length: float = 0.5e-3
    angle: float = math.radians(1.0)

    def __post_init__(self) -> None:
        for name in ("measurement", "length", "angle"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise CalibrationError(f"the uncertainty '{name}' is {getattr(self, name)}: give a number above 0")

    @property
    def tolerances(self) -> Array:
        """Tolerances of the 18 numbers (m, rad)."""
        return np.tile([self.length] * 5 + [self.angle], LIMB_COUNT)


def errors(geometry: DeltaGeometry, measurements: Measurements) -> Array:
    """Return measured minus predicted position (n, 3) m; NaN if the angles are impossible for the geometry."""
    return measurements.positions - np.asarray(Delta(geometry).forward(measurements.angles).position)


def rms(errors: Array) -> float:
    """Return the root of the mean squared length of `errors` (..., 3)."""
    return math.sqrt(float(np.mean(np.sum(np.square(errors), axis=-1))))


def numbers(geometry: DeltaGeometry) -> Array:
    """Return the 18 numbers (m, rad) of `geometry`, in the order of `NAMES` per limb."""
    limbs = [geometry.limb(index) for index in range(LIMB_COUNT)]
    return np.array([getattr(limb, name) for limb in limbs for name in NAMES])


def with_numbers(geometry: DeltaGeometry, values: Array) -> DeltaGeometry:
    """Return `geometry` with the 18 numbers (m, rad) `values`.

    Raises:
        ValueError: a length is not positive.
    """
    first, second, third = (LimbAdjustment(*map(float, limb)) for limb in values.reshape(LIMB_COUNT, len(NAMES)))
    return replace(geometry, limbs=(first, second, third))


class Problem:
    """Residuals over x (18,), each number's deviation from nominal in tolerances.

    Residuals are in standard deviations: three per row, whitened with the covariance of measurement and encoder times
    `scatter`², then 18 of the prior.
    """

    def __init__(
        self, measurements: Measurements, nominal: DeltaGeometry, uncertainty: Uncertainty, scatter: float = 1.0
    ) -> None:
        self.scatter = scatter
        self._measurements = measurements
        self._nominal = nominal
        self._start = numbers(nominal)
        self._tolerances = uncertainty.tolerances
        self._whiten = _whitening(measurements, nominal, uncertainty) / scatter

    def geometry(self, x: Array) -> DeltaGeometry:
        """Return the geometry at x.

        Raises:
            ValueError: a length is not positive.
        """
        return with_numbers(self._nominal, self._start + x * self._tolerances)

    def predict(self, x: Array) -> Array:
        """Return positions (n, 3) m; NaN if the arm at x cannot have the angles."""
        try:
            delta = Delta(self.geometry(x))
        except ValueError:
            return np.full(self._measurements.angles.shape, np.nan)
        return np.asarray(delta.forward(self._measurements.angles).position)

    def sensitivity(self, x: Array) -> Array:
        """Return the derivatives (n, 3, 18) m of the positions by x."""
        columns = [(self.predict(x + step) - self.predict(x - step)) / (2.0 * _STEP) for step in _STEP * np.eye(COUNT)]
        return np.stack(columns, axis=-1)

    def residuals(self, x: Array) -> Array:
        """Return (3n + 18,) residuals."""
        error = self._measurements.positions - self.predict(x)
        white = np.einsum("nij,nj->ni", self._whiten, error).ravel()
        return np.concatenate([np.nan_to_num(white, nan=_UNREACHED), x])

    def jacobian(self, x: Array) -> Array:
        """Return their derivatives (3n + 18, 18) by x."""
        slope = np.einsum("nij,njk->nik", self._whiten, -self.sensitivity(x)).reshape(-1, COUNT)
        return np.concatenate([np.nan_to_num(slope), np.eye(COUNT)])


def _whitening(measurements: Measurements, nominal: DeltaGeometry, uncertainty: Uncertainty) -> Array:
    """Return matrices (n, 3, 3) that convert errors (m) to standard deviations, encoder resolution included."""
    delta = Delta(nominal)
    slope = delta.jacobian(delta.forward(measurements.angles).position).matrix
    per_angle = np.nan_to_num(slope) * measurements.angle_stddev  # NaN at the edge of reach; weights need not be exact
    covariance = per_angle @ per_angle.transpose(0, 2, 1) + uncertainty.measurement**2 * np.eye(3)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


_FAR = 4.0  # times the error explained by the tolerances; larger errors have another cause
_BEYOND = 0.2  # rad; servo_node keeps the limits, but zero ticks may be off by a tolerance or two
_SLIP = 3.0  # a ratio of 1000 within this factor is a wrong unit
_LEAST_SPREAD = 0.15  # standard deviation along any direction, per half workspace box; a full grid has 0.8


def check_reached(errors: Array, measurements: Measurements, geometry: DeltaGeometry) -> None:
    """Refuse rows with impossible angles: far beyond the joint limits, or `errors` (n, 3) is NaN.

    Raises:
        CalibrationError: names the lines.
    """
    angles = measurements.angles
    beyond = np.maximum(geometry.joint_min - angles, angles - geometry.joint_max).max(axis=1) > _BEYOND
    if beyond.any():
        lines = _lines(measurements, beyond)
        low, high = np.degrees([geometry.joint_min, geometry.joint_max])
        raise CalibrationError(
            f"{named(lines)}: an arm angle is far outside the joint limits, {low:.0f}° to {high:.0f}°; check the unit, "
            "zero ticks and direction",
            lines,
        )
    lost = np.asarray(np.isnan(errors).any(axis=1))
    if lost.any():
        lines = _lines(measurements, lost)
        raise CalibrationError(
            f"{named(lines)}: the arm cannot have these angles: its rods would not meet; check the column order",
            lines,
        )


def check_near(errors: Array, measurements: Measurements, explained: float) -> None:
    """Refuse positions that deviate from the predicted ones by more than tolerances explain.

    Args:
        errors: (n, 3) m, measured minus predicted by the nominal geometry.
        measurements: the rows.
        explained: m, rms of the errors caused by the tolerances.

    Raises:
        CalibrationError: states the distance and what to check.
    """
    predicted = measurements.positions - errors
    ratio = float(
        np.median(np.linalg.norm(measurements.positions, axis=1)) / np.median(np.linalg.norm(predicted, axis=1))
    )
    for factor, hint in ((1e3, "millimetres in columns of metres"), (1e-3, "metres in columns of mm")):
        if factor / _SLIP < ratio < factor * _SLIP:
            raise CalibrationError(f"the measured positions are {ratio:.3g} times the predicted ones: are they {hint}?")
    distance = float(np.median(np.linalg.norm(errors, axis=1)))
    if distance > _FAR * explained:
        raise CalibrationError(
            f"the measured positions are {distance / MILLIMETRE:.1f} mm from the predicted ones (median), but the "
            f"tolerances explain {explained / MILLIMETRE:.1f} mm: check the axes and origin of the measuring frame, "
            "zero ticks and direction, or widen the tolerances"
        )


def check_spread(positions: Array, geometry: DeltaGeometry) -> None:
    """Refuse `positions` (n, 3) m in one plane, on one line or at one point of the workspace.

    Raises:
        CalibrationError: names the direction without poses.
    """
    half = 0.5 * (np.array(geometry.workspace_max) - np.array(geometry.workspace_min))
    scaled = (positions - positions.mean(axis=0)) / half
    spreads, directions = np.linalg.svd(scaled, full_matrices=False)[1:]
    spreads = spreads / np.sqrt(len(positions))
    flat = int((spreads < _LEAST_SPREAD).sum())
    if not flat:
        return
    shape = ("in one plane", "on one line", "at one point")[flat - 1]
    missing = " and ".join(_extent(positions, direction / half) for direction in directions[: -1 - flat : -1])
    raise CalibrationError(
        f"the poses lie {shape}: they cover only {missing}, so errors there are not observable; spread them over the "
        "workspace"
    )


def _extent(positions: Array, along: Array) -> str:
    """Return the extent of `positions` in a direction, as '3.1 mm along z'."""
    unit = along / np.linalg.norm(along)
    largest = int(np.abs(unit).argmax())
    unit = unit * np.sign(unit[largest])
    name = (
        "xyz"[largest] if unit[largest] > 0.95 else f"({', '.join(f'{round(value, 1) + 0.0:.1f}' for value in unit)})"
    )
    return f"{float(np.ptp(positions @ unit)) / MILLIMETRE:.1f} mm along {name}"


def named(lines: tuple[int, ...]) -> str:
    """Return 'line 3' or 'lines 3, 7, 9'; after ten the number of further ones."""
    shown = ", ".join(str(line) for line in lines[:10])
    more = f" and {len(lines) - 10} more" if len(lines) > 10 else ""
    return f"line{'s' if len(lines) > 1 else ''} {shown}{more}"


def _lines(measurements: Measurements, rows: Mask) -> tuple[int, ...]:
    return tuple(line for line, wanted in zip(measurements.lines, rows, strict=True) if wanted)


Rows = Mask

FEWEST_ROWS = COUNT // 3
_UNOBSERVED = 1e-8  # of the largest singular value; exact degeneracy gives less than 1e-10
_OUTLIER = 6.0  # times the scatter of the other rows
_MEDIAN_LENGTH = 1.538  # median length of three standard normal numbers


@dataclass(frozen=True)
class GeometryFit:
    """One least-squares fit.

    Attributes:
        geometry: the fitted geometry.
        residuals: (n, 3) m, measured minus predicted.
        covariance: (18, 18) of the fitted numbers, in units of their tolerances.
        scatter: scatter of the residuals relative to the stated uncertainties; 1 = as stated. Above 1 it has widened
            the standard deviations of the measurements, also in the covariance.
    """

    geometry: DeltaGeometry
    residuals: Array
    covariance: Array
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
    """

    nominal: DeltaGeometry
    measurements: Measurements
    uncertainty: Uncertainty
    fit: GeometryFit
    before: Array
    held_out: Rows
    held_out_after: Array
    outliers: Rows

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
