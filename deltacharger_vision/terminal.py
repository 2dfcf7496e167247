# SPDX-License-Identifier: Apache-2.0
"""The geometry that is looked for: two metal bars, one above the other, proud of a dark plate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import BAR_GAP, BAR_HEIGHT, BAR_LENGTH
from deltacharger_core.parameters import Bounded, ParameterError, from_mapping, number
from deltacharger_core.yaml_file import YamlError, read_yaml
from deltacharger_vision.errors import TerminalError

LOWER, UPPER = 0, 1
"""Rows of `Terminal.corners`."""


@dataclass(frozen=True)
class Terminal(Bounded):
    """Two equal bars; lengths in m.

    The terminal's frame: origin at the midpoint between the bars on their touched faces, x along the bars, y from the
    lower to the upper bar, z **into the plate**, away from who looks at it. So its axes are those of `charger_base`
    (+z toward the target, +y up, +x to the left when looking along +z) when the target stands straight before the
    charger, and the plate's face lies at z = bar_thickness.

    Raises:
        ParameterError: a length is out of bounds.
    """

    bar_length: float = number(BAR_LENGTH, 0.005, 1.0, "m", "along x (assumed)")
    bar_height: float = number(BAR_HEIGHT, 0.001, 0.5, "m", "of one bar along y (assumed)")
    gap: float = number(BAR_GAP, 0.0005, 0.5, "m", "between the bars along y (assumed)")
    bar_thickness: float = number(0.006, 0.0, 0.1, "m", "of the bars above the plate (assumed)")

    @property
    def spacing(self) -> float:
        """Distance between the bars' middle lines, m."""
        return self.bar_height + self.gap

    def corners(self) -> Array:
        """Return (2, 4, 3) m: corners of the touched face of the lower, then the upper bar, in the terminal's frame.

        Each in the order (−x, −y), (+x, −y), (+x, +y), (−x, +y): counter-clockwise about +z, clockwise in an image of
        a camera that looks along +z with y down and x right.
        """
        x, y = self.bar_length / 2, self.bar_height / 2
        face = np.array([(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)])
        shift = np.array([0.0, self.spacing / 2, 0.0])
        return np.stack([face - shift, face + shift])

    @staticmethod
    def load(path: str | Path) -> Terminal:
        """Read a YAML mapping with any of the four lengths in m; what is not there keeps its default.

        Raises:
            FileNotFoundError: there is no such file.
            TerminalError: it is no such mapping; a key is unknown; a length is out of bounds.
        """
        source = str(path)
        try:
            found = read_yaml(path)
        except YamlError as error:
            raise TerminalError(source, f"{error.problem}; correct it") from error
        try:
            return from_mapping(found, Terminal)
        except ParameterError as error:
            raise TerminalError(source, f"{error}; lengths are in metres, such as bar_length: 0.07") from error
