# SPDX-License-Identifier: Apache-2.0
"""Strict reader of CSV files of poses: any doubtful cell is refused with its line.

It accepts semicolons or tabs as separators with decimal commas, a byte order mark and any line ending. Lines that start
with # are comments. The comments `# zero_ticks 2048 2048 2048` and `# direction 1 1 1` state zero and direction of the
encoders.
"""

from __future__ import annotations

import csv
import difflib
import io
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.bounded_file import FileRefused, read_bytes

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
PLAN_COLUMNS = (
    "pose",
    *(f"target_{axis}_mm" for axis in AXES),
    *(f"command_{limb}_deg" for limb in LIMBS),
    *(f"goal_ticks_{limb}" for limb in LIMBS),
)
"""Columns of a plan for the person or program that moves the arm; ignored as measurements."""
KNOWN = (*(name for group in POSITION_COLUMNS for name in group), *TICKS, *DEGREES, *RADIANS, HELD_OUT, *PLAN_COLUMNS)

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

    def column(self, name: str) -> Array:
        """Return a column as numbers (n,).

        Raises:
            CalibrationError: a cell is empty or no finite number; names the line.
        """
        return np.array([self._number(row[name], name, line) for row, line in zip(self.rows, self.lines, strict=True)])

    def columns(self, names: Sequence[str]) -> Array:
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
        content = read_bytes(path, LARGEST_FILE)
    except FileRefused as error:
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
