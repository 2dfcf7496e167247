# SPDX-License-Identifier: Apache-2.0
"""Trains the packaged pose models, for thresholds of 0.25 N and the paper's 1 N (about three minutes each):
`python -m deltacharger_lab.training.pose`, and again with `--threshold 1`.

The rigs and seeds below are reserved for training; demos, scenes and tests must use rigs below 1 000 000.
"""

import argparse
import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_lab.training.estimator import TrainablePoseEstimator, to_seat
from deltacharger_sim.pads import Rig, measure
from deltacharger_tactile import MODEL_PATHS, dataset, errors, estimator
from deltacharger_tactile.parameters import (
    LARGEST_HOLE,
    PadDockingParameters,
    SensorParameters,
    TactileParameters,
)

TRAINING_RIGS = range(1_000_000, 1_000_120)
CALIBRATION_RIGS = range(1_100_000, 1_100_060)
TRAINING_SEED = 20_260_101
DOCKINGS_PER_RIG = 700

_ANGLE_REACH = math.radians(28.0)
_POSITION_REACH = 0.016
_LEANING = 0.5  # share of the dockings
_LEAN_REACH = np.radians([3.5, 0.35])  # about x and y, at rest: at 0.3° about y one pad is unloaded
_SMALL_LEANS, _SMALL = 0.3, 0.2  # share of these with a small lean; its share of the reach


@dataclass(frozen=True)
class RobotFrames:
    """Robot frames with the pose in contact.

    Attributes:
        frames: (N, 2, 10, 10) float32 N, tared, averaged, not thresholded; NaN where dead.
        pose: (N, 3) m, m, rad: (horizontal, vertical, angle) in contact.
        force: (N,) N, total contact force.
        rig: (N,) seed of the device.
        lean: (N, 2) rad about x and y, of the resting platform, relative to the target.
    """

    frames: NDArray[np.float32]
    pose: arrays.Array
    force: arrays.Array
    rig: NDArray[np.int64]
    lean: arrays.Array

    def pose_by_load(self) -> arrays.Array:
        """Return the poses (N, 3) with the horizontal offset that would give the same loads without a lean.

        Only the lean's tilt along the ridges counts; roll turns them against x. The vertical offset changes with the
        horizontal one, so the offset across the bars stays true.
        """
        seat = to_seat(self.pose)
        along = self.lean[:, 1] + self.lean[:, 0] * np.tan(self.pose[:, 2])
        seat[:, 0] += along / PadDockingParameters().tilt_per_x
        return estimator.to_pose(seat)


def varied(rig: int) -> TactileParameters:
    """Parameters of one training rig: the defaults, with random differences between real chargers.

    Forces, tilts, dead taxels and the elastomer's stiffness vary more than between rigs of the defaults, so that the
    model does not rely on them.
    """
    random = np.random.default_rng([0x7EA, rig])
    base = TactileParameters()
    docking: PadDockingParameters = dataclasses.replace(
        base.docking,
        tilt_per_x=base.docking.tilt_per_x * random.uniform(0.85, 1.15),
        tilt_per_y=base.docking.tilt_per_y * random.uniform(0.7, 1.3),
        tilt_spread=base.docking.tilt_spread * 1.3,
        tilt_bias=base.docking.tilt_bias * 1.5,
        magnet_spread=0.08,
        current_low=0.35,
        current_high=0.55,
    )
    sensor: SensorParameters = dataclasses.replace(base.sensor, dead_taxels=int(random.choice([0, 1, 1, 1, 2, 3])))
    contact = dataclasses.replace(
        base.contact,
        stiffness=base.contact.stiffness * random.uniform(0.7, 1.4),
        hardening=base.contact.hardening * random.uniform(0.6, 1.6),
        spread_depth=base.contact.spread_depth * random.uniform(0.7, 1.4),
    )
    return dataclasses.replace(base, docking=docking, sensor=sensor, contact=contact)


