# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the geometry calibration: random arms are measured, fitted and compared with the truth.

python lab/benchmarks/calibration.py                  errors before and after, about three minutes
python lab/benchmarks/calibration.py --example FILE   one drawn arm as a file of measurements, as in docs/calibration.md
"""

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration.calibrate import COUNT, Uncertainty, fit, numbers, rms, with_numbers
from deltacharger_kinematics.calibration.data import TICK, Encoder, Measurements, PoseRecording, plan

NOMINAL = DeltaGeometry()
STATED = Uncertainty()
ARMS = 100
NOISE = 0.05e-3  # m, of each measured coordinate
BACKLASH = math.radians(0.165)  # in both directions, of each arm
GRID = np.array([pose.position for pose in plan(NOMINAL) if not pose.held_out])
BOX = np.random.default_rng(1).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (300, 3))
BOX_ANGLES = Delta(NOMINAL).inverse(BOX).angles

Draw = Callable[[np.random.Generator], np.ndarray]


def normal(random: np.random.Generator) -> np.ndarray:
    return random.normal(size=COUNT)


def uniform(random: np.random.Generator) -> np.ndarray:
    return random.uniform(-1.0, 1.0, COUNT)


def drawn_arm(random: np.random.Generator, draw: Draw) -> DeltaGeometry:
    return with_numbers(NOMINAL, numbers(NOMINAL) + draw(random) * STATED.tolerances)


def measure(
    arm: DeltaGeometry,
    random: np.random.Generator,
    points: np.ndarray = GRID,
    *,
    noise: float = NOISE,
    ticks: bool = False,
    backlash: float = 0.0,
    frame: float = 0.0,
) -> Measurements:
    """Return an operator's measurements: the arm commanded to `points`, the measuring frame turned by `frame`."""
    angles = Delta(NOMINAL).inverse(points).angles
    true = angles + backlash * random.choice([-1.0, 1.0], angles.shape)
    x, y, z = Delta(arm).forward(true).position.T
    turned = np.stack(
        [x * math.cos(frame) + y * math.sin(frame), y * math.cos(frame) - x * math.sin(frame), z], axis=-1
    )
    noted = np.round(angles / TICK) * TICK if ticks else angles
    return Measurements(
        turned + random.normal(scale=noise, size=turned.shape),
        noted,
        None,
        tuple(range(2, len(points) + 2)),
        TICK / math.sqrt(12.0) if ticks else 0.0,
    )


def error(arm: DeltaGeometry, model: DeltaGeometry) -> float:
    """Return the rms distance (m) between positions of `arm` and of `model`, over the workspace."""
    return rms(Delta(arm).forward(BOX_ANGLES).position - Delta(model).forward(BOX_ANGLES).position)


def table() -> None:
    some = np.random.default_rng(2)
    nine = some.uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (9, 3))
    angles_only = Uncertainty(length=1e-9)
    cases: list[tuple[str, dict[str, object], Uncertainty]] = [
        ("18 numbers, 27 poses", {}, STATED),
        ("angle offsets only", {}, angles_only),
        ("noise 0.2 mm", {"noise": 0.2e-3}, STATED),
        ("angles in whole ticks", {"ticks": True}, STATED),
        ("backlash ±0.165°", {"backlash": BACKLASH}, STATED),
        ("measuring frame turned 0.2° about z", {"frame": math.radians(0.2)}, STATED),
        ("9 poses", {"points": nine}, STATED),
    ]
    print(f"{'error over the workspace, mm rms of ' + str(ARMS) + ' arms':<44}{'normal':>18}{'uniform':>18}")
    print(f"{'':<44}" + f"{'rms':>10}{'worst':>8}" * 2)
    uncalibrated = [[error(arm, NOMINAL) for arm in arms(draw)] for draw in (normal, uniform)]
    show("uncalibrated", uncalibrated)
    for name, how, stated in cases:
        show(name, [[one(arm, index, how, stated) for index, arm in enumerate(arms(d))] for d in (normal, uniform)])


def arms(draw: Draw) -> list[DeltaGeometry]:
    random = np.random.default_rng(3)
    return [drawn_arm(random, draw) for _ in range(ARMS)]


def one(arm: DeltaGeometry, index: int, how: dict[str, object], stated: Uncertainty) -> float:
    return error(arm, fit(measure(arm, np.random.default_rng(index), **how), NOMINAL, stated).geometry)  # type: ignore[arg-type]


def show(name: str, columns: list[list[float]]) -> None:
    cells = "".join(
        f"{1e3 * math.sqrt(np.mean(np.square(values))):>10.3f}{1e3 * max(values):>8.3f}" for values in columns
    )
    print(f"{name:<44}{cells}", flush=True)


def example(path: Path) -> None:
    """Write the poses of a plan as an operator of a drawn arm would have measured them, with whole ticks."""
    random = np.random.default_rng(2026)
    arm = drawn_arm(random, uniform)
    poses = plan(NOMINAL)
    noted = measure(arm, random, np.array([pose.position for pose in poses]), ticks=True)
    encoder = Encoder()
    recording = PoseRecording(path, encoder)
    for pose, angles, position in zip(poses, noted.angles, noted.positions, strict=True):
        first, second, third = encoder.ticks(angles)
        x, y, z = np.round(position, 5)
        recording.append(pose, (float(first), float(second), float(third)), (float(x), float(y), float(z)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--example", type=Path, metavar="FILE", help="write measurements of one drawn arm")
    options = parser.parse_args()
    if options.example is None:
        table()
    else:
        example(options.example)


if __name__ == "__main__":
    main()
