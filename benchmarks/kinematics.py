"""What one point costs: arrays against the one-point path, in one run.

python benchmarks/kinematics.py
"""

from __future__ import annotations

import timeit
from collections.abc import Callable

import numpy as np

from deltacharger_kinematics import Delta
from deltacharger_kinematics.scalar import ScalarDelta

POINT = (0.012, -0.021, 0.064)
BATCH = 8192


def cost(call: Callable[[], object], points: int = 1) -> float:
    """Return µs per point, the best of five."""
    timer = timeit.Timer(call)
    number, _ = timer.autorange()
    return min(timer.repeat(5, number)) / number / points * 1e6


def main() -> None:
    delta, scalar = Delta(), ScalarDelta()
    angles = scalar.inverse(*POINT)
    geometry = delta.geometry
    points = np.random.default_rng(1).uniform(geometry.workspace_min, geometry.workspace_max, (BATCH, 3))
    many = delta.inverse(points).angles
    rows = [
        ("inverse", lambda: scalar.inverse(*POINT), lambda: delta.inverse(POINT), lambda: delta.inverse(points)),
        ("forward", lambda: scalar.forward(*angles), lambda: delta.forward(angles), lambda: delta.forward(many)),
        ("jacobian", lambda: scalar.jacobian(*POINT), lambda: delta.jacobian(POINT), lambda: delta.jacobian(points)),
    ]
    print(f"{'':<10}{'scalar':>10}{'array, 1':>12}{f'array, {BATCH}':>14}   µs per point")
    for name, one, alone, batch in rows:
        print(f"{name:<10}{cost(one):>10.2f}{cost(alone):>12.1f}{cost(batch, BATCH):>14.3f}")


if __name__ == "__main__":
    main()
