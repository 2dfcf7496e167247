# SPDX-License-Identifier: Apache-2.0
"""The dockings of a recorded data set: the paper's two sets, reference dockings and signed poses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_tactile.dataset import (
    POSITION_CLASSES,
    POSITION_LIMIT,
    SUBSET_ANGLE,
    SUBSET_CONTINUOUS,
    SUBSET_POSITION,
)

SETS = ("position", "angle", "reference", "sweep")
SUBSETS = dict(zip(SETS, (SUBSET_POSITION, SUBSET_ANGLE, SUBSET_CONTINUOUS, SUBSET_CONTINUOUS), strict=True))
REPEATS = {"position": 20, "angle": 100, "reference": 10, "sweep": 100}
"""Dockings at each offset (position), else in total (paper; reference and sweep are ours)."""
TILTED = {"angle": 5.0, "sweep": 20.0}
"""Sets with a turned target, and the largest angle, degrees."""
OFFSETS_MM = tuple(1e3 * value for value in POSITION_CLASSES)
_LEFT_BY_VISION = 0.1  # of the start's offset (assumed; the paper states only the starts)
_START_STEP, _START_STEPS = 0.004, 5  # m; the start varies by ±20 mm in steps of 4 mm (paper)


@dataclass(frozen=True)
class CommandedPose:
    """Desired pose of the target in end_effector: m, m, rad, signed as in Dataset."""

    horizontal: float
    vertical: float
    angle: float


@dataclass(frozen=True)
class Part:
    """What one command records, in the units of the command line.

    Attributes:
        set: one of SETS.
        angle_deg: of the target about +z of charger_base, from +x to +y.
        repeat: dockings at each offset of the position set, in total for other sets.
        seed: of order and offsets.
        x_mm, y_mm, z_mm: position of the target's electrodes in charger_base.
        offsets_mm: of the position set, along each axis.
    """

    set: str
    angle_deg: float
    repeat: int
    seed: int
    x_mm: float
    y_mm: float
    z_mm: float
    offsets_mm: tuple[float, ...] = OFFSETS_MM

    @property
    def name(self) -> str:
        """Unique name in a file: the set, and its angle if it has one."""
        return f"{self.set} {self.angle_deg:g}°" if self.set in TILTED else self.set

    @property
    def target(self) -> tuple[float, float, float]:
        """Position of the target's electrodes, m, charger_base."""
        return 1e-3 * self.x_mm, 1e-3 * self.y_mm, 1e-3 * self.z_mm

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Part:
        """Return a part from its fields in JSON; TypeError or KeyError if one is wrong."""
        return Part(**{**values, "offsets_mm": tuple(values["offsets_mm"])})

    def poses(self) -> list[CommandedPose]:
        """Return every docking's pose in the order of recording; equal arguments give equal poses.

        Each repetition of the position set has a new order of offsets, so that drift does not look like an offset.
        """
        angle, random = math.radians(self.angle_deg), self._random()
        if self.set == "position":
            grid = 1e-3 * np.array([(x, y) for x in self.offsets_mm for y in self.offsets_mm])
            offsets = np.concatenate([random.permutation(grid) for _ in range(self.repeat)])
        elif self.set == "angle":
            offsets = _LEFT_BY_VISION * self.starts()
        elif self.set == "reference":
            offsets = np.zeros((self.repeat, 2))
        else:
            offsets = random.uniform(-POSITION_LIMIT, POSITION_LIMIT, (self.repeat, 2))
        return [CommandedPose(float(x), float(y), angle) for x, y in offsets]

    def starts(self) -> Array:
        """Return (repeat, 2) m: the arm's start offset from the target in each docking of the angle set."""
        return np.asarray(_START_STEP * self._random().integers(-_START_STEPS, _START_STEPS + 1, (self.repeat, 2)))

    def _random(self) -> np.random.Generator:
        return np.random.default_rng([SETS.index(self.set), self.seed, round(1e3 * self.angle_deg) % 2**32])
