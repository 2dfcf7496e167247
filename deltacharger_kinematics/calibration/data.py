# SPDX-License-Identifier: Apache-2.0
"""Measured poses for a calibration and their files; docs/calibration.md lists the columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_core.machine import EXTENDED_TICKS, TICKS_PER_TURN
from deltacharger_kinematics.calibration.table import (
    DEGREES,
    HELD_OUT,
    POSITION_COLUMNS,
    RADIANS,
    TICKS,
    CalibrationError,
    Table,
    Triple,
    read_table,
)

TICK = 2.0 * math.pi / TICKS_PER_TURN  # rad; encoder of the MX-64


@dataclass(frozen=True)
class Encoder:
    """Zero and direction of the encoders: angle = direction · (ticks − zero_ticks) · 2π/4096, as in servo_node.

    Raises:
        CalibrationError: a direction is not 1 or −1, or a count is out of range.
    """

    zero_ticks: Triple = (2048, 2048, 2048)
    direction: Triple = (1, 1, 1)

    def __post_init__(self) -> None:
        if len(self.zero_ticks) != 3 or any(abs(value) > EXTENDED_TICKS for value in self.zero_ticks):
            raise CalibrationError(f"zero_ticks is {self.zero_ticks}: give three counts within ±{EXTENDED_TICKS}")
        if len(self.direction) != 3 or any(value not in (1, -1) for value in self.direction):
            raise CalibrationError(f"direction is {self.direction}: give 1 or -1 for each of the three servos")

    @property
    def statement(self) -> str:
        """The encoder as comment lines of a measurement file."""
        named = (("zero_ticks", self.zero_ticks), ("direction", self.direction))
        return "".join(f"# {name} {' '.join(map(str, values))}\n" for name, values in named)

    def angles(self, ticks: Array) -> Array:
        """Return the arm angles (..., 3) rad of encoder counts (..., 3)."""
        return np.asarray((ticks - np.array(self.zero_ticks)) * self.direction * TICK, dtype=np.float64)

    def ticks(self, angles: Array) -> Array:
        """Return the encoder counts (..., 3), not rounded, of arm angles (..., 3) rad."""
        return np.asarray(angles * self.direction / TICK + np.array(self.zero_ticks), dtype=np.float64)


@dataclass(frozen=True)
class Measurements:
    """Measured poses of the platform with their arm angles.

    Attributes:
        positions: (n, 3) m in charger_base, measured externally.
        angles: (n, 3) rad, as reported by servo_node.
        held_out: (n,) mask of rows to hold out of the fit; None = select at random.
        lines: (n,) line number of each row in the file.
        angle_stddev: standard deviation of each angle (rad) by the encoder's resolution; 0 if the file has angles.
        encoder: conversion of ticks to angles; None if the file has angles.
    """

    positions: Array
    angles: Array
    held_out: Mask | None
    lines: tuple[int, ...]
    angle_stddev: float = 0.0
    encoder: Encoder | None = None

    def __len__(self) -> int:
        return len(self.positions)

    def subset(self, rows: Mask) -> Measurements:
        """Return the rows selected by the mask `rows` (n,)."""
        return Measurements(
            self.positions[rows],
            self.angles[rows],
            None if self.held_out is None else self.held_out[rows],
            tuple(line for line, wanted in zip(self.lines, rows, strict=True) if wanted),
            self.angle_stddev,
            self.encoder,
        )


def read_measurements(path: str | Path, encoder: Encoder | None = None) -> Measurements:
    """Read a file of measured poses.

    Args:
        path: file.
        encoder: conversion of ticks to angles; None = as stated in the file, otherwise servo_node's defaults.

    Raises:
        OSError: the file cannot be read.
        CalibrationError: the file is invalid; names the line.
    """
    table = read_table(path)
    positions, unit = _positions(table)
    names = _group(table, (TICKS, RADIANS, DEGREES), "the arm angles")
    values = table.columns(names)
    if names == TICKS:
        used = _agreed(table, encoder)
        angles, stddev = used.angles(values), TICK / math.sqrt(12.0)
    elif encoder is not None:
        raise CalibrationError(f"zero ticks and direction were given, but the file has {names[0]}, not {TICKS[0]}")
    else:
        used, stddev = None, 0.0
        angles = np.radians(values) if names == DEGREES else values
    _check_angles(names, values, angles, table.lines)
    return Measurements(positions * unit, angles, _held_out(table), table.lines, stddev, used)


def _group(table: Table, groups: Sequence[tuple[str, ...]], what: str) -> tuple[str, ...]:
    """Return the only group of columns that the table has; it must be complete."""
    started = [group for group in groups if set(group) & set(table.names)]
    choices = " or ".join(",".join(group) for group in groups)
    if not started:
        raise CalibrationError(f"the columns of {what} are missing: give {choices}")
    if len(started) > 1:
        raise CalibrationError(f"{what} are given twice, as {started[0][0]} and {started[1][0]}: give {choices}")
    missing = [name for name in started[0] if name not in table.names]
    if missing:
        raise CalibrationError(f"column '{missing[0]}' is missing")
    return started[0]


def _positions(table: Table) -> tuple[Array, float]:
    names = _group(table, tuple(POSITION_COLUMNS), "the measured positions")
    if not table.rows:
        raise CalibrationError("the file has a header and no rows")
    return table.columns(names), POSITION_COLUMNS[names]


def _agreed(table: Table, encoder: Encoder | None) -> Encoder:
    """Return the caller's encoder, or the one stated in the file; both must agree."""
    if encoder is None:
        return Encoder(**table.stated)
    for name, value in table.stated.items():
        if getattr(encoder, name) != value:
            raise CalibrationError(f"{name} {getattr(encoder, name)} was given, but the file states {value}")
    return encoder


def _check_angles(names: tuple[str, ...], values: Array, angles: Array, lines: Sequence[int]) -> None:
    """Refuse angles in the wrong unit: no arm turns by more than half a turn or stays within 0.06 rad."""
    beyond = np.argwhere(np.abs(angles) > math.pi)
    if len(beyond):
        row, limb = beyond[0]
        hint = {
            RADIANS: "radians are expected; is it degrees?",
            DEGREES: "more than half a turn; is it ticks?",
            TICKS: "more than half a turn from its zero; check --zero-ticks",
        }[names]
        line = lines[row]
        raise CalibrationError(f"line {line}: {names[limb]} is {values[row, limb]:g}: {hint}", [line])
    if names == DEGREES and np.abs(values).max() < math.pi:
        raise CalibrationError(f"no {DEGREES[0][:-6]} angle exceeds {np.abs(values).max():.2g}°: is it radians?")


def _held_out(table: Table) -> Mask | None:
    if HELD_OUT not in table.names:
        return None
    for row, line in zip(table.rows, table.lines, strict=True):
        if row[HELD_OUT] not in ("0", "1"):
            raise CalibrationError(f"line {line}: {HELD_OUT} is '{row[HELD_OUT]}': give 0 or 1", [line])
    return np.array([row[HELD_OUT] == "1" for row in table.rows])
