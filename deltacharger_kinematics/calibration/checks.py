# SPDX-License-Identifier: Apache-2.0
"""Checks whether measured poses are fit for a calibration; each error states the remedy."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics.calibration.data import Measurements
from deltacharger_kinematics.calibration.table import MILLIMETRE, CalibrationError
from deltacharger_kinematics.geometry import DeltaGeometry

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
