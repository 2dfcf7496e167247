# SPDX-License-Identifier: Apache-2.0
"""Laws of the second contact physics: forces, symmetry, convergence, extremes; its sheets, source and data sets."""

import dataclasses
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

from deltacharger_core.parameters import ParameterError, from_mapping
from deltacharger_lab.second import device, equilibrium, generator
from deltacharger_lab.second.parameters import (
    BarParameters,
    FoundationParameters,
    PlatformRestParameters,
    SecondParameters,
    SheetParameters,
)
from deltacharger_sim.pads import Lean, generate_continuous
from deltacharger_tactile.parameters import TactileParameters
from test.marks import rest
from test.sim.test_tilt import yawed_target_comes_nearer_on_that_side_and_loads_that_pad
from test.tactile.test_contact import (
    batch_equals_its_single_contacts,
    poses,
    seeds_determine_readings_and_force_is_read_only_in_contact,
)

RIDGES = equilibrium.Ridges(np.array([3e-5, -2e-5]), np.array([-1e-5, 4e-5]))

MODEL = equilibrium.Equilibrium()


def test_force_and_moments_balance_and_nothing_pulls() -> None:
    many, force = poses(60), np.linspace(2.0, 150.0, 60)
    line, lean = 0.5 * many[:, :2], np.random.default_rng(1).normal(0.0, 1e-3, (60, 2))
    found = MODEL.solve(many, force, line, lean, RIDGES)
    assert np.isfinite(found.state).all()
    assert np.allclose(found.taxels.sum(axis=(1, 2, 3)) + found.bars.sum(axis=1), force, rtol=1e-6)
    platform = (found.state[:, 1:] - lean) / PlatformRestParameters().compliance
    off = found.moments + platform - force[:, None] * line[:, ::-1]
    assert np.abs(off).max() < 1e-6 * 0.048 * force.min()
    assert found.taxels.min() >= 0.0
    assert found.bars.min() >= 0.0


def test_mirroring_the_pose_mirrors_pads_and_bars() -> None:
    many, lean = poses(20, 1), np.array([7e-4, -1.1e-3])
    line = 0.4 * many[:, :2]
    straight = MODEL.solve(many, 60.0, line, lean)
    over_y = MODEL.solve(many * [1, -1, -1], 60.0, line * [1, -1], lean * [-1, 1])
    assert np.allclose(over_y.taxels, straight.taxels[:, :, ::-1, :], atol=1e-3)
    assert np.allclose(over_y.bars, straight.bars[:, ::-1], atol=1e-3)
    over_x = MODEL.solve(many * [-1, 1, -1], 60.0, line * [-1, 1], lean * [1, -1])
    assert np.allclose(over_x.taxels, straight.taxels[:, ::-1, :, ::-1], atol=1e-3)
    assert np.allclose(over_x.bars, straight.bars, atol=1e-3)


def test_the_lower_layer_spreads_without_loss_and_solves_its_equation() -> None:
    parameters = FoundationParameters()
    pads = equilibrium.PadFoundation(SecondParameters().dimensions, parameters)
    pressure = np.random.default_rng(0).uniform(0.0, 1e5, (3, len(pads.x)))
    assert np.allclose(pads.taxels(pressure).sum(axis=(1, 2, 3)), pressure.sum(axis=1) * pads.area)
    # k (w − ℓ² ∇²w) = p inside the grid, by finite differences
    w = pads.deflect(pressure).reshape(3, 2, 60, 30)
    dy, dx = (SecondParameters().dimensions.pad_side / n for n in w.shape[2:])
    inner = (..., slice(1, -1), slice(1, -1))
    bend = (w[..., 2:, 1:-1] + w[..., :-2, 1:-1] - 2 * w[inner]) / dy**2
    bend += (w[..., 1:-1, 2:] + w[..., 1:-1, :-2] - 2 * w[inner]) / dx**2
    back = parameters.base_stiffness * (w[inner] - parameters.shear_length**2 * bend)
    assert np.allclose(back, pressure.reshape(w.shape)[inner], rtol=1e-6)


def test_pressure_and_slope_are_derivatives_of_the_energy() -> None:
    pads, bars = (
        equilibrium.PadFoundation(SecondParameters().dimensions, FoundationParameters()),
        equilibrium.SpringBars(BarParameters()),
    )
    depth = np.linspace(-1e-3, 3e-3, 4001)
    smooth = np.abs(depth) > 5e-6  # the curve starts with a kink
    for law in (pads, bars):
        force, slope, energy = law.press(depth)
        assert np.allclose(np.gradient(energy, depth)[2:-2], force[2:-2], rtol=1e-3, atol=2e-3 * force.max())
        assert np.all(np.diff(force) >= 0.0)
        assert not force[depth < 0.0].any()
        if law is pads:
            assert np.allclose(np.gradient(force, depth)[smooth], slope[smooth], rtol=1e-2)


