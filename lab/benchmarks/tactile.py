# SPDX-License-Identifier: Apache-2.0
"""Accuracy and run time of the packaged tactile model on untrained rigs: `python lab/benchmarks/tactile.py`.

Takes about 20 seconds on one core with the default of 20 000 dockings per table.
"""

import argparse
import dataclasses
import time
from typing import Any

import numpy as np

from deltacharger_sim.pads import Rig, generate_continuous, measure
from deltacharger_tactile import Estimate, PoseEstimator, default_model
from deltacharger_tactile.contact import ContactModel
from deltacharger_tactile.parameters import PadDockingParameters, SensorParameters, TactileParameters

HALF_GAP, HALF_LENGTH, CLEARANCE_MIN = 3.7, 35.0, 0.3
FIRST_RIG = 2000
DOCKINGS_PER_RIG = 500


def clearance(angle: Any, vertical: Any) -> Any:
    """Clearance in mm of angle (rad) and vertical error (m), as docking judges it."""
    return HALF_GAP * (1 + np.cos(angle)) - HALF_LENGTH * np.abs(np.sin(angle)) - 1e3 * np.abs(vertical)


def acts(estimate: Estimate) -> Any:
    """Whether docking would energise on this estimate alone."""
    sigma = np.hypot(HALF_LENGTH * estimate.angle_stddev, 1e3 * estimate.vertical_stddev)
    return estimate.sure & (clearance(estimate.angle, estimate.vertical) - 3 * sigma >= CLEARANCE_MIN)


