# SPDX-License-Identifier: Apache-2.0
"""Estimates the stiffness of a servo whose loads turn it by only a few encoder ticks.

Goals are whole ticks and readings are rounded to ticks, so goal − angle is an integer n: torque over stiffness lies
within half a tick of n. Over few ticks this rounding does not average out like noise. Therefore each stiffness of a
grid is weighted by the likelihood of all these integers.
"""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.calibration.data import TICK

_SPAN, _STEPS = 0.35, 1401  # of the logarithm of the stiffness on both sides of the first guess
_BLURS = (0.04, 0.08, 0.15, 0.3, 0.6)
"""Ticks, standard deviations of torque over stiffness due to torque errors; equal prior probability."""
_STRAY = 1e-3  # probability of an outlier


def stiffness_by_ticks(torques: Array, errors: Array, guess: float) -> tuple[float, float]:
    """Return mean and standard deviation of the logarithm of the stiffness (N·m/rad).

    Args:
        torques: torques held by the servo, N·m (n,).
        errors: goal − angle, rad (n,).
        guess: N·m/rad.
    """
    logarithms = np.log(guess) + np.linspace(-_SPAN, _SPAN, _STEPS)
    off = errors[:, None] / TICK - torques[:, None] / TICK * np.exp(-logarithms)
    likelihoods = []
    for blur in _BLURS:
        within = _normal((off + 0.5) / blur) - _normal((off - 0.5) / blur)
        likelihoods.append(np.log((1.0 - _STRAY) * within + _STRAY).sum(axis=0))
    logs = np.array(likelihoods)
    likelihood = np.exp(logs - logs.max()).sum(axis=0)
    likelihood /= likelihood.sum()
    mean = float(likelihood @ logarithms)
    return mean, float(np.sqrt(likelihood @ (logarithms - mean) ** 2))


def _normal(values: Array) -> Array:
    """Return the normal distribution function at `values`, to 2e-4 (a logistic with a cubic term)."""
    inner = np.clip(1.5976 * values + 0.07056 * values**3, -60.0, 60.0)
    return np.asarray(1.0 / (1.0 + np.exp(-inner)))
