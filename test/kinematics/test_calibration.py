# SPDX-License-Identifier: Apache-2.0
"""Laws of the calibration: accuracy, errors and refusals."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration.calibrate import calibrate, describe, find_outliers, fit
from deltacharger_kinematics.calibration.data import TICK, Measurements, read_measurements
from deltacharger_kinematics.calibration.problem import (
    COUNT,
    NAMES,
    Problem,
    Uncertainty,
    numbers,
    rms,
    with_numbers,
)
from deltacharger_kinematics.calibration.table import CalibrationError
from deltacharger_kinematics.geometry_file import load_geometry, save_geometry

from ..marks import night, rest
from .measured_arms import KEPT, MILLIMETRE, NOMINAL, POINTS, STATED, drawn_arm, measured, write

BOX = np.random.default_rng(9).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (200, 3))
BOX_ANGLES = Delta(NOMINAL).inverse(BOX).angles
GOOD, UP = measured(drawn_arm(1)), np.array([0.0, 0.0, 0.055])


def workspace_error(arm: DeltaGeometry, model: DeltaGeometry) -> float:
    return rms(Delta(arm).forward(BOX_ANGLES).position - Delta(model).forward(BOX_ANGLES).position)


@pytest.mark.parametrize("seed", [0, rest(1), rest(2)])
def test_exact_measurements_recover_the_arm(seed: int) -> None:
    arm = drawn_arm(seed)
    exact = Uncertainty(measurement=1e-9)  # so small that the tolerances have no effect
    found = fit(measured(arm, noise=0.0), NOMINAL, exact)
    assert np.abs(numbers(found.geometry) - numbers(arm)).max() < 1e-9
    assert rms(found.residuals) < 1e-13
    assert workspace_error(arm, found.geometry) < 1e-12


def test_derivatives_match_the_geometry() -> None:
    """Compared with the closure r·(dp − dc) = L dL of Delta.forward, derived by hand."""
    arm, angles = drawn_arm(3), Delta(NOMINAL).inverse(BOX).angles
    p = Delta(arm).forward(angles).position
    rods, rates = np.zeros((len(p), 3, 3)), np.zeros((len(p), 3, COUNT))
    for index in range(3):
        limb = arm.limb(index)
        out, side = np.array([limb.cosine, limb.sine, 0.0]), np.array([-limb.sine, limb.cosine, 0.0])
        up = np.array([0.0, 0.0, 1.0])
        true = (angles[:, index] + limb.angle_offset)[:, None]
        along = np.cos(true) * out + np.sin(true) * up
        centre = limb.difference * out + limb.tangential_offset * side - limb.motor_height * up + limb.arm * along
        rods[:, index] = p - centre
        by = {
            "radius_offset": out,
            "tangential_offset": side,
            "height_offset": up,
            "arm": along,
            "angle_offset": limb.arm * (np.cos(true) * up - np.sin(true) * out),
        }
        for column, name in enumerate(NAMES):
            rates[:, index, 6 * index + column] = (
                limb.rod if name == "rod" else (rods[:, index] * by[name]).sum(axis=-1)
            )
    expected = np.linalg.solve(rods, rates) * STATED.tolerances
    rows = Measurements(p, angles, None, tuple(range(len(p))))
    x = (numbers(arm) - numbers(NOMINAL)) / STATED.tolerances
    assert np.allclose(Problem(rows, NOMINAL, STATED).sensitivity(x), expected, atol=1e-12)


@pytest.mark.parametrize("count", [rest(3), night(8)])
def test_a_calibration_improves_accuracy(count: int) -> None:
    """Trial figures of the design note: 2.37 mm uncalibrated, 0.71 with angle offsets only, 0.048 with 18 numbers."""
    arms = [drawn_arm(seed) for seed in range(count)]
    angles_only = replace(STATED, length=1e-9)
    errors = {"none": [], "angles": [], "all": [], "play": [], "held out": []}  # type: dict[str, list[float]]
    for seed, arm in enumerate(arms):
        rows = measured(arm, seed=seed)
        found = calibrate(rows, NOMINAL, STATED)
        errors["none"].append(workspace_error(arm, NOMINAL))
        errors["angles"].append(workspace_error(arm, fit(rows, NOMINAL, angles_only).geometry))
        errors["all"].append(workspace_error(arm, found.fit.geometry))
        errors["held out"].append(found.held_out_rms[1])
        with_play = measured(arm, seed=seed, play=math.radians(0.165))
        errors["play"].append(workspace_error(arm, fit(with_play, NOMINAL, STATED).geometry))
        assert found.improves
        assert not found.outliers.any()
    mean = {name: math.sqrt(np.mean(np.square(values))) / MILLIMETRE for name, values in errors.items()}
    assert 2.0 < mean["none"] < 5.5
    assert 0.3 < mean["angles"] < 1.2
    assert mean["all"] < 0.05
    assert 0.08 < mean["held out"] < 0.14  # the measurement's own 0.05·√3 mm and the fit's error
    assert mean["play"] < 0.25


@pytest.mark.night
def test_the_stated_uncertainty_matches_the_real_errors() -> None:
    """The scatter of fitted minus true values and the workspace error match the stated standard deviations."""
    deviations, expected, real = [], [], []
    for seed in range(12):
        arm = drawn_arm(100 + seed)
        found = calibrate(measured(arm, seed=seed), NOMINAL, STATED)
        deviations.append((numbers(found.fit.geometry) - numbers(arm)) / found.standard_deviations)
        expected.append(found.expected[0])
        real.append(workspace_error(arm, found.fit.geometry))
    assert 0.85 < np.sqrt(np.mean(np.square(deviations))) < 1.15
    assert 0.8 < rms(np.array([real])) / rms(np.array([expected])) < 1.25


@pytest.mark.rest
def test_rows_that_scatter_more_than_stated_have_less_weight() -> None:
    arm = drawn_arm(4)
    found = fit(measured(arm, noise=0.25 * MILLIMETRE), NOMINAL, STATED)
    same = fit(measured(arm, noise=0.25 * MILLIMETRE), NOMINAL, replace(STATED, measurement=0.25 * MILLIMETRE))
    assert 4.0 < found.scatter < 6.0
    assert 0.8 < same.scatter < 1.2
    assert np.allclose(found.singular_values, same.singular_values, rtol=0.2)


@pytest.mark.parametrize("seed", [0, *map(rest, range(1, 5))])
def test_tolerances_constrain_what_nine_poses_do_not_determine(seed: int) -> None:
    arm = drawn_arm(seed)
    nine = np.random.default_rng(seed).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (9, 3))
    found = fit(measured(arm, nine, seed=seed), NOMINAL, STATED)
    assert (np.abs(numbers(found.geometry) - numbers(NOMINAL)) < 5.0 * STATED.tolerances).all()
    assert workspace_error(arm, found.geometry) < 0.3 * MILLIMETRE
    assert found.singular_values[-1] < 1.0


@pytest.mark.rest
def test_whole_ticks_are_weighted_by_their_resolution(tmp_path: Path) -> None:
    arm = drawn_arm(6)
    rows = measured(arm, noise=0.005 * MILLIMETRE)
    rounded = replace(rows, angles=np.round(rows.angles / TICK) * TICK)
    aware = fit(replace(rounded, angle_stddev=TICK / math.sqrt(12.0)), NOMINAL, replace(STATED, measurement=5e-6))
    assert aware.scatter < 1.3
    assert fit(rounded, NOMINAL, replace(STATED, measurement=5e-6)).scatter > 5.0
    assert read_measurements(write(tmp_path / "ticks.csv", rows)).angle_stddev == pytest.approx(TICK / math.sqrt(12.0))


@pytest.mark.rest
def test_a_calibrated_geometry_is_a_valid_start() -> None:
    arm = drawn_arm(7)
    start = with_numbers(arm, numbers(arm) + 0.3 * STATED.tolerances)
    found = calibrate(measured(arm), start, STATED)
    assert found.improves
    assert workspace_error(arm, found.fit.geometry) < 0.06 * MILLIMETRE


def test_exactly_the_outliers_are_named() -> None:
    arm = drawn_arm(8)
    rows = measured(arm)
    rows.positions[4, 0] += 1.0 * MILLIMETRE
    rows.positions[20] += 5.0 * MILLIMETRE
    assert np.flatnonzero(find_outliers(rows, NOMINAL, STATED)).tolist() == [4, 20]


@pytest.mark.rest
def test_the_held_out_rows_are_drawn_by_the_seed_or_taken_from_the_file() -> None:
    rows = measured(drawn_arm(1))
    assert calibrate(rows).held_out.tolist() == KEPT.tolist()
    free = replace(rows, held_out=None)
    drawn = [calibrate(free, held_out=0.25, seed=seed).held_out for seed in (0, 0, 1)]
    assert [mask.sum() for mask in drawn] == [9, 9, 9]
    assert (drawn[0] == drawn[1]).all()
    assert (drawn[0] != drawn[2]).any()


@pytest.mark.rest
def test_a_calibration_that_does_not_improve_is_reported() -> None:
    results = [calibrate(measured(NOMINAL, seed=seed), NOMINAL, STATED) for seed in range(4)]
    assert all(result.held_out_rms[1] < 0.2 * MILLIMETRE for result in results)
    assert not all(result.improves for result in results)


def test_the_weakest_direction_is_described() -> None:
    direction = np.zeros(COUNT)
    direction[[4, 10]] = 0.6
    direction[2] = -0.5
    assert describe(direction) == "rod of limbs 0, 1 larger with height_offset of limb 0 smaller"
    assert describe(-direction) == describe(direction)


@pytest.mark.rest
def test_a_calibration_changes_the_limbs_alone_and_its_file_has_the_held_out_accuracy(tmp_path: Path) -> None:
    path, start = tmp_path / "arm.yaml", replace(NOMINAL, rod_mass=0.03)
    found = calibrate(measured(drawn_arm(2)), start, STATED)
    assert replace(found.fit.geometry, limbs=start.limbs) == start
    save_geometry(found.fit.geometry, path, "made by a test")
    loaded = load_geometry(path)
    assert loaded == found.fit.geometry
    unseen = measured(drawn_arm(2), BOX, seed=5)
    error = unseen.positions - Delta(loaded).forward(unseen.angles).position
    assert rms(error) < 1.3 * found.held_out_rms[1]


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        (measured(NOMINAL, POINTS * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.05]), "one plane.*along z"),
        (measured(NOMINAL, POINTS * [1.0, 0.0, 1.0]), "one plane.*along y"),
        (measured(NOMINAL, POINTS * [0.0, 0.0, 1.0]), "one line"),
        (measured(NOMINAL, POINTS @ [[1, 0, 1], [0, 1, 0], [0, 0, 0]] + UP), r"-0\.7, 0\.0"),
        (measured(NOMINAL, np.full((36, 3), 0.03)), "one point"),
        (measured(NOMINAL, POINTS * 0.05 + [0.0, 0.0, 0.05]), "one point"),
        (replace(measured(NOMINAL, np.repeat(POINTS[[0, 2, 8, 26]], 8, axis=0)), held_out=None), "do not determine"),
        (measured(NOMINAL, BOX[:1]), "more poses"),
        (measured(NOMINAL, BOX[:6]), "more poses"),
        # Millimetres in columns of metres, and the other way round.
        (replace(GOOD, positions=1e3 * GOOD.positions), "millimetres"),
        (replace(GOOD, positions=1e-3 * GOOD.positions), "mm"),
        # Axes swapped, origin in the motor plane, limbs swapped, horn one tooth off.
        (replace(GOOD, positions=GOOD.positions[:, [1, 0, 2]]), "predicted"),
        (replace(GOOD, positions=GOOD.positions + 1.7 * UP), "predicted"),
        (replace(GOOD, angles=GOOD.angles[:, [2, 1, 0]]), "predicted"),
        (replace(GOOD, angles=GOOD.angles + math.radians(15.0)), "predicted"),
    ],
)
def test_unsuitable_measurements_are_refused(rows: Measurements, problem: str) -> None:
    with pytest.raises(CalibrationError, match=problem):
        calibrate(rows, NOMINAL, STATED)


def test_angles_that_the_arm_cannot_have_are_refused_with_their_lines() -> None:
    rows = measured(NOMINAL)
    rows.angles[[3, 7]] = [3.0, 0.0, -3.0]
    with pytest.raises(CalibrationError, match="lines 5, 9: an arm angle is far outside the joint limits") as refused:
        calibrate(rows, NOMINAL, STATED)
    assert refused.value.lines == (5, 9)
    short = replace(NOMINAL, rod=0.100, joint_max=math.radians(120.0))
    rows.angles[[3, 7]] = [-1.1, 1.9, 1.9]
    lost = np.isnan(Delta(short).forward(rows.angles).position).any(axis=1)
    with pytest.raises(CalibrationError, match="its rods would not meet") as refused:
        calibrate(rows, short, STATED)
    assert refused.value.lines == tuple(np.flatnonzero(lost) + 2)


@pytest.mark.parametrize("name", ["measurement", "length", "angle"])
def test_uncertainties_are_positive(name: str) -> None:
    for value in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(CalibrationError, match=name):
            replace(STATED, **{name: value})
