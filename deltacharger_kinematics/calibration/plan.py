# SPDX-License-Identifier: Apache-2.0
"""Poses that a calibration should measure, and their recording."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltacharger_core.files import append_text, read_bytes
from deltacharger_kinematics.calibration.data import (
    AXES,
    HELD_OUT,
    LARGEST_FILE,
    MILLIMETRE,
    PLAN_COLUMNS,
    TICKS,
    CalibrationError,
    Encoder,
    read_table,
)
from deltacharger_kinematics.delta import Delta
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.status import Status

GRID = 3  # poses along each edge of the box
HELD_OUT_POSES = 9
_INSET = 0.95  # of the box; a real arm reaches some millimetres less than its drawing
_TARGETS = tuple(f"target_{axis}_mm" for axis in AXES)
_MEASURED = (*TICKS, *(f"{axis}_mm" for axis in AXES))


@dataclass(frozen=True)
class PlannedPose:
    """A pose to measure: number from 1, whether it is held out of the fit, position (m, charger_base)."""

    number: int
    held_out: bool
    position: Vector


def plan(geometry: DeltaGeometry, seed: int = 0) -> tuple[PlannedPose, ...]:
    """Return a grid of 27 poses in an order of neighbours, and 9 held-out poses between them.

    The held-out poses are a Latin hypercube: in each coordinate one pose in each ninth of the box.
    """
    middle = 0.5 * (np.array(geometry.workspace_max) + np.array(geometry.workspace_min))
    reach = 0.5 * _INSET * (np.array(geometry.workspace_max) - np.array(geometry.workspace_min))
    levels = np.linspace(-1.0, 1.0, GRID)
    grid = [
        (x, y, z)
        for z, (row, y) in itertools.product(levels, enumerate(levels))
        for x in (levels if row % 2 == 0 else levels[::-1])
    ]
    draw = np.random.default_rng(seed)
    ninths = (2.0 * np.arange(HELD_OUT_POSES) + 1.0) / HELD_OUT_POSES - 1.0
    between = np.stack([draw.permutation(ninths), draw.permutation(ninths), ninths], axis=-1)
    points = middle + reach * np.concatenate([np.array(grid), between])
    return tuple(
        PlannedPose(number, number > len(grid), (float(point[0]), float(point[1]), float(point[2])))
        for number, point in enumerate(points, start=1)
    )


def write_plan(path: str | Path, poses: Sequence[PlannedPose], geometry: DeltaGeometry, encoder: Encoder) -> None:
    """Write a table of `poses` with commanded angles and goal ticks, and empty columns for the measurements.

    Raises:
        CalibrationError: the arm cannot reach a pose.
        OSError: the file cannot be written.
    """
    positions = np.array([pose.position for pose in poses])
    solved = Delta(geometry).inverse(positions)
    for pose, status in zip(poses, np.atleast_1d(np.asarray(solved.status)), strict=True):
        if status:
            raise CalibrationError(
                f"pose {pose.number}: {Status(int(status)).name}; reduce the geometry's workspace box to its reach"
            )
    rows = [
        (pose.number, int(pose.held_out))
        + tuple(f"{value / MILLIMETRE:.3f}" for value in pose.position)
        + tuple(f"{value:.3f}" for value in np.degrees(angles))
        + tuple(f"{value:.0f}" for value in encoder.ticks(angles))
        + ("",) * len(_MEASURED)
        for pose, angles in zip(poses, solved.angles, strict=True)
    ]
    with Path(path).open("w", encoding="utf-8", newline="") as file:
        file.write(
            "# Go to each pose and wait until the arm rests. Enter the ticks read from the servos, and x, y, z as\n"
            f"# measured in charger_base. Delete rows that were not measured.\n{encoder.statement}"
        )
        csv.writer(file, lineterminator="\n").writerows([("pose", HELD_OUT, *PLAN_COLUMNS[1:], *_MEASURED), *rows])


def read_plan(path: str | Path) -> tuple[PlannedPose, ...]:
    """Read the poses of a plan; other columns may be empty.

    Raises:
        OSError: the file cannot be read.
        CalibrationError: the file is invalid; names the line.
    """
    table = read_table(path)
    for name in ("pose", HELD_OUT, *_TARGETS):
        if name not in table.names:
            raise CalibrationError(f"column '{name}' is missing: give a file written by --plan")
    positions = table.columns(_TARGETS) * MILLIMETRE
    numbers, held_out = table.column("pose"), table.column(HELD_OUT)
    if len(set(numbers)) != len(numbers):
        raise CalibrationError("two rows have the same number in column 'pose'")
    return tuple(
        PlannedPose(int(number), bool(kept), (float(x), float(y), float(z)))
        for number, kept, (x, y, z) in zip(numbers, held_out, positions, strict=True)
    )


COLUMNS = ("pose", HELD_OUT, *TICKS, *(f"{axis}_mm" for axis in AXES))


class PoseRecording:
    """Measured poses in a file that `read_measurements` reads.

    Args:
        path: file; created if missing, otherwise continued.
        encoder: encoder of the ticks.

    Attributes:
        encoder: as given.
        done: numbers of the recorded poses.

    Raises:
        OSError: the file cannot be read or written.
        CalibrationError: the file is no recording, or was recorded with another encoder.
    """

    def __init__(self, path: str | Path, encoder: Encoder) -> None:
        self._path = Path(path)
        self.encoder = encoder
        self.done: set[int] = set()
        if not self._path.exists():
            self._write(f"{encoder.statement}{','.join(COLUMNS)}\n")
            return
        table = read_table(self._path)
        if table.names != COLUMNS or table.decimal_comma:
            raise CalibrationError(f"{path} is no recording of --measure: give a new file, or one written by --measure")
        if Encoder(**table.stated) != encoder:
            raise CalibrationError(f"{path} was recorded with other zero ticks or directions: give a new file")
        self.done = {int(number) for number in table.column("pose")}
        if not read_bytes(self._path, LARGEST_FILE).endswith(b"\n"):
            self._write("\n")

    def append(self, pose: PlannedPose, ticks: Vector, position: Vector) -> None:
        """Add one row and sync it to the disk.

        Args:
            pose: the measured pose.
            ticks: encoder counts.
            position: m in charger_base.
        """
        cells = [str(pose.number), str(int(pose.held_out)), *(f"{value:.2f}" for value in ticks)]
        self._write(",".join([*cells, *(f"{value / MILLIMETRE:.4f}" for value in position)]) + "\n")
        self.done.add(pose.number)

    def _write(self, text: str) -> None:
        append_text(self._path, text)