def draw_poses(count: int, random: np.random.Generator) -> arrays.Array:
    """(count, 3) commanded poses: half over the full reach beyond the range, half at usual poses of dockings."""
    reach = np.array([_POSITION_REACH, _POSITION_REACH, _ANGLE_REACH])
    wide = random.uniform(-reach, reach, (count, 3))
    near = np.column_stack(
        [
            random.normal(0.0, 0.004, (count, 2)),
            random.uniform(-math.radians(16.0), math.radians(16.0), count),
        ]
    )
    return np.where(random.random((count, 1)) < 0.5, wide, near)


def draw_leans(count: int, random: np.random.Generator) -> arrays.Array:
    """(count, 2) leans about x and y at rest, rad: half are 0, some small, others up to an unloaded pad."""
    leans = random.uniform(-_LEAN_REACH, _LEAN_REACH, (count, 2))
    leans[random.random(count) < _SMALL_LEANS] *= _SMALL
    return np.asarray(leans * (random.random((count, 1)) < _LEANING))


def record(
    rigs: Sequence[int], count: int, seed: int, vary: bool = True, hole: float = 0.0, leaning: bool = True
) -> RobotFrames:
    """Dock `count` times on each rig.

    Args:
        rigs: seeds of the devices.
        count: dockings per rig.
        seed: seed of the dockings.
        vary: draw each rig's family by `varied` instead of using the defaults.
        hole: diameter of the hole in each of the target's ridges, m.
        leaning: whether half of the targets lean.
    """
    frames, poses, forces, leans = [], [], [], []
    for rig_seed in rigs:
        parameters = varied(rig_seed) if vary else TactileParameters()
        parameters = dataclasses.replace(parameters, contact=dataclasses.replace(parameters.contact, hole=hole))
        random = np.random.default_rng([0x7EC, seed, rig_seed])
        averaged = int(random.choice([1, 4, 12, 12])) if vary else 12
        rig, lean = Rig.draw(parameters, rig_seed), np.zeros((count, 2))
        if leaning:
            lean = draw_leans(count, np.random.default_rng([0x1EA, seed, rig_seed]))
        rows = measure(parameters, rig, draw_poses(count, random), random, averaged, 0.0, lean=lean)
        seen = np.stack([rows["left"], rows["right"]], axis=1)
        if vary:
            seen = _another_sheet(seen, np.random.default_rng([0x5EE, seed, rig_seed]))
        seen[rows["dead"]] = np.nan
        frames.append(seen)
        poses.append(rows["contact_pose"])
        forces.append(rows["force"])
        leans.append(lean)
    return RobotFrames(
        np.concatenate(frames),
        np.concatenate(poses),
        np.concatenate(forces),
        np.repeat(np.array(rigs), count),
        np.concatenate(leans),
    )


def _another_sheet(frames: NDArray[np.float32], random: np.random.Generator) -> NDArray[np.float32]:
    """Return frames (N, 2, 10, 10) N as read by a sheet of another make, so that the model relies on none.

    Half of the sheets have a threshold of up to about the paper's 1 N, which varies between taxels. Taxels at the rim
    may read less, characteristics bend, and bars beside the pads may carry part of the force.
    """
    shape = frames.shape[1:]
    rim = np.ones(shape, dtype=bool)
    rim[:, 1:-1, 1:-1] = False
    read = frames * random.uniform(0.75, 1.05) * (1.0 - random.uniform(0.0, 0.2) * rim)
    read *= 1.0 + random.uniform(-0.2, 0.2, (machine.PADS, 1, 1)) * (1.0 - np.minimum(read / 9.0, 1.0))
    least = random.uniform(0.0, 1.1) * (random.random() < 0.5)
    band = least * (1.0 + 0.15 * np.clip(random.standard_normal(shape), -2.0, 2.0))
    return np.asarray(np.where(read >= band, read, 0.0), dtype=np.float32)


