# SPDX-License-Identifier: Apache-2.0
"""Measurements for a calibration of the arm: poses to measure, their recording, and the tables that hold them.

Strict reader of CSV files of poses: any doubtful cell is refused with its line.
It accepts semicolons or tabs as separators with decimal commas, a byte order mark and any line ending. Lines that start
with # are comments. The comments `# zero_ticks 2048 2048 2048` and `# direction 1 1 1` state zero and direction of the
encoders.
"""

from __future__ import annotations

import csv
import difflib
import io
import itertools
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltacharger_core import arrays, files, machine
from deltacharger_kinematics.geometry import DeltaGeometry, Vector

Triple = tuple[int, int, int]

MILLIMETRE = 1e-3
AXES, LIMBS = "xyz", range(3)

POSITION_COLUMNS = {
    tuple(f"{axis}_mm" for axis in AXES): MILLIMETRE,
    tuple(f"{axis}_m" for axis in AXES): 1.0,
}
"""Columns of the measured position in charger_base, with their unit in m."""
TICKS = tuple(f"ticks_{limb}" for limb in LIMBS)
DEGREES = tuple(f"angle_{limb}_deg" for limb in LIMBS)
RADIANS = tuple(f"angle_{limb}_rad" for limb in LIMBS)
HELD_OUT = "held_out"
POSE = "pose"
"""Column with the number of a pose of --measure; ignored as measurement."""
KNOWN = (*(name for group in POSITION_COLUMNS for name in group), *TICKS, HELD_OUT, POSE)

LARGEST_FILE = 4 * 2**20
"""Maximum bytes of a file, far above any real measurement."""
_MOST_LINES, _MOST_ROWS, _LONGEST_LINE = 100_000, 10_000, 2000
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_STATEMENT = re.compile(r"#\s*(zero_ticks|direction)\b(.*)")


class CalibrationError(ValueError):
    """The measurements cannot be used.

    Attributes:
        lines: affected lines of the file; empty = the entire file.
    """

    def __init__(self, message: str, lines: Sequence[int] = ()) -> None:
        self.lines = tuple(lines)
        super().__init__(message)


@dataclass(frozen=True)
class Table:
    """Content of a file: cells by column name, line number of each row, encoder statements in comments."""

    names: tuple[str, ...]
    rows: tuple[dict[str, str], ...]
    lines: tuple[int, ...]
    stated: dict[str, Triple]
    decimal_comma: bool

    def column(self, name: str) -> arrays.Array:
        """Return a column as numbers (n,).

        Raises:
            CalibrationError: a cell is empty or no finite number; names the line.
        """
        return np.array([self._number(row[name], name, line) for row, line in zip(self.rows, self.lines, strict=True)])

    def columns(self, names: Sequence[str]) -> arrays.Array:
        """Return columns side by side (n, len(names)); errors as in `column`."""
        return np.stack([self.column(name) for name in names], axis=-1)

    def _number(self, cell: str, name: str, line: int) -> float:
        if not cell:
            raise CalibrationError(f"line {line}: {name} is empty: fill it in, or delete the row", [line])
        text = cell.replace(",", ".") if self.decimal_comma and "." not in cell and cell.count(",") == 1 else cell
        value = float(text) if _NUMBER.fullmatch(text) else math.nan
        if not math.isfinite(value):
            raise CalibrationError(f"line {line}: {name} is '{cell}', which is not a plain finite number", [line])
        return value


