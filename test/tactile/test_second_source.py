# SPDX-License-Identifier: Apache-2.0
"""Sheets, source and data sets of the second contact physics: memory, dead band, drift, seeds, extremes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.world import World
from deltacharger_tactile.errors import DatasetError
from deltacharger_tactile.generator import generate_continuous
from deltacharger_tactile.pad_source import Lean
from deltacharger_tactile.parameters import TactileParameters
from deltacharger_tactile.second.generator import dock_anew
from deltacharger_tactile.second.parameters import SecondParameters, SheetParameters
from deltacharger_tactile.second.sheet import Sheets, SheetSensor
from deltacharger_tactile.second.source import SecondSource

from ..marks import rest

PLAIN = SheetParameters(
    hysteresis=0.0, sheet_spread=0.0, creep=0.0, linearity=0.0, repeatability=0.0, gain_spread=0.0, edge_loss=0.0,
    neighbour=0.0, matrix=0.0, dead_band=0.0, dead_band_spread=0.0, fixed_offset=0.0, gain_drift=0.0, offset_drift=0.0,
    noise=0.0, noise_gain=0.0, bits=16, dead_taxels=0,
)  # fmt: skip


def sheet(seed: int = 3, **values: float) -> SheetSensor:
    parameters = dataclasses.replace(PLAIN, **values)
    random = np.random.default_rng(seed)
    return SheetSensor(parameters, Sheets.draw(parameters, random), random)


def even(force: float) -> np.ndarray:
    return np.full((1, 2, 10, 10), force)


def reading(sensor: SheetSensor, force: float | None, pad: int = 0) -> float:
    raw = sensor.read(None if force is None else even(force))
    return float(raw[0, 0, pad, 5, 5]) - PLAIN.pedestal


def test_a_plain_sheet_reads_the_force_within_one_code() -> None:
    force = np.random.default_rng(0).uniform(0.0, 9.0, (1, 2, 10, 10))
    assert np.abs(sheet().read(force)[0] - force - PLAIN.pedestal).max() <= 0.5 * 9.5 / (2**16 - 1) + 1e-12


def test_the_loop_closes_and_loses_energy() -> None:
    sensor = sheet(hysteresis=0.045)
    way = np.concatenate([np.linspace(2, 8, 61), np.linspace(8, 2, 61)[1:]])
    rounds = [[reading(sensor, force) for force in way] for _ in range(3)]
    second, third = rounds[1:]
    assert np.allclose(second, third, atol=1e-9), "a loop between the same ends"
    assert third[0] == pytest.approx(third[-1], abs=1e-3)
    loading, unloading = np.array(third[:61]), np.array(third[60:])[::-1]
    assert np.all(unloading >= loading - 1e-9), "unloading reads more"
    assert 0.3 * 0.045 * 9.0 < (unloading - loading).max() <= 0.045 * 9.0 + 1e-3
    assert np.sum(unloading - loading) * 0.1 > 0.2, "N², the loop's area"


def test_creep_grows_per_decade_and_shifts_the_zero_until_it_recovers() -> None:
    sensor, course, after = sheet(creep=0.05, residual=0.3), [], []
    for step in (0.0, 0.1, 0.9, 9.0, 90.0):
        sensor.pass_time(step, even(5.0))
        course.append(reading(sensor, 5.0))
    assert np.all(np.diff(course) > 0.0)
    assert 0.8 * 0.05 < (course[3] - course[2]) / 5.0 < 1.2 * 0.05
    for step in (0.0, 1.0, 10.0, 100.0, 1e4):
        sensor.pass_time(step)
        after.append(reading(sensor, None))
    assert after[0] > 0.1, "visible in a tare"
    assert np.all(np.diff(after) < 0.0)
    assert after[-1] == pytest.approx(0.0, abs=1e-3)


def test_the_step_size_does_not_matter_under_one_force() -> None:
    whole, parts = sheet(creep=0.05), sheet(creep=0.05)
    burst = sheet(creep=0.05).read(even(4.0), 1.0, 24, 0.5)
    for frame in burst:
        assert np.allclose(parts.read(even(4.0))[0], frame, atol=1e-3)
        parts.pass_time(0.5, even(4.0))
    whole.pass_time(12.0, even(4.0))
    assert np.allclose(whole.read(even(4.0)), parts.read(even(4.0)))


def test_no_reading_lies_between_zero_and_the_dead_band() -> None:
    parameters = dataclasses.replace(PLAIN, dead_band=1.0, dead_band_spread=0.1, noise=0.02, noise_gain=0.015)
    random = np.random.default_rng(1)
    sensor = SheetSensor(parameters, Sheets.draw(parameters, random), random)
    tare = sensor.read(None, 1.0, 60, 1 / 120).mean(axis=0)
    ramp = np.linspace(0.0, 3.0, 200).reshape(1, 2, 10, 10)
    tared = np.concatenate([(sensor.read(ramp * share) - tare).ravel() for share in (0.2, 0.6, 1.0)])
    assert not np.any((tared > 0.15) & (tared < 0.7))
    assert np.mean(tared > 0.7) > 0.1
    assert np.mean(np.abs(tared) <= 0.15) > 0.3


def test_drift_is_zero_at_the_tare_and_grows() -> None:
    sensor = sheet(offset_drift=0.06, gain_drift=0.03)
    tare, apart = sensor.read(None)[0], []
    for step in (0.0, 10.0, 100.0, 1000.0, 10000.0):
        sensor.pass_time(step)
        apart.append(float(np.abs(sensor.read(None)[0] - tare).mean()))
    assert apart[0] == 0.0
    assert np.all(np.diff(apart) > 0.0)
    assert 0.02 < apart[-1] < 0.1


def test_neighbours_rows_columns_and_the_rim() -> None:
    point = np.zeros((1, 2, 10, 10))
    point[0, 0, 5, 5] = 4.0
    readings = sheet(neighbour=0.04, matrix=0.01).read(point)[0, 0, 0] - PLAIN.pedestal
    assert readings[5, 4] == pytest.approx(0.04 * 4.0, rel=0.2)
    assert readings[[5, 0], [0, 5]].min() > 0.0 == pytest.approx(readings[1, 1], abs=1e-3)
    rim = sheet(edge_loss=0.2).read(even(5.0))[0, 0, 0] - PLAIN.pedestal
    assert [rim[0, 3], rim[4, 4]] == pytest.approx([4.0, 5.0], abs=1e-3)


def run(rig: int, seed: int) -> list[np.ndarray]:
    source = SecondSource(rig_seed=rig, seed=seed)
    free = source.frames(0.5, None, 0.0, 5, 1 / 120)
    jitter = source.begin_docking()
    return [free, source.frames(1.0, jitter, 60.0, 5, 1 / 120), source.frames(9.0, None, 0.0, 2, 1 / 120)]


def test_seeds_determine_the_readings() -> None:
    runs = [run(*seeds) for seeds in ((1, 2), (1, 2), (1, 3), (2, 2))]
    first, again, other, device = (np.concatenate(each) for each in runs)
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(first, other, equal_nan=True)
    assert not np.array_equal(np.isnan(first), np.isnan(device))
    free, pressed, after = runs[0]
    assert np.isnan(free).sum() == 5
    assert np.nansum(pressed[0] - free[0]) > 5.0
    assert 0.0 < np.nanmax(after.mean(axis=0) - free.mean(axis=0)) < 0.7


def test_skipped_frames_change_nothing_at_rest() -> None:
    quiet = dataclasses.replace(SecondParameters(), sheet=SheetParameters(noise=0.0, noise_gain=0.0))
    read = []
    for extra in (0, 40):
        source = SecondSource(quiet, 5, 6)
        source.sample(0.0, None, 0.0)
        pose = source.begin_docking()
        for index in range(extra + 1):
            source.sample(1.0 + index / 10.0, pose, 70.0)
        read.append(np.array(source.sample(6.0, pose, 70.0)))
    assert np.nanmax(np.abs(read[0] - read[1])) <= 9.5 / 1023 + 1e-9, "one code at most"


@pytest.mark.parametrize("force", [0.0, rest(0.1), 500.0])
def test_a_source_stays_finite_and_bounded(force: float) -> None:
    source, time = SecondSource(rig_seed=7), 0.0
    for pose in ((0.03, 0.03, 0.52), (-0.03, 0.0, -0.52), (0.0, 0.0, 0.0), (0.0, -0.03, 0.52)):
        for step, yaw in ((0.0, -0.1), (1e-3, 0.0), (1e4, 0.1)):
            time += step
            frames = source.frames(time, pose, force, 2, 0.0, Lean(free=(0.03, yaw)))
            dead = np.isnan(frames)
            assert np.array_equal(dead[0], source.rig.sheets.dead)
            assert 0.0 <= frames[~dead].min() <= frames[~dead].max() <= 9.5 + 1e-9
        source.sample(time, None, 0.0)


def test_a_world_accepts_it_and_jitter_has_the_arms_size() -> None:
    source = SecondSource(rig_seed=4)
    drawn = np.array([source.begin_docking() for _ in range(400)])
    assert np.allclose(drawn.std(axis=0), [1e-3, 1e-3, np.radians(0.19)], rtol=0.15)
    left, right = World(WorldParameters(), source).taxels()
    assert left.shape == right.shape == (10, 10)


@pytest.mark.parametrize("count", [5, rest(30)])
def test_a_data_set_has_the_first_poses_and_new_readings(count: int) -> None:
    known = generate_continuous(rigs=(3, 4), count=count, seed=1, threshold=0.0)
    fresh, again, other = (dock_anew(known, seed, 2) for seed in (5, 5, 6))
    for name in ("angle", "vertical", "horizontal", "rig", "attempt", "subset"):
        assert np.array_equal(getattr(fresh, name), getattr(known, name))
    assert np.array_equal(fresh.left, again.left)
    assert not np.array_equal(fresh.left, other.left)
    assert 3e-4 < (fresh.contact_pose[:, 0] - fresh.horizontal).std() < 2e-3
    assert np.array_equal(fresh.dead[0], fresh.dead[1])
    assert fresh.simulated
    assert fresh.meta["digest"] == SecondParameters().digest() != TactileParameters().digest()


def test_requests_without_frames_or_with_several_rows_are_refused() -> None:
    for problem, rows, frames in (("0 frames", 1, 0), ("row a docking", 2, 2)):
        with pytest.raises(DatasetError, match=problem):
            dock_anew(generate_continuous(rigs=(3,), count=2, rows=rows), frames=frames)
