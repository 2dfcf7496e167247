# SPDX-License-Identifier: Apache-2.0
"""The electrode bars beside the pads: strips on springs that carry part of the force if they overlap the target's."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import BAR_GAP, BAR_HEIGHT, BAR_LENGTH
from deltacharger_lab.second.parameters import BarParameters

_SEGMENTS = 28  # of a bar along its length: 2.5 mm each
_RAMP = 1e-3  # m of overlap in height for the full force of a segment: bars have rounded edges


class SpringBars:
    """Both bars as segments with one spring law; immutable.

    Attributes:
        x: (2 S,) m, centre of each segment in end_effector, upper bar first.
        y: (2 S,) m.
    """

    def __init__(self, parameters: BarParameters) -> None:
        self._parameters = parameters
        width = BAR_LENGTH / _SEGMENTS
        line = 0.5 * BAR_LENGTH - width * (np.arange(_SEGMENTS) + 0.5)
        middle = 0.5 * (BAR_GAP + BAR_HEIGHT)
        self.x = np.tile(line, 2)
        self.y = np.repeat([middle, -middle], _SEGMENTS)
        self._middle, self._width = middle, width

    def overlap(self, pose: Array) -> Array:
        """Return (N, 2 S) the share of each segment, 0 to 1, that overlaps a bar of the target at poses (N, 3)."""
        x, y, angle = (pose[:, axis, None] for axis in range(3))
        cosine, sine = np.cos(angle), np.sin(angle)
        dx, dy = self.x - x, self.y - y
        along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
        end = np.clip((0.5 * BAR_LENGTH - np.abs(along)) / self._width + 0.5, 0.0, 1.0)
        off = np.minimum(np.abs(across - self._middle), np.abs(across + self._middle))
        return np.asarray(end * np.clip((BAR_HEIGHT - off) / _RAMP, 0.0, 1.0))

    def press(self, approach: Array) -> tuple[Array, Array, Array]:
        """Return force (N), its slope (N/m) and the energy (J) of full segments at approaches (N, 2 S) m.

        The bar first leaves its stop (preload), then its springs yield, then it is solid.
        """
        p = self._parameters
        share = 1.0 / _SEGMENTS
        depth = np.maximum(approach + p.proud, 0.0)
        seated, late = np.minimum(depth, p.seat), np.maximum(depth - p.travel, 0.0)
        first = p.preload / p.seat
        force = first * seated + p.rate * depth + p.stop_stiffness * late
        slope = (depth > 0.0) * p.rate + first * ((depth > 0.0) & (depth < p.seat)) + p.stop_stiffness * (late > 0.0)
        energy = first * seated * (depth - 0.5 * seated) + 0.5 * p.rate * depth**2 + 0.5 * p.stop_stiffness * late**2
        return share * force, share * slope, share * energy
