# SPDX-License-Identifier: Apache-2.0
"""Kinematics and statics of the inverted delta.

`Delta` computes arrays of points, `deltacharger_kinematics.scalar.ScalarDelta` one point in plain floats.
"""

from deltacharger_kinematics.delta import Delta, Forward, Inverse, Jacobian
from deltacharger_kinematics.geometry import DeltaGeometry, LimbAdjustment, Status

__all__ = ["Delta", "DeltaGeometry", "Forward", "Inverse", "Jacobian", "LimbAdjustment", "Status"]
