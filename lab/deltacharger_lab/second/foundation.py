# SPDX-License-Identifier: Apache-2.0
"""The two pads as elastic foundations, and their gaps to rigid ridges.

Two layers in series. A skin of thickness t, indented by δ, responds with the nominal pressure of a neo-Hookean block
compressed to the stretch λ = 1 − δ/t: p = (c E / 3) (λ⁻² − λ), c the confinement. It never pulls. Below it is
Pasternak's layer, springs joined by a shear layer: p = k (w − ℓ² ∇²w), without shear across the pad's rim. The taxels
under it carry r = k w = (1 − ℓ² ∇²)⁻¹ p: the load spread over about 2 ℓ, reflected at the rim, with the total
unchanged. Both layers follow from a convex energy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import COLUMNS, PADS, ROWS
from deltacharger_lab.second.parameters import FoundationParameters
from deltacharger_tactile.parameters import PadContactParameters

BEYOND = 1.0
"""Gap (m) of a point without a ridge."""
_LEAST_STRETCH = 0.3  # below it pressure continues along its tangent: a stop, finite at any force


@dataclass(frozen=True)
class Ridges:
    """Form errors of one target's ridges.

    Attributes:
        bow: (2,) m, distance of a ridge's middle behind its ends.
        skew: (2,) m, distance of its end at +x behind its end at −x.
    """

    bow: Array
    skew: Array

    @staticmethod
    def draw(parameters: FoundationParameters, random: np.random.Generator) -> Ridges:
        """Draw the ridges of one rig."""
        return Ridges(parameters.bow * random.standard_normal(PADS), parameters.skew * random.standard_normal(PADS))

    @staticmethod
    def straight() -> Ridges:
        """Return ridges without errors."""
        return Ridges(np.zeros(PADS), np.zeros(PADS))


class PadFoundation:
    """Both pads as grids of m × n points each, P in total; immutable.

    The grid is finer along y than along x, because ridges are narrow along y.

    Attributes:
        x: (P,) m, points along x in end_effector, left pad first.
        y: (P,) m, points along y.
        area: of a point, m².
        base: stiffness of the lower layer, Pa/m.
    """

    def __init__(self, dimensions: PadContactParameters, parameters: FoundationParameters) -> None:
        self._dimensions = dimensions
        fine = parameters.sub_samples
        self._shape = shape = (ROWS * fine, COLUMNS * ((fine + 1) // 2))
        v, u = np.meshgrid(*(dimensions.pad_side * (0.5 - (np.arange(n) + 0.5) / n) for n in shape), indexing="ij")
        centre, points = dimensions.pad_distance, shape[0] * shape[1]
        self.x = np.concatenate([u.ravel() + centre, u.ravel() - centre])
        self.y = np.concatenate([v.ravel(), v.ravel()])
        self.area = dimensions.pad_side**2 / points
        self._centre = np.repeat([centre, -centre], points)
        self._pad = np.repeat([0, 1], points)
        self._factor = parameters.confinement * parameters.modulus / 3.0
        self._thickness = parameters.thickness
        self.base = parameters.base_stiffness
        (self._down, rows), (self._right, columns) = (_waves(n) for n in shape)
        lengths = parameters.shear_length / dimensions.pad_side * np.array(shape)
        self._spread = 1.0 / (1.0 + lengths[0] ** 2 * rows[:, None] + lengths[1] ** 2 * columns)

    def gap(self, pose: Array, ridges: Ridges) -> Array:
        """Return (N, P) m, gaps between the ridges and each point at poses (N, 3); BEYOND without a ridge."""
        d = self._dimensions
        x, y, angle = (pose[:, axis, None] for axis in range(3))
        cosine, sine = np.cos(angle), np.sin(angle)
        dx, dy = self.x - x, self.y - y
        along, across = cosine * dx + sine * dy - self._centre, cosine * dy - sine * dx
        gap = across * across * (0.5 / d.crown_radius)
        missed = np.zeros(gap.shape, dtype=bool)
        for distance, half in ((np.abs(across), 0.5 * d.ridge_height), (np.abs(along), 0.5 * d.ridge_length)):
            rounding = np.maximum(distance - (half - d.edge_radius), 0.0)
            gap += d.edge_radius - np.sqrt(np.maximum(d.edge_radius**2 - rounding * rounding, 0.0))
            missed |= rounding > d.edge_radius
        missed |= along * along + across * across < 0.25 * d.hole * d.hole
        share = along / (0.5 * d.ridge_length)
        gap += ridges.bow[self._pad] * (1.0 - share * share) + 0.5 * ridges.skew[self._pad] * share
        gap[missed] = BEYOND
        return np.asarray(gap)

    def press(self, depth: Array) -> tuple[Array, Array, Array]:
        """Return pressure (Pa), its slope (Pa/m) and the energy (J/m²) of the skin at indentations (m)."""
        pressed = depth > 0.0
        stretch = 1.0 - np.maximum(depth, 0.0) / self._thickness
        held = np.maximum(stretch, _LEAST_STRETCH)
        beyond = (held - stretch) * self._thickness
        inverse = 1.0 / held
        square = inverse * inverse
        slope = (self._factor / self._thickness) * (1.0 + 2.0 * square * inverse)
        first = self._factor * (square - held)
        energy = self._factor * self._thickness * (inverse - 1.0 - 0.5 * (1.0 - held * held))
        energy += beyond * (first + 0.5 * slope * beyond)
        return first + slope * beyond, slope * pressed, energy

    def deflect(self, pressure: Array) -> Array:
        """Return the deflection (N, P) m of the lower layer under a pressure (N, P) Pa."""
        return np.asarray(self._filter(pressure).reshape(pressure.shape) / self.base)

    def taxels(self, pressure: Array) -> Array:
        """Return the forces on the taxels (N, 2, 10, 10) N by pressure (N, P) Pa; row 0 at +y, column 0 at +x."""
        down, right = self._shape[0] // ROWS, self._shape[1] // COLUMNS
        borne = self._filter(pressure).reshape(-1, PADS, ROWS, down, COLUMNS, right)
        return np.asarray(np.maximum(borne.sum(axis=(3, 5)) * self.area, 0.0))

    def _filter(self, pressure: Array) -> Array:
        grid = pressure.reshape(-1, *self._shape)
        return np.asarray(self._down.T @ ((self._down @ grid @ self._right.T) * self._spread) @ self._right)


def _waves(count: int) -> tuple[Array, Array]:
    """Return the cosine waves (n, n) of a line of points without flux at its ends, and their squared wave numbers."""
    order = np.arange(count)
    waves = np.sqrt(2.0 / count) * np.cos(np.pi * order[:, None] * (order + 0.5) / count)
    waves[0] /= np.sqrt(2.0)
    return waves, 2.0 - 2.0 * np.cos(np.pi * order / count)
