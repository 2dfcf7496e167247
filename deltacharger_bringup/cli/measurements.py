# SPDX-License-Identifier: Apache-2.0
"""What the calibration commands share that read or write files of measured poses."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator

from deltacharger_bringup.cli.output import WRONG_INPUT, CommandError
from deltacharger_kinematics.calibration.data import Encoder
from deltacharger_kinematics.calibration.table import CalibrationError


@contextlib.contextmanager
def refusing(path: str) -> Iterator[None]:
    """Turn what is wrong with a file of measurements into exit code 2 and its lines.

    Raises:
        CommandError: instead of CalibrationError.
    """
    try:
        yield
    except CalibrationError as error:
        raise CommandError(f"{path}: {error}", WRONG_INPUT, file=path, lines=list(error.lines)) from error


def encoder_of(options: argparse.Namespace) -> Encoder | None:
    """Return the encoder that the options state; None where they state nothing.

    Raises:
        CommandError: a direction is not 1 or -1.
    """
    given = {"zero_ticks": options.zero_ticks, "direction": options.direction}
    values = {name: tuple(value) for name, value in given.items() if value is not None}
    try:
        return Encoder(**values) if values else None
    except CalibrationError as error:
        raise CommandError(str(error), WRONG_INPUT) from error
