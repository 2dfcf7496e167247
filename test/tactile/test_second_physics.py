# SPDX-License-Identifier: Apache-2.0
"""Laws of the second contact physics: balance, symmetry, force on bars, convergence, extremes; its parameters."""

from __future__ import annotations

import subprocess
import sys
from itertools import product

import numpy as np
import pytest

from deltacharger_core.parameters import ParameterError, from_mapping
from deltacharger_tactile.second.bars import SpringBars
from deltacharger_tactile.second.equilibrium import Equilibrium
from deltacharger_tactile.second.foundation import PadFoundation, Ridges
from deltacharger_tactile.second.parameters import (
    BarParameters,
    FoundationParameters,
    PlatformRestParameters,
    SecondParameters,
)

from ..marks import rest

Pair = tuple[float, float]

MODEL = Equilibrium()
RIDGES = Ridges(np.array([3e-5, -2e-5]), np.array([-1e-5, 4e-5]))


def poses(count: int, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.uniform([-0.012, -0.012, -0.35], [0.012, 0.012, 0.35], (count, 3))


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


def test_a_batch_equals_its_single_contacts() -> None:
    many = poses(8, 3)
    batch = MODEL.solve(many, 60.0, ridges=RIDGES).taxels
    for index, pose in enumerate(many):
        assert np.allclose(batch[index], MODEL.solve(pose, 60.0, ridges=RIDGES).taxels[0], atol=1e-3)


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


@pytest.mark.rest
def test_a_finer_grid_changes_little() -> None:
    many = poses(60, 4) * [0.7, 0.5, 0.7]
    coarse, fine = (
        Equilibrium(SecondParameters(foundation=FoundationParameters(sub_samples=count))).solve(many, 70.0).taxels
        for count in (FoundationParameters().sub_samples, 12)
    )
    worst = np.abs(coarse - fine).max(axis=(1, 2, 3)) / fine.max(axis=(1, 2, 3))
    assert np.median(worst) < 0.01
    assert np.quantile(worst, 0.95) < 0.03
    assert np.sqrt(np.sum((coarse - fine) ** 2) / np.sum(fine**2)) < 0.01


def test_the_lower_layer_spreads_without_loss_and_solves_its_equation() -> None:
    parameters = FoundationParameters()
    pads = PadFoundation(SecondParameters().dimensions, parameters)
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
    pads, bars = PadFoundation(SecondParameters().dimensions, FoundationParameters()), SpringBars(BarParameters())
    depth = np.linspace(-1e-3, 3e-3, 4001)
    smooth = np.abs(depth) > 5e-6  # the curve starts with a kink
    for law in (pads, bars):
        force, slope, energy = law.press(depth)
        assert np.allclose(np.gradient(energy, depth)[2:-2], force[2:-2], rtol=1e-3, atol=2e-3 * force.max())
        assert np.all(np.diff(force) >= 0.0)
        assert not force[depth < 0.0].any()
        if law is pads:
            assert np.allclose(np.gradient(force, depth)[smooth], slope[smooth], rtol=1e-2)


def test_overlapping_bars_carry_part_of_the_force() -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.010, 0.0, 0.0], [0.0, 0.009, 0.0]])
    found = MODEL.solve(places, 70.0)
    share = found.bars.sum(axis=1) / 70.0
    assert 0.05 < share[0] < 0.25
    assert share[1] < share[0]  # shorter overlap
    assert found.bars[2, 0] != pytest.approx(found.bars[2, 1], rel=0.01)  # the upper bar overlaps half as much
    without = Equilibrium(SecondParameters(bars=BarParameters(rate=0.0, preload=0.0))).solve(places, 70.0)
    assert without.taxels.sum(axis=(1, 2, 3)) == pytest.approx([70.0] * 3, rel=1e-6)