@pytest.mark.parametrize(
    "values",
    [
        {},
        rest({"foundation": {"modulus": 5e7, "base_stiffness": 1e11}}),
        {"bars": {"rate": 1e6, "stop_stiffness": 1e9, "seat": 1e-6, "preload": 20.0, "travel": 1e-4, "proud": 1e-3}},
    ],
)
def test_extreme_poses_forces_and_families_come_to_rest(values: dict[str, dict[str, float]]) -> None:
    random = np.random.default_rng(7)
    corners = list(product((-0.03, 0.0, 0.03), (-0.03, 0.0, 0.012), (-0.5236, 0.0, 0.5236)))
    many = np.array([*random.uniform([-0.03, -0.03, -0.53], [0.03, 0.03, 0.53], (48, 3)), *corners])
    force = np.append(10.0 ** random.uniform(-1.0, 2.7, 48), np.resize([0.1, 5.0, 500.0], 27))
    lean = (0.01, -0.01) if values else (0.03, -0.03)
    found = equilibrium.Equilibrium(from_mapping(values, SecondParameters)).solve(many, force, many[:, :2], lean)
    touching = np.isfinite(found.state[:, 0])
    borne = found.taxels.sum(axis=(1, 2, 3)) + found.bars.sum(axis=1)
    assert touching[:48].mean() > 0.8
    assert np.isfinite(found.taxels).all()
    assert not borne[~touching].any()
    assert np.allclose(borne[touching], force[touching], rtol=1e-6)


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"foundation": {"base_stiffness": 3e8}}, "foundation.base_stiffness"),
        ({"sheet": {"edge_loss": 0.8, "neighbour": 0.1}}, "sheet.neighbour"),
    ],
)
def test_contradictions_are_refused_by_key(values: dict[str, dict[str, float]], key: str) -> None:
    with pytest.raises(ParameterError) as caught:
        from_mapping(values, SecondParameters)
    assert caught.value.key == key


PLAIN = SheetParameters(
    hysteresis=0.0, sheet_spread=0.0, creep=0.0, linearity=0.0, repeatability=0.0, gain_spread=0.0, edge_loss=0.0,
    neighbour=0.0, matrix=0.0, dead_band=0.0, dead_band_spread=0.0, fixed_offset=0.0, gain_drift=0.0, offset_drift=0.0,
    noise=0.0, noise_gain=0.0, bits=16, dead_taxels=0,
)  # fmt: skip


def sheet(seed: int = 3, **values: float) -> device.SheetSensor:
    parameters = dataclasses.replace(PLAIN, **values)
    random = np.random.default_rng(seed)
    return device.SheetSensor(parameters, device.Sheets.draw(parameters, random), random)


def even(force: float) -> np.ndarray:
    return np.full((1, 2, 10, 10), force)


def reading(sensor: device.SheetSensor, force: float | None, pad: int = 0) -> float:
    raw = sensor.read(None if force is None else even(force))
    return float(raw[0, 0, pad, 5, 5]) - PLAIN.pedestal


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


def test_no_reading_lies_between_zero_and_the_dead_band() -> None:
    parameters = dataclasses.replace(PLAIN, dead_band=1.0, dead_band_spread=0.1, noise=0.02, noise_gain=0.015)
    random = np.random.default_rng(1)
    sensor = device.SheetSensor(parameters, device.Sheets.draw(parameters, random), random)
    tare = sensor.read(None, 1.0, 60, 1 / 120).mean(axis=0)
    ramp = np.linspace(0.0, 3.0, 200).reshape(1, 2, 10, 10)
    tared = np.concatenate([(sensor.read(ramp * share) - tare).ravel() for share in (0.2, 0.6, 1.0)])
    assert not np.any((tared > 0.15) & (tared < 0.7))
    assert np.mean(tared > 0.7) > 0.1
    assert np.mean(np.abs(tared) <= 0.15) > 0.3


@pytest.mark.parametrize("force", [0.0, rest(0.1), 500.0])
def test_a_source_stays_finite_and_bounded(force: float) -> None:
    source, time = generator.SecondSource(rig_seed=7), 0.0
    for pose in ((0.03, 0.03, 0.52), (-0.03, 0.0, -0.52), (0.0, 0.0, 0.0), (0.0, -0.03, 0.52)):
        for step, yaw in ((0.0, -0.1), (1e-3, 0.0), (1e4, 0.1)):
            time += step
            frames = source.frames(time, pose, force, 2, 0.0, Lean(free=(0.03, yaw)))
            dead = np.isnan(frames)
            assert np.array_equal(dead[0], source.rig.sheets.dead)
            assert 0.0 <= frames[~dead].min() <= frames[~dead].max() <= 9.5 + 1e-9
        source.sample(time, None, 0.0)


@pytest.mark.parametrize("count", [5, rest(30)])
def test_a_data_set_has_the_first_poses_and_new_readings(count: int) -> None:
    known = generate_continuous(rigs=(3, 4), count=count, seed=1, threshold=0.0)
    fresh, again, other = (generator.dock_anew(known, seed, 2) for seed in (5, 5, 6))
    for name in ("angle", "vertical", "horizontal", "rig", "attempt", "subset"):
        assert np.array_equal(getattr(fresh, name), getattr(known, name))
    assert np.array_equal(fresh.left, again.left)
    assert not np.array_equal(fresh.left, other.left)
    assert 3e-4 < (fresh.contact_pose[:, 0] - fresh.horizontal).std() < 2e-3
    assert np.array_equal(fresh.dead[0], fresh.dead[1])
    assert fresh.simulated
    assert fresh.meta["digest"] == SecondParameters().digest() != TactileParameters().digest()


def test_it_has_the_laws_of_the_first_physics(arm: Callable[..., Any]) -> None:
    batch_equals_its_single_contacts(lambda pose: MODEL.solve(pose, 60.0, ridges=RIDGES).taxels, 1e-3)
    assert not MODEL.solve((0.0, 0.05, 0.0), 60.0).taxels.any()
    assert not MODEL.solve((0.0, 0.0, 0.0), 0.0).taxels.any()
    seeds_determine_readings_and_force_is_read_only_in_contact(generator.SecondSource, 5.0)
    yawed_target_comes_nearer_on_that_side_and_loads_that_pad(arm, generator.SecondSource, 0.0)