def read_table(path: str | Path, known: Sequence[str] = KNOWN, page: str = "docs/calibration.md") -> Table:
    """Read a file into cells; errors as in `read_measurements`.

    Args:
        path: file.
        known: valid column names.
        page: documentation page of the columns.
    """
    header: list[str] = []
    rows, lines = list[dict[str, str]](), list[int]()
    stated: dict[str, Triple] = {}
    delimiter = ","
    for line, text in _lines(Path(path)):
        if len(rows) == _MOST_ROWS:
            raise CalibrationError(f"more than {_MOST_ROWS} rows: give one row per measured pose")
        bare = text.strip().lstrip('"').lstrip()
        if bare.startswith("#"):
            stated |= _statement(bare, line)
            continue
        if not text.strip(' \t,;"'):
            continue
        if not header:
            delimiter = next((mark for mark in ";\t" if mark in text), ",")
            header = _header(_cells(text, delimiter, line), line, known, page)
            continue
        cells = _cells(text, delimiter, line)
        _drop_empty(cells, len(header))
        if len(cells) != len(header):
            hint = "; are there decimal commas? write decimal points, or separate the cells with semicolons"
            raise CalibrationError(
                f"line {line}: {len(cells)} cells for {len(header)} columns"
                + (hint if delimiter == "," and len(cells) > len(header) else ""),
                [line],
            )
        rows.append(dict(zip(header, cells, strict=True)))
        lines.append(line)
    if not header:
        raise CalibrationError(f"the file is empty: give a header row, see {page}")
    return Table(tuple(header), tuple(rows), tuple(lines), stated, delimiter != ",")


def _decoded(path: Path) -> str:
    try:
        content = files.read_bytes(path, LARGEST_FILE)
    except files.FileRefused as error:
        raise CalibrationError(f"{error.strerror}: give the measured poses only") from error
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise CalibrationError("the file is UTF-16: save it as 'CSV UTF-8'")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CalibrationError(f"line {line} is not UTF-8: save the file as 'CSV UTF-8'", [line]) from None
    if "\0" in text:
        raise CalibrationError("the file holds zero bytes, so it is not text: save it as 'CSV UTF-8'")
    return text


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the number and the text of each line."""
    for line, text in enumerate(io.StringIO(_decoded(path), newline=None), start=1):
        if line > _MOST_LINES or len(text) > _LONGEST_LINE:
            raise CalibrationError(
                f"line {line}: more than {_LONGEST_LINE} characters or {_MOST_LINES} lines: is this a table of poses?",
                [line],
            )
        yield line, text.removesuffix("\n")


def _cells(text: str, delimiter: str, line: int) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([text], delimiter=delimiter, strict=True))]
    except csv.Error as error:
        raise CalibrationError(f"line {line}: {error}; a quoted cell must end on its own line", [line]) from None


def _drop_empty(cells: list[str], wanted: int) -> None:
    """Drop the empty cells that a spreadsheet adds up to the width of its widest line."""
    while len(cells) > wanted and not cells[-1]:
        cells.pop()


def _header(names: list[str], line: int, known: Sequence[str], page: str) -> list[str]:
    _drop_empty(names, 1)
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"{page} lists the columns"
            raise CalibrationError(f"line {line}: unknown column '{name}'; {hint}", [line])
        if names.count(name) > 1:
            raise CalibrationError(f"line {line}: column '{name}' appears {names.count(name)} times", [line])
    return names


def _statement(comment: str, line: int) -> dict[str, Triple]:
    found = _STATEMENT.match(comment)
    numbers = re.findall(r"[-+]?\d+", found[2], re.ASCII) if found else []
    if found is None or not numbers:
        return {}
    if len(numbers) != 3 or max(map(len, numbers)) > 9:
        raise CalibrationError(f"line {line}: the comment must state three whole numbers for {found[1]}", [line])
    return {found[1]: (int(numbers[0]), int(numbers[1]), int(numbers[2]))}


TICK = 2.0 * math.pi / machine.TICKS_PER_TURN  # rad; encoder of the MX-64


@dataclass(frozen=True)
class Encoder:
    """Zero and direction of the encoders: angle = direction · (ticks − zero_ticks) · 2π/4096, as in servo_node.

    Raises:
        CalibrationError: a direction is not 1 or −1, or a count is out of range.
    """

    zero_ticks: Triple = (2048, 2048, 2048)
    direction: Triple = (1, 1, 1)

    def __post_init__(self) -> None:
        if len(self.zero_ticks) != 3 or any(abs(value) > machine.EXTENDED_TICKS for value in self.zero_ticks):
            raise CalibrationError(
                f"zero_ticks is {self.zero_ticks}: give three counts within ±{machine.EXTENDED_TICKS}"
            )
        if len(self.direction) != 3 or any(value not in (1, -1) for value in self.direction):
            raise CalibrationError(f"direction is {self.direction}: give 1 or -1 for each of the three servos")

    @property
    def statement(self) -> str:
        """The encoder as comment lines of a measurement file."""
        named = (("zero_ticks", self.zero_ticks), ("direction", self.direction))
        return "".join(f"# {name} {' '.join(map(str, values))}\n" for name, values in named)

    def angles(self, ticks: arrays.Array) -> arrays.Array:
        """Return the arm angles (..., 3) rad of encoder counts (..., 3)."""
        return np.asarray((ticks - np.array(self.zero_ticks)) * self.direction * TICK, dtype=np.float64)

    def ticks(self, angles: arrays.Array) -> arrays.Array:
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
        angle_stddev: standard deviation of each angle (rad) by the encoder's resolution.
        encoder: conversion of ticks to angles; None = angles of another origin.
    """

    positions: arrays.Array
    angles: arrays.Array
    held_out: arrays.Mask | None
    lines: tuple[int, ...]
    angle_stddev: float = 0.0
    encoder: Encoder | None = None

    def __len__(self) -> int:
        return len(self.positions)

    def subset(self, rows: arrays.Mask) -> Measurements:
        """Return the rows selected by the mask `rows` (n,)."""
        return Measurements(
            self.positions[rows],
            self.angles[rows],
            None if self.held_out is None else self.held_out[rows],
            tuple(line for line, wanted in zip(self.lines, rows, strict=True) if wanted),
            self.angle_stddev,
            self.encoder,
        )


