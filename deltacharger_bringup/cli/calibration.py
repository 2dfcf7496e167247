# SPDX-License-Identifier: Apache-2.0
"""Common to the calibration commands: files of measured poses, the arm's geometry, and the result."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterator
from typing import Any

from deltacharger_bringup.cli.output import DONE, FAILED, WRONG_INPUT, CommandError, log_line, print_result, wrong_input
from deltacharger_kinematics.calibration.data import Encoder
from deltacharger_kinematics.calibration.table import CalibrationError
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.geometry_file import load_geometry


@contextlib.contextmanager
def refusing(path: str) -> Iterator[None]:
    """Report an invalid file of measurements with exit code 2 and its lines.

    Raises:
        CommandError: instead of CalibrationError.
    """
    try:
        yield
    except CalibrationError as error:
        raise CommandError(f"{path}: {error}", WRONG_INPUT, file=path, lines=list(error.lines)) from error


def encoder_of(options: argparse.Namespace) -> Encoder | None:
    """Return the encoder that the options define; None if they define none.

    Raises:
        CommandError: a direction is not 1 or -1.
    """
    given = {"zero_ticks": options.zero_ticks, "direction": options.direction}
    values = {name: tuple(value) for name, value in given.items() if value is not None}
    with wrong_input(CalibrationError):
        return Encoder(**values) if values else None


def geometry_of(path: str | None) -> DeltaGeometry:
    """Return the arm's geometry from a file, or the built-in one.

    Raises:
        CommandError: the file is refused; exit code 2.
    """
    with wrong_input(ValueError, file=path):
        return DeltaGeometry() if path is None else load_geometry(path)


def conclude(
    options: argparse.Namespace,
    refused: bool,
    save: Callable[[str], None],
    text: str,
    value: dict[str, Any],
    remarks: list[str],
) -> int:
    """Print a calibration, write it to --out unless it is doubtful without --force, return the exit code.

    Args:
        options: of the command, with `out` and `force`.
        refused: whether it should not be used.
        save: writes it to a file.
        text: the calibration for people.
        value: the calibration for the JSON object.
        remarks: printed on stderr.
    """
    written = options.out if options.out is not None and (options.force or not refused) else None
    if written is not None:
        save(written)
    success = not refused or written is not None
    print_result(options, text, {"success": success, **value, "written": written})
    for remark in remarks:
        log_line(remark)
    if written is not None:
        log_line(f"wrote {written}")
    elif options.out is not None:
        log_line(f"{options.out} was not written; --force writes it anyway")
    return DONE if success else FAILED
