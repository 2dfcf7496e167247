# SPDX-License-Identifier: Apache-2.0
"""Accuracy of the servo calibration: random arms in virtual time, compared with the truth.

python lab/benchmarks/servos.py                       what docs/servo-calibration.md states: 50 arms, two minutes
python lab/benchmarks/servos.py --arms 400            enough to judge the standard errors
"""

import argparse
import dataclasses
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deltacharger_core.machine import SERVO_STIFFNESS, TORQUE_CONSTANT
from deltacharger_kinematics.calibration import servo_fit, servo_procedure
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_sim.parameters import ServoParameters, TargetParameters, WorldParameters

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test"))
from virtual_arm import VirtualArm

SEED = 20  # the procedure was chosen on seed 5
NAMES = ("stiffness", "torque constant", "friction")
TARGETS = (0.05, 0.05, 0.20)


class DrawnArm(NamedTuple):
    """True values of an arm: N·m/rad of each servo, N·m, rad, N·m/A, and true weight over assumed weight."""

    stiffness: Vector
    friction: float
    backlash: float
    constant: float
    weight: float
    seed: int
    share: float


class Found(NamedTuple):
    """Relative errors (3 numbers, 3 servos) and their estimates, also for a known weight (own); the arm's means (3)."""

    errors: np.ndarray
    estimated: np.ndarray
    own: np.ndarray
    own_estimated: np.ndarray
    weight: float
    common: np.ndarray
    common_estimated: np.ndarray
    scatter: float
    seconds: float


def drawn(seed: int, count: int) -> list[DrawnArm]:
    random = np.random.default_rng(seed)
    arms = []
    for number in range(count):
        middle = math.exp(random.uniform(math.log(2.0), math.log(40.0)))
        first, second, third = (float(middle * random.uniform(0.95, 1.05)) for _ in range(3))
        arms.append(
            DrawnArm(
                (first, second, third),
                random.uniform(0.02, 0.15),
                random.uniform(0.0, 0.010),
                TORQUE_CONSTANT * random.uniform(0.8, 1.2),
                random.normal(1.0, servo_fit.WEIGHT_TOLERANCE),
                1000 * seed + number,
                random.uniform(0.1, 0.3),
            )
        )
    return arms


def virtual(arm: DrawnArm) -> VirtualArm:
    """Return a drawn arm in a world without a target."""
    servo = ServoParameters(
        friction=arm.friction, friction_share=arm.share, backlash=arm.backlash, torque_constant=arm.constant
    )
    world = WorldParameters(servo=servo, target=TargetParameters(present=False))
    base = DeltaGeometry()
    true = dataclasses.replace(base, platform_mass=arm.weight * base.platform_mass, rod_mass=arm.weight * base.rod_mass)
    first, second, third = (value / SERVO_STIFFNESS for value in arm.stiffness)
    return VirtualArm(world, arm.seed, true, (first, second, third), TORQUE_CONSTANT)


def measured(arm: DrawnArm) -> Found:
    body = virtual(arm)
    found = servo_procedure.measure_servos(body, servo_fit.ServoTask(seed=arm.seed))
    fit, true = found.fit, (np.array(arm.stiffness), arm.constant, arm.friction)
    values = (fit.stiffness, fit.torque_constant, fit.friction)
    parts = range(3)
    middle = [np.mean(each) for each in true]
    common = [fit.common(part) for part in parts]
    return Found(
        np.array([values[part] / true[part] - 1.0 for part in parts]),
        np.array([fit.error(part) / true[part] for part in parts]),
        np.array([values[part] * arm.weight / true[part] - 1.0 for part in parts]),
        np.array([fit.own_error(part) / true[part] for part in parts]),
        arm.weight - 1.0,
        np.array([common[part][0] / middle[part] - 1.0 for part in parts]),
        np.array([common[part][1] / middle[part] for part in parts]),
        fit.scatter,
        body.now,
    )


def covered(errors: np.ndarray, estimated: np.ndarray) -> str:
    shares = [float(np.mean(np.abs(errors) <= sigmas * estimated)) for sigmas in (1.0, 1.96)]
    return f"{100 * shares[0]:5.0f} {100 * shares[1]:4.0f}"


def table(found: list[Found]) -> None:
    errors, estimated = np.array([each.errors for each in found]), np.array([each.estimated for each in found])
    print(f"{'':<28}{'rms':>7}{'p95':>7}{'worst':>7}{'± est.':>8}   % within 1 σ, 1.96 σ   within target")
    for part, (name, target) in enumerate(zip(NAMES, TARGETS, strict=True)):
        for servo in range(3):
            row(f"{name} {servo + 1}", errors[:, part, servo], estimated[:, part, servo], target)
        row(f"{name}, all", errors[:, part].ravel(), estimated[:, part].ravel(), target)
        row(
            f"{name} of the arm",
            np.array([each.common[part] for each in found]),
            np.array([each.common_estimated[part] for each in found]),
            target,
        )
    own, own_estimated = np.array([each.own for each in found]), np.array([each.own_estimated for each in found])
    weights = np.array([each.weight for each in found])
    row("the weight's error alone", weights, np.full(len(found), servo_fit.WEIGHT_TOLERANCE), 0.05)
    for part, (name, target) in enumerate(zip(NAMES, TARGETS, strict=True)):
        row(f"{name} without it", own[:, part].ravel(), own_estimated[:, part].ravel(), target)
    print(
        f"scatter {np.median([each.scatter for each in found]):.2f} (worst {max(each.scatter for each in found):.2f}), "
        f"time {max(each.seconds for each in found):.0f} s at most"
    )


def row(name: str, errors: np.ndarray, estimated: np.ndarray, target: float) -> None:
    off = np.abs(errors)
    print(
        f"{name:<28}{100 * np.sqrt(np.mean(off**2)):>6.2f}%{100 * np.percentile(off, 95):>6.2f}%"
        f"{100 * off.max():>6.2f}%{100 * np.median(estimated):>7.2f}%{covered(errors, estimated):>16}"
        f"{100 * np.mean(off <= target):>18.1f}%"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=50)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.processes) as pool:
        table(list(pool.map(measured, drawn(options.seed, options.arms), chunksize=4)))


if __name__ == "__main__":
    main()