def dockings(
    count: int, offset: float, low: float, high: float, seed: int, parameters: TactileParameters | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return left, right, commanded and contact poses: |x|, |y| ≤ offset (m), low ≤ |angle| ≤ high (deg)."""
    family = parameters or TactileParameters()
    parts = []
    for index in range(max(1, count // DOCKINGS_PER_RIG)):
        random = np.random.default_rng([seed, index])
        rows = min(count, DOCKINGS_PER_RIG)
        angle = np.radians(random.uniform(low, high, rows)) * random.choice([-1.0, 1.0], rows)
        pose = np.column_stack([random.uniform(-offset, offset, (rows, 2)), angle])
        rig = Rig.draw(family, FIRST_RIG + index)
        got = measure(family, rig, pose, random, 12, 0.0)
        frames = np.stack([got["left"], got["right"]], axis=1)
        frames[got["dead"]] = np.nan
        parts.append((frames[:, 0], frames[:, 1], pose, got["contact_pose"]))
    left, right, pose, actual = (np.concatenate([part[i] for part in parts]) for i in range(4))
    return left, right, pose, actual


def print_accuracy(model: PoseEstimator, count: int) -> None:
    left, right, _, actual = dockings(count, 0.012, 0.0, 20.0, 11)
    estimate = model.predict(left, right)
    used = estimate.in_range
    print(f"\n{len(left)} dockings, |x|, |y| ≤ 12 mm, |angle| ≤ 20°:", end=" ")
    print(f"in range {used.mean():.3f}, sure {estimate.sure.mean():.3f}")
    print("in range      rms    median σ   rms z   max |z|  kurtosis  P(|z|>3)")
    for name, axis, scale, unit in (
        ("angle", 2, 180 / np.pi, "°"),
        ("vertical", 1, 1e3, "mm"),
        ("horizontal", 0, 1e3, "mm"),
    ):
        error = (getattr(estimate, name) - actual[:, axis])[used]
        sigma = getattr(estimate, f"{name}_stddev")[used]
        z = error / sigma
        print(
            f"{name:10s} {scale * np.sqrt(np.mean(error**2)):6.3f} {unit:2s} {scale * np.median(sigma):8.3f} "
            f"{z.std():8.2f} {np.abs(z).max():8.1f} {np.mean(z**4) / np.var(z) ** 2:9.2f} {np.mean(np.abs(z) > 3):9.4f}"
        )
    print("\n35 mm·angle ± vertical against the pose in contact, in range, by true |angle|")
    print("  band        n   sure   rms mm  median σ  max |e|  max |z|  P(|z|>3)")
    for low, high in ((0, 4), (4, 7), (7, 10), (10, 12), (12, 15), (15, 20)):
        chosen = used & (np.abs(np.degrees(actual[:, 2])) >= low) & (np.abs(np.degrees(actual[:, 2])) < high)
        angle = HALF_LENGTH * (estimate.angle - actual[:, 2])[chosen]
        vertical = 1e3 * (estimate.vertical - actual[:, 1])[chosen]
        error = np.concatenate([angle + vertical, angle - vertical])
        sigma = np.tile(np.hypot(HALF_LENGTH * estimate.angle_stddev, 1e3 * estimate.vertical_stddev)[chosen], 2)
        z = np.abs(error / sigma)
        print(
            f"{low:3d}–{high:2d}° {chosen.sum():7d} {estimate.sure[chosen].mean():6.3f} {error.std():8.3f} "
            f"{np.median(sigma):8.3f} {np.abs(error).max():8.2f} {z.max():8.1f} {np.mean(z > 3):9.4f}"
        )


def print_acts(model: PoseEstimator, count: int) -> None:
    print("\nact rate (sure and c − 3σ ≥ 0.3 mm) by commanded |angle|, both signs; unsafe = true clearance < 0")
    for offset in (0.0005, 0.010):
        print(f" |x|, |y| ≤ {1e3 * offset:g} mm: angle, in range, sure, acts, unsafe")
        for degrees in (0, 3, 5, 7, 8, 9, 10, 11, 12, 14, 17, 20):
            left, right, _, actual = dockings(count // 8, offset, degrees, degrees, 100 + degrees)
            estimate = model.predict(left, right)
            act = acts(estimate)
            unsafe = (act & (clearance(actual[:, 2], actual[:, 1]) < 0)).sum()
            print(
                f"  {degrees:3d}° {estimate.in_range.mean():7.3f} {estimate.sure.mean():7.3f} "
                f"{act.mean():7.3f} {unsafe:4d}"
            )
    left, right, _, actual = dockings(count, 0.010, 12.0, 20.0, 77)
    act = acts(model.predict(left, right))
    beyond = np.abs(actual[:, 2]) >= np.radians(12.0)
    print(f" {len(left)} dockings commanded at 12–20°, offsets ≤ 10 mm: {act.sum()} acts,", end=" ")
    print(f"{(act & beyond).sum()} of them at a true angle ≥ 12°,", end=" ")
    print(f"{(act & (clearance(actual[:, 2], actual[:, 1]) < 0)).sum()} unsafe")


def print_shifts(model: PoseEstimator, count: int) -> None:
    base = TactileParameters()
    docking: PadDockingParameters = base.docking
    sensor: SensorParameters = base.sensor
    families = {
        "as trained for": base,
        "force −20 %": dataclasses.replace(
            base, docking=dataclasses.replace(docking, magnet_force=48.0, push_per_ampere=30.7)
        ),
        "tilt bias ×10": dataclasses.replace(
            base, docking=dataclasses.replace(docking, tilt_bias=10 * docking.tilt_bias)
        ),
        "gain spread 25 %": dataclasses.replace(base, sensor=dataclasses.replace(sensor, gain_spread=0.25)),
        "offset ×3": dataclasses.replace(base, sensor=dataclasses.replace(sensor, docking_offset=0.15)),
        "six dead taxels": dataclasses.replace(base, sensor=dataclasses.replace(sensor, dead_taxels=6)),
        "ridge 8 mm high": dataclasses.replace(base, contact=dataclasses.replace(base.contact, ridge_height=0.008)),
        "crown radius 30 mm": dataclasses.replace(base, contact=dataclasses.replace(base.contact, crown_radius=0.03)),
    }
    print("\nshift, |x|, |y| ≤ 10 mm, |angle| ≤ 16°: in range, sure, rms z of angle, vertical, max |z|, acts, unsafe")
    for name, family in families.items():
        left, right, _, actual = dockings(count // 4, 0.010, 0.0, 16.0, 55, family)
        print_shift(name, model.predict(left, right), actual)
    left, right, _, actual = dockings(count // 4, 0.010, 0.0, 16.0, 55)
    spoils = (
        ("two rows read 0", slice(4, 6), 0.0),
        ("two rows read 2 N", slice(4, 6), 2.0),
        ("one row reads 1.5 N", slice(6, 7), 1.5),
    )
    for name, rows, value in spoils:
        spoiled = left.copy()
        spoiled[:, rows] = value
        print_shift(name, model.predict(spoiled, right), actual)
    print_shift("left pad gain × 0.7", model.predict(0.7 * left, right), actual)
    print_shift("left pad reads 0", model.predict(np.zeros_like(left), right), actual)


def print_shift(name: str, estimate: Estimate, actual: np.ndarray) -> None:
    used = estimate.sure
    act = acts(estimate)
    unsafe = (act & (clearance(actual[:, 2], actual[:, 1]) < 0)).sum()
    line = f" {name:22s} {estimate.in_range.mean():6.3f} {used.mean():6.3f}"
    if used.any():
        angle = ((estimate.angle - actual[:, 2]) / estimate.angle_stddev)[used]
        vertical = ((estimate.vertical - actual[:, 1]) / estimate.vertical_stddev)[used]
        line += f" {np.sqrt(np.mean(angle**2)):6.2f} {np.sqrt(np.mean(vertical**2)):6.2f}"
        line += f" {max(np.abs(angle).max(), np.abs(vertical).max()):6.1f}"
    print(f"{line} {act.mean():7.3f} {unsafe:4d}")


def print_cost(model: PoseEstimator) -> None:
    left, right, _, actual = dockings(500, 0.005, 0.0, 10.0, 3)
    times = []
    for a, b in zip(left, right, strict=True):
        start = time.perf_counter()
        model.predict(a, b)
        times.append(1e3 * (time.perf_counter() - start))
    print(f"\nprediction {np.median(times):.2f} ms median, {np.quantile(times, 0.99):.2f} ms p99")
    contact = ContactModel()
    start = time.perf_counter()
    contact.solve(actual, 70.0)
    print(f"contact {1e3 * (time.perf_counter() - start) / len(actual):.3f} ms per pair of frames in a batch")
    start = time.perf_counter()
    generate_continuous(rigs=(1,), count=1000, seed=1)
    print(f"data set {time.perf_counter() - start:.3f} ms per row of one frame (rig and tare included)")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dockings", type=int, default=20000)
    count = parser.parse_args().dockings
    model = default_model()
    print(f"model {model.name}, {model.about}")
    print_accuracy(model, count)
    print_acts(model, count)
    print_shifts(model, count)
    print_cost(model)


if __name__ == "__main__":
    main()
