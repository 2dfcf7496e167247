# SPDX-License-Identifier: Apache-2.0
"""Geometry of a terminal: two metal bars, one above the other, raised from a dark plate."""

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
    lower to the upper bar, z **into the plate**, away from the viewer. If the target stands straight in front of the
    charger, the axes are those of `charger_base` (+z toward the target, +y up, +x to the left when looking along +z).
    The plate's face is at z = bar_thickness.

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

        Order: (−x, −y), (+x, −y), (+x, +y), (−x, +y): counter-clockwise about +z, clockwise in an image of a camera
        that looks along +z with y down and x right.
        """
        x, y = self.bar_length / 2, self.bar_height / 2
        face = np.array([(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)])
        shift = np.array([0.0, self.spacing / 2, 0.0])
        return np.stack([face - shift, face + shift])

    @staticmethod
    def load(path: str | Path) -> Terminal:
        """Read a YAML mapping of any of the four lengths in m; missing ones keep their defaults.

        Raises:
            FileNotFoundError: no such file.
            TerminalError: not such a mapping, an unknown key, or a length out of bounds.
        """
        source = str(path)
        try:
            found = read_yaml(path)
        except YamlError as error:
            raise TerminalError(source, f"{error.problem}; correct it") from error
        try:
            return from_mapping(found, Terminal)
        except ParameterError as error:
            raise TerminalError(source, str(error)) from error