def read_measurements(path: str | Path) -> Measurements:
    """Read a file of measured poses; its ticks are converted as it states, otherwise by servo_node's defaults.

    Raises:
        OSError: the file cannot be read.
        CalibrationError: the file is invalid; names the line.
    """
    table = read_table(path)
    positions, unit = _positions(table)
    ticks = table.columns(_group(table, (TICKS,), "the arm angles"))
    used = Encoder(**table.stated)
    angles = used.angles(ticks)
    for row, limb in np.argwhere(np.abs(angles) > math.pi)[:1]:
        line, near = table.lines[row], "more than half a turn from its zero; check zero_ticks"
        raise CalibrationError(f"line {line}: {TICKS[limb]} is {ticks[row, limb]:g}: {near}", [line])
    return Measurements(positions * unit, angles, _held_out(table), table.lines, TICK / math.sqrt(12.0), used)


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


def _positions(table: Table) -> tuple[arrays.Array, float]:
    names = _group(table, tuple(POSITION_COLUMNS), "the measured positions")
    if not table.rows:
        raise CalibrationError("the file has a header and no rows")
    return table.columns(names), POSITION_COLUMNS[names]


def _held_out(table: Table) -> arrays.Mask | None:
    if HELD_OUT not in table.names:
        return None
    for row, line in zip(table.rows, table.lines, strict=True):
        if row[HELD_OUT] not in ("0", "1"):
            raise CalibrationError(f"line {line}: {HELD_OUT} is '{row[HELD_OUT]}': give 0 or 1", [line])
    return np.array([row[HELD_OUT] == "1" for row in table.rows])


GRID = 3  # poses along each edge of the box
HELD_OUT_POSES = 9
_INSET = 0.95  # of the box; a real arm reaches some millimetres less than its drawing
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


COLUMNS = ("pose", HELD_OUT, *_MEASURED)


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
        if not files.read_bytes(self._path, LARGEST_FILE).endswith(b"\n"):
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
        files.append_text(self._path, text)
