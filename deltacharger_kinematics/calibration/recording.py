# SPDX-License-Identifier: Apache-2.0
"""Appends measured poses to a file one by one, so that no measurement is lost and a recording can resume."""

from __future__ import annotations

from pathlib import Path

from deltacharger_core.bounded_file import read_bytes
from deltacharger_core.files import append_text
from deltacharger_kinematics.calibration.data import Encoder
from deltacharger_kinematics.calibration.plan import PlannedPose
from deltacharger_kinematics.calibration.table import (
    AXES,
    HELD_OUT,
    LARGEST_FILE,
    MILLIMETRE,
    TICKS,
    CalibrationError,
    read_table,
)
from deltacharger_kinematics.geometry import Vector

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
