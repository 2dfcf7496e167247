# SPDX-License-Identifier: Apache-2.0
"""Benefit of calibrating a rig's pads, on held-out dockings: `python lab/benchmarks/tactile_calibration.py`.

Uses simulated rigs that served neither training nor tuning. Takes a minute on one core;
`--rigs 20 --dockings 10 30 100 300` takes half an hour.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time

import numpy as np

from deltacharger_sim.pads import Rig, measure
from deltacharger_tactile import PoseEstimator, default_model
from deltacharger_tactile.calibration.fit import KnownDockings, Parts, fit, predict
from deltacharger_tactile.calibration.rig import AXES, TactileCalibration
from deltacharger_tactile.dataset import POSITION_CLASSES
from deltacharger_tactile.parameters import TactileParameters

FIRST_RIG = 700
REACH = np.array([0.010, 0.010, math.radians(12.0)])
HELD_OUT = 300
TILT = math.radians(0.06)
MOUNTED = np.array([0.001, 0.0005, math.radians(0.3)])
HALF_LENGTH = 0.035
WORLDS = ("default", "gain spread 25 %", "tilt 0.06°", "pads mounted off", "ridge 8 mm high", "crown radius 30 mm")
PARTS = {
    "nothing": Parts(False, False, False),
    "gains": Parts(True, False, False),
    "load shift": Parts(False, True, False),
    "bias": Parts(False, False, True),
    "gains, bias": Parts(True, False, True),
    "all": Parts(),
}


def family(world: str) -> TactileParameters:
    base = TactileParameters()
    if world == "gain spread 25 %":
        return dataclasses.replace(base, sensor=dataclasses.replace(base.sensor, gain_spread=0.25))
    if world == "ridge 8 mm high":
        return dataclasses.replace(base, contact=dataclasses.replace(base.contact, ridge_height=0.008))
    if world == "crown radius 30 mm":
        return dataclasses.replace(base, contact=dataclasses.replace(base.contact, crown_radius=0.03))
    return base


def device(world: str, seed: int) -> Rig:
    rig = Rig.draw(family(world), seed)
    if world == "tilt 0.06°":
        direction = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi)
        return dataclasses.replace(rig, tilt=TILT * np.array([np.cos(direction), np.sin(direction)]))
    return rig


def dock(world: str, seed: int, pose: np.ndarray, draw: int) -> KnownDockings:
    """Dock once at each pose (N, 3): m, m, rad; 12 frames each, not thresholded."""
    random = np.random.default_rng([draw, seed])
    off = MOUNTED if world == "pads mounted off" else np.zeros(3)
    got = measure(family(world), device(world, seed), pose + off, random, 12, 0.0)
    frames = np.stack([got["left"], got["right"]], axis=1).astype(float)
    frames[got["dead"]] = np.nan
    return KnownDockings(frames, pose, got["contact_pose"] - off, got["tare"][:1].astype(float), seed, 0.0)


def scattered(seed: int, draw: int, count: int) -> np.ndarray:
    return np.random.default_rng([draw, seed, count]).uniform(-REACH, REACH, (count, 3))


def class_poses() -> tuple[np.ndarray, np.ndarray]:
    places = [(x, y, 0.0) for x in POSITION_CLASSES for y in POSITION_CLASSES]
    return np.repeat(places, 6, axis=0), np.array([(0.0, 0.0, math.radians(k)) for k in range(6) for _ in range(25)])


class Score:
    """Errors of one line of the table, per rig."""

    def __init__(self) -> None:
        self.errors: list[np.ndarray] = []
        self.ratios: list[np.ndarray] = []
        self.shares: list[tuple[float, ...]] = []

    def add(
        self, model: PoseEstimator, made: TactileCalibration, held_out: KnownDockings, sets: list[KnownDockings]
    ) -> None:
        pose, spread, usable = predict(model, made, held_out.frames)
        error, spread = (pose - held_out.truth)[usable], spread[usable]
        self.errors.append(error)
        clearance = np.hypot(HALF_LENGTH * spread[:, 2], spread[:, 1])
        for sign in (1.0, -1.0):
            self.ratios.append((HALF_LENGTH * error[:, 2] + sign * error[:, 1]) / clearance)
        self.shares.append((usable.mean(), *accuracies(model, made, *sets)))

    def line(self) -> str:
        rms = np.sqrt(np.mean(np.concatenate(self.errors) ** 2, axis=0)) * [1e3, 1e3, math.degrees(1.0)]
        ratio = np.concatenate(self.ratios)
        share = 100.0 * np.mean(self.shares, axis=0)
        return (
            f"{rms[0]:8.2f} {rms[1]:8.3f} {rms[2]:8.3f}   {np.sqrt(np.mean(ratio**2)):5.2f} {np.abs(ratio).max():5.1f}"
            f"   {share[0]:5.1f}   {share[3]:5.1f} {share[2]:5.1f} {share[1]:5.1f}"
        )


def accuracies(
    model: PoseEstimator, made: TactileCalibration, places: KnownDockings, angles: KnownDockings
) -> list[float]:
    """Return the shares of right classes: horizontal, vertical, angle."""
    shares = []
    for axis, rows in zip(AXES, (places, places, angles), strict=True):
        pads = made.apply(rows.frames[:, 0], rows.frames[:, 1])
        shares_of_classes = getattr(made.correct(model.predict(*pads), model.limits), f"{axis}_probability")
        column = rows.pose[:, AXES.index(axis)]
        right = np.round(np.degrees(column)) if axis == "angle" else np.round(column / 0.005) + 2
        shares.append(float(np.mean(np.argmax(np.nan_to_num(shares_of_classes), axis=1) == right)))
    return shares


def print_world(world: str, model: PoseEstimator, rigs: int, counts: list[int]) -> None:
    print(f"\n{world}, {rigs} rigs: rms error mm, mm, deg in range; clearance rms |z| and max; in range %;")
    print("  accuracy % of angle, vertical, horizontal")
    places, angles = class_poses()
    for count in counts:
        scores = {name: Score() for name in PARTS}
        misfits, took = [], 0.0
        for seed in range(FIRST_RIG, FIRST_RIG + rigs):
            learnt = dock(world, seed, scattered(seed, 1, count), 1)
            held_out = dock(world, seed, scattered(seed, 2, HELD_OUT), 2)
            sets = [dock(world, seed, places, 3), dock(world, seed, angles, 4)]
            for name, parts in PARTS.items():
                started = time.perf_counter()
                found = fit(learnt, model, parts)
                took += (time.perf_counter() - started) * (name == "all")
                scores[name].add(model, found.calibration, held_out, sets)
            misfits.append(found.misfit)
        for name, score in scores.items():
            if name != "nothing" or count == counts[0]:
                print(f"  {count if name != 'nothing' else '–':>4} {name:12s}{score.line()}")
        print(f"       misfit {min(misfits):.3f} … {max(misfits):.3f}, {took / rigs:.2f} s", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=3)
    parser.add_argument("--dockings", type=int, nargs="+", default=[30])
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS), choices=WORLDS)
    options = parser.parse_args()
    model = default_model()
    print(f"simulated data, model {model.name}, {model.about}")
    for world in options.worlds:
        print_world(world, model, options.rigs, options.dockings)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