@pytest.mark.parametrize(("line", "lean", "more"), [((0.005, 0.0), (0.0, 0.0), 3.0), ((0.0, 0.0), (0.0, 0.002), 0.5)])
def test_load_follows_the_line_of_action_and_the_lean(line: Pair, lean: Pair, more: float) -> None:
    left, right = MODEL.solve((0.0, 0.0, 0.0), 70.0, line, lean).taxels[0].sum(axis=(1, 2))
    assert left > right + more


@pytest.mark.parametrize("force", [0.1, rest(5.0), 500.0])
@pytest.mark.parametrize("lean", [rest((0.0, 0.0)), (0.03, -0.03)])
def test_extremes_are_finite_and_balanced(force: float, lean: Pair) -> None:
    places = np.array(list(product((-0.03, 0.0, 0.03), (-0.03, 0.0, 0.012), (-0.5236, 0.0, 0.5236))))
    found = MODEL.solve(places, force, places[:, :2], lean)
    touching = np.isfinite(found.state[:, 0])
    borne = found.taxels.sum(axis=(1, 2, 3)) + found.bars.sum(axis=1)
    assert np.isfinite(found.taxels).all()
    assert np.allclose(borne[touching], force, rtol=1e-6)
    assert not borne[~touching].any()


def test_nothing_is_pressed_without_force_or_contact() -> None:
    nothing = MODEL.solve((0.0, 0.0, 0.0), 0.0)
    assert not nothing.taxels.any()
    assert np.isnan(nothing.state).all()
    assert not MODEL.solve((0.0, 0.05, 0.0), 60.0).taxels.any()


@pytest.mark.parametrize(
    "values",
    [
        rest({"foundation": {"modulus": 5e7, "base_stiffness": 1e11}}),
        rest({"foundation": {"base_stiffness": 4.1e8, "shear_length": 5e-3}}),
        rest({"platform": {"compliance": 1e-4}}),
        rest({"platform": {"compliance": 0.1}}),
        {"bars": {"rate": 1e6, "stop_stiffness": 1e9, "seat": 1e-6, "preload": 20.0, "travel": 1e-4, "proud": 1e-3}},
    ],
)
def test_families_at_the_ends_of_their_bounds_come_to_rest(values: dict[str, dict[str, float]]) -> None:
    random = np.random.default_rng(7)
    many = random.uniform([-0.03, -0.03, -0.53], [0.03, 0.03, 0.53], (48, 3))
    force = 10.0 ** random.uniform(-1.0, 2.7, 48)
    found = Equilibrium(from_mapping(values, SecondParameters)).solve(many, force, many[:, :2], (0.01, -0.01))
    touching = np.isfinite(found.state[:, 0])
    borne = found.taxels.sum(axis=(1, 2, 3)) + found.bars.sum(axis=1)
    assert touching.mean() > 0.8
    assert np.allclose(borne[touching], force[touching], rtol=1e-6)


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"foundation": {"base_stiffness": 3e8}}, "foundation.base_stiffness"),
        ({"bars": {"seat": 1e-3, "travel": 5e-4}}, "bars.seat"),
        ({"bars": {"rate": 1e5, "stop_stiffness": 2e4}}, "bars.stop_stiffness"),
        ({"sheet": {"dead_band": 4.9, "full_scale": 5.0}}, "sheet.dead_band"),
        ({"sheet": {"edge_loss": 0.8, "neighbour": 0.1}}, "sheet.neighbour"),
        ({"platform": {"compliance": 0.0}}, "platform.compliance"),
    ],
)
def test_contradictions_are_refused_by_key(values: dict[str, dict[str, float]], key: str) -> None:
    with pytest.raises(ParameterError) as caught:
        from_mapping(values, SecondParameters)
    assert caught.value.key == key


@pytest.mark.rest
def test_it_is_imported_only_on_demand() -> None:
    program = (
        "import sys, deltacharger_tactile, deltacharger_tactile.source, deltacharger_tactile.generator\n"
        "deltacharger_tactile.source.ContactSource().begin_docking()\n"
        "assert not [name for name in sys.modules if name.startswith('deltacharger_tactile.second')]\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
