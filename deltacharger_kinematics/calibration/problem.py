# SPDX-License-Identifier: Apache-2.0
"""The least-squares problem of a calibration: 18 numbers of the geometry, measured poses, and prior knowledge.

The model is `Delta.forward`. Its derivatives by the 18 numbers are central differences: with steps of 1/1000 of a
tolerance they have ten correct digits, so no second set of formulas is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.calibration.data import Measurements
from deltacharger_kinematics.calibration.table import CalibrationError
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
