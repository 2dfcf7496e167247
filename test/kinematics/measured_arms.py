# SPDX-License-Identifier: Apache-2.0
"""Random arms within the tolerances, and an operator's measurements of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration.data import Encoder, Measurements
from deltacharger_kinematics.calibration.plan import plan
from deltacharger_kinematics.calibration.problem import COUNT, Uncertainty, numbers, with_numbers

NOMINAL = DeltaGeometry()
STATED = Uncertainty()
MILLIMETRE = 1e-3
POSES = plan(NOMINAL)
POINTS = np.array([pose.position for pose in POSES])
KEPT = np.array([pose.held_out for pose in POSES])
HEADER = "x_mm,y_mm,z_mm,ticks_0,ticks_1,ticks_2"


def drawn_arm(seed: int) -> DeltaGeometry:
    return with_numbers(NOMINAL, numbers(NOMINAL) + np.random.default_rng(seed).normal(size=COUNT) * STATED.tolerances)


def measured(
    arm: DeltaGeometry, points: np.ndarray = POINTS, noise: float = 0.05 * MILLIMETRE, seed: int = 1, play: float = 0.0
) -> Measurements:
    random = np.random.default_rng(seed)
    angles = Delta(NOMINAL).inverse(points).angles
    there = Delta(arm).forward(angles + play * random.choice([-1.0, 1.0], angles.shape)).position
    kept = KEPT if points is POINTS else None
    return Measurements(there + random.normal(size=there.shape) * noise, angles, kept, tuple(range(2, len(points) + 2)))


def write(path: Path, rows: Measurements, encoder: Encoder | None = None, header: str = HEADER) -> Path:
    ticks = (encoder or Encoder()).ticks(rows.angles)
    lines = [",".join(f"{v:.6f}" for v in (*p / MILLIMETRE, *t)) for p, t in zip(rows.positions, ticks, strict=True)]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path
