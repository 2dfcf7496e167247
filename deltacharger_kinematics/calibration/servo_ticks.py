# SPDX-License-Identifier: Apache-2.0
"""How stiff a servo is whose load turns it by a few ticks of its encoder only.

Goals are whole ticks, and readings are rounded to them, so that goal − angle is a whole number n that says: torque over
stiffness lies within half a tick of n. Where it spans few ticks that is no noise which averages out. Here each
stiffness of a grid is judged by how probable it makes all these numbers.
"""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics.calibration.data import TICK

_SPAN, _STEPS = 0.35, 1401  # of the logarithm of the stiffness about the first guess, either way
_BLURS = (0.04, 0.08, 0.15, 0.3, 0.6)
"""Ticks by which torque over stiffness differs from what is known of the torque; as likely as each other beforehand."""
_STRAY = 1e-3  # probability of a number that nothing explains


def stiffness_by_ticks(torques: Array, errors: Array, guess: float) -> tuple[float, float]:
    """Return mean and standard deviation of the logarithm of the stiffness (N·m/rad).

    Args:
        torques: that the servo held, N·m (n,).
        errors: goal − angle, rad (n,).
        guess: N·m/rad.
    """
    logarithms = np.log(guess) + np.linspace(-_SPAN, _SPAN, _STEPS)
    off = errors[:, None] / TICK - torques[:, None] / TICK * np.exp(-logarithms)
    judged = []
    for blur in _BLURS:
        within = _normal((off + 0.5) / blur) - _normal((off - 0.5) / blur)
        judged.append(np.log((1.0 - _STRAY) * within + _STRAY).sum(axis=0))
    logs = np.array(judged)
    likelihood = np.exp(logs - logs.max()).sum(axis=0)
    likelihood /= likelihood.sum()
    mean = float(likelihood @ logarithms)
    return mean, float(np.sqrt(likelihood @ (logarithms - mean) ** 2))


def _normal(values: Array) -> Array:
    """Return the normal distribution's share below `values`, to 2e-4 (a logistic with a cubic term)."""
    inner = np.clip(1.5976 * values + 0.07056 * values**3, -60.0, 60.0)
    return np.asarray(1.0 / (1.0 + np.exp(-inner)))