def train(
    rigs: Sequence[int] = TRAINING_RIGS,
    held_out: Sequence[int] = CALIBRATION_RIGS,
    count: int = DOCKINGS_PER_RIG,
    seed: int = TRAINING_SEED,
    epochs: int = 24,
    threshold: float = estimator.THRESHOLD,
    hole: float = 0.0,
) -> TrainablePoseEstimator:
    """Train an estimator and scale its standard deviations on rigs unseen in training.

    Args:
        rigs: seeds of the devices to learn from.
        held_out: seeds of the devices that scale the standard deviations.
        count: dockings per rig.
        seed: seed of the dockings and of the initial weights.
        epochs: passes over the data.
        threshold: lower readings count as 0, N.
        hole: diameter of the hole in each of the target's ridges, m.
    """
    learn, check = record(rigs, count, seed, hole=hole), record(held_out, count, seed, hole=hole)
    # A hole shows the ridge's position at any load: then the horizontal offset itself can be estimated.
    poses = [part.pose if hole else part.pose_by_load() for part in (learn, check)]
    name = "pose-2" if threshold == estimator.THRESHOLD else f"pose-2@{threshold:g}N"
    name += f"-hole-{1e3 * hole:g}mm" if hole else ""
    model = TrainablePoseEstimator(name, threshold, epochs=epochs)
    model.fit(learn.frames, poses[0], (check.frames, poses[1]), seed)
    model.about = {
        "parameters": TactileParameters().digest(),
        "training_rigs": len(rigs),
        "held_out_rigs": len(held_out),
        "dockings_per_rig": count,
        "seed": seed,
    }
    return model


def fit_dataset(
    data: dataset.Dataset, seed: int = 0, progress: Callable[[float, str], None] = lambda share, text: None
) -> TrainablePoseEstimator:
    """Train an estimator on a data set of several rigs; every third rig scales the standard deviations.

    Args:
        data: signed poses that exceed the intended range of estimates, cut at 0.25 N or less.
        seed: of the initial weights.
        progress: called with the share done and the current step.

    Raises:
        DatasetError: fewer than three rigs, or the threshold cut readings that the model needs.
        ModelError: too few dockings.
    """
    rigs = np.unique(data.rig)
    if len(rigs) < 3:
        raise errors.DatasetError(
            "pose",
            f"{len(rigs)} rigs are too few: at least 3 are needed, a third of them to scale the standard deviations; "
            "for one charger keep the packaged model and call `deltacharger calibrate tactile`",
        )
    model = TrainablePoseEstimator("pose-own")
    if not data.threshold <= model.threshold:
        raise errors.DatasetError(
            "pose", f"readings below {data.threshold:g} N were cut off; give --threshold 0.25 or less"
        )
    frames, pose = np.stack(data.robot_frames(), axis=1), data.poses()
    judges = np.isin(data.rig, rigs[::3])
    model.fit(frames[~judges], pose[~judges], (frames[judges], pose[judges]), seed, progress)
    model.about = {"data": data.meta, "training_rigs": len(rigs) - len(rigs[::3]), "seed": seed}
    return model


def main(arguments: Sequence[str] | None = None) -> int:
    """Train and write a packaged model."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--threshold", type=float, choices=MODEL_PATHS, default=estimator.THRESHOLD, help="N (0.25)")
    parser.add_argument("--hole-mm", type=float, default=0.0, help="hole in each ridge; needs --output (none)")
    parser.add_argument("--output", type=Path, help="another file than the package's")
    options = parser.parse_args(arguments)
    output = options.output or MODEL_PATHS[options.threshold]
    if not output.parent.is_dir():
        parser.error(f"--output {output}: the folder {output.parent} does not exist; make it")
    if not 0.0 <= 1e-3 * options.hole_mm <= LARGEST_HOLE:
        parser.error(f"--hole-mm: {options.hole_mm:g} is outside 0 to {1e3 * LARGEST_HOLE:g}")
    if options.hole_mm and not options.output:
        parser.error("--hole-mm: the packaged models know no holes; give --output FILE")
    model = train(threshold=options.threshold, hole=1e-3 * options.hole_mm)
    try:
        model.save(output)
    except OSError as error:
        parser.error(f"--output: {error}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
