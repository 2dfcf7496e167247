# SPDX-License-Identifier: Apache-2.0
"""Calibration of a rig's pads: detected errors, unchanged sound parts, and benefit on other dockings."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from deltacharger_core.yaml_file import write_yaml
from deltacharger_sim.pads import Rig, generate_continuous, measure
from deltacharger_tactile import PoseEstimator, default_model, errors, estimator, parameters
from deltacharger_tactile.calibration.fit import (
    MISFIT_LIMIT,
    KnownDockings,
    compare_tares,
    find,
    fit,
    judge,
    predict,
    select,
)
from deltacharger_tactile.calibration.rig import AXES, SHAPE, TactileCalibration

RIG = 655
REACH = np.array([0.010, 0.010, math.radians(12.0)])
FAMILY = parameters.TactileParameters()
UNEVEN = dataclasses.replace(FAMILY, sensor=dataclasses.replace(FAMILY.sensor, gain_spread=0.25))


TILTED = dataclasses.replace(Rig.draw(FAMILY, RIG), tilt=np.array([0.0, math.radians(0.06)]))


@pytest.fixture(scope="module")
def model() -> PoseEstimator:
    return default_model()


def dock(
    count: int = 60,
    seed: int = 1,
    rig: Rig | None = None,
    family: parameters.TactileParameters = FAMILY,
    off: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> KnownDockings:
    """Dock at random poses; the pads are mounted with the error `off`."""
    random = np.random.default_rng([seed, RIG])
    pose = random.uniform(-REACH, REACH, (count, 3))
    got = measure(family, rig or Rig.draw(family, RIG), pose + off, random, 12, 0.0)
    frames = np.stack([got["left"], got["right"]], axis=1).astype(float)
    frames[got["dead"]] = np.nan
    return KnownDockings(frames, pose, got["contact_pose"] - off, got["tare"][:1].astype(float), RIG, 0.0)


def error(model: PoseEstimator, made: TactileCalibration, dockings: KnownDockings) -> Any:
    pose, _, usable = predict(model, made, dockings.frames)
    return np.sqrt(np.mean((pose - dockings.truth)[usable] ** 2, axis=0))


def test_gains_are_found() -> None:
    rig = Rig.draw(UNEVEN, 650)
    made = fit(dock(100, 650, rig, UNEVEN), default_model()).calibration
    true = rig.gain / rig.gain.mean(axis=(1, 2), keepdims=True)
    assert (made.gain / true)[~rig.dead].std() < 0.5 * true[~rig.dead].std()
    assert np.array_equal(made.dead, rig.dead)


def test_a_tilt_is_found_by_ten_dockings(model: PoseEstimator) -> None:
    made = fit(dock(10, rig=TILTED), model).calibration
    assert made.load_shift > 4.0
    fresh = dock(150, 2, TILTED)
    assert np.all(error(model, made, fresh) < [0.6, 1.0, 1.1] * error(model, TactileCalibration(), fresh))


@pytest.mark.rest
def test_a_mounting_error_of_the_pads_is_found(model: PoseEstimator) -> None:
    off = (0.0, 0.0015, math.radians(0.8))
    made = fit(dock(100, off=off), model).calibration
    assert made.bias[1] == pytest.approx(off[1], abs=4e-4)
    assert made.bias[2] == pytest.approx(off[2], abs=math.radians(0.15))
    assert np.all(made.bias_stddev[1:] > 0.0)
    fresh = dock(400, 2, off=off)
    assert np.all(error(model, made, fresh)[1:] < 0.5 * error(model, TactileCalibration(), fresh)[1:])


@pytest.mark.rest
def test_another_ridge_is_detected_and_not_fitted(model: PoseEstimator) -> None:
    other = dataclasses.replace(FAMILY, contact=dataclasses.replace(FAMILY.contact, ridge_height=0.008))
    found = fit(dock(family=other), model)
    assert found.misfit > MISFIT_LIMIT > fit(dock(), model).misfit
    assert np.all(found.calibration.gain == 1.0)
    assert found.calibration.load_shift == 0.0


@pytest.mark.rest
def test_the_benefit_is_measured_on_held_out_dockings(model: PoseEstimator) -> None:
    dockings = dock(60, rig=TILTED)
    tilted = judge(dockings, model)
    assert tilted.after[0] < 0.75 * tilted.before[0]
    assert (tilted.known, tilted.worse.any()) == (True, False)


def test_a_sound_rig_has_only_the_dead_taxels_that_the_board_reports() -> None:
    faults = find(dock(30))
    assert np.array_equal(faults.dead, Rig.draw(FAMILY, RIG).dead)
    assert np.array_equal(faults.dead, faults.reported)


def test_faulty_taxels_are_found() -> None:
    sound = dock(100)
    frames = sound.frames.copy()
    frames[:, 0, 4, 3] = 0.0
    frames[:, 1, 5, 6] = 1.2
    frames[:, 0, 7, 7] = np.maximum(frames[:, 0, 7, 7] + np.random.default_rng(3).normal(0.0, 0.8, 100), 0.0)
    frames[:, 1, 2, :] += 1.5  # the entire row
    frames[::10, 1, 8, 1] = np.nan
    faults = find(dataclasses.replace(sound, frames=frames))
    row = faults.loud[1, 2] | faults.reported[1, 2]
    named = faults.silent[0, 4, 3], faults.loud[1, 5, 6], faults.noisy[0, 7, 7], faults.reported[1, 8, 1], row.all()
    assert all(named), named
    assert faults.dead.sum() == 4 + 10 + Rig.draw(FAMILY, RIG).dead.sum()


def test_differing_tares_are_detected() -> None:
    tares = np.tile(np.random.default_rng(0).normal(0.5, 0.1, SHAPE), (3, 1, 1, 1))
    tares[2, 0, 1, 1] += 0.4
    tares[:, 1, 9, 9] += 1.0
    tares[1, 1, 0, 0] += 5.0
    dead = np.zeros(SHAPE, dtype=bool)
    dead[1, 0, 0] = True
    found = compare_tares(dataclasses.replace(dock(10), tares=tares), dead)
    assert np.argwhere(found.drifted).tolist() == [[0, 1, 1]]
    assert np.argwhere(found.outlying).tolist() == [[1, 9, 9]]


def test_one_rig_is_chosen_and_unusable_data_are_refused(model: PoseEstimator) -> None:
    data = generate_continuous(rigs=(3, 4), count=20, threshold=0.0)
    assert np.array_equal(select(data, 4).pose[:, 2], data.angle[20:])
    empty = dataclasses.replace(select(data, 3), frames=np.zeros((20, *SHAPE)))
    for refused, noun in ((lambda: select(data), "--rig"), (lambda: fit(empty, model), "in range")):
        with pytest.raises(errors.SensorCalibrationError, match=noun):
            refused()


DEAD = np.zeros(SHAPE, dtype=bool)
DEAD[1, 2, 3] = True
FULL = TactileCalibration(
    gain=np.round(np.random.default_rng(5).uniform(0.5, 1.5, SHAPE), 4), dead=DEAD, load_shift=-4.5,
    bias=np.array([1e-3, -2e-4, 0.01]), bias_stddev=np.array([3e-4, 1e-4, 1e-3]), rig=7, sensor="left A, right B",
    model="pose-1", date="2026-01-01T00:00Z", dockings=60, data="0" * 64, simulated=True,
)  # fmt: skip


def test_applying_undoes_gain_and_load_shift() -> None:
    made = dataclasses.replace(FULL, load_shift=0.0)
    even = np.random.default_rng(1).uniform(1.0, 5.0, (3, *SHAPE))
    seen = np.stack(made.apply(*(even * made.gain).transpose(1, 0, 2, 3)), axis=1)
    assert np.array_equal(np.isnan(seen), np.tile(DEAD, (3, 1, 1, 1)))
    assert np.allclose(seen[:, ~DEAD], even[:, ~DEAD])
    pads = dataclasses.replace(made, gain=np.ones(SHAPE), load_shift=6.0).apply(*np.ones(SHAPE))
    assert [np.nansum(pad) for pad in pads] == pytest.approx([100.0 - 3.0, 99.0 + 3.0])


def test_correction_moves_the_estimate_and_derived_values(model: PoseEstimator) -> None:
    frames = dock(40).frames
    raw = model.predict(frames[:, 0], frames[:, 1])
    got = FULL.correct(raw)
    for axis, bias, stddev in zip(AXES, FULL.bias, FULL.bias_stddev, strict=True):
        assert np.allclose(getattr(got, axis), getattr(raw, axis) - bias, equal_nan=True)
        spread = np.hypot(getattr(raw, f"{axis}_stddev"), stddev)
        assert np.allclose(getattr(got, f"{axis}_stddev"), spread, equal_nan=True)
    assert not np.any(got.in_range & ~raw.in_range)
    assert not np.any(got.sure & ~raw.sure)
    # An error along x affects the offset across the bars only through roll.
    vague, aside = (dataclasses.replace(FULL, bias_stddev=np.eye(3)[axis] * 0.01).correct(raw) for axis in (1, 0))
    assert (vague.in_range.any(), vague.sure.any(), aside.sure.any()) == (True, False, True)
    assert not np.any(aside.sure & (0.01 * np.abs(np.sin(raw.angle)) > estimator.Limits().across_stddev))
    assert np.any(raw.sure & ~aside.sure)
    far = dataclasses.replace(FULL, bias=np.array([0.0, 0.02, 0.0])).correct(raw)
    assert not far.in_range[raw.vertical < 0.0].any()


def test_a_saved_file_loads_unchanged(tmp_path: Path) -> None:
    made, path = FULL, tmp_path / "pads.yaml"
    made.save(path, "first line\nsecond")
    assert path.read_text(encoding="utf-8").startswith("# first line\n# second\n")
    got = TactileCalibration.load(path)
    for name, value in vars(made).items():
        assert np.array_equal(getattr(got, name), value), name


PAD, BIAS = [[1.0] * 10] * 10, {"horizontal": 0.0, "vertical": 0.0, "angle": 0.0}
DAMAGE: list[tuple[str, Any, str]] = [
    ("version", 2, "version"),
    ("gian", 1, "exactly"),
    ("gain", {"left": PAD, "right": PAD[1:]}, "gain"),
    ("gain", {"left": PAD, "right": [[float("nan")] * 10] * 10}, "gain"),
    ("gain", {"left": PAD, "right": [[0.0] * 10] * 10}, "gain"),
    ("bias", BIAS | {"horizontal": 1.0}, "bias.horizontal"),
    ("bias_stddev", BIAS | {"vertical": -1e-4}, "bias_stddev.vertical"),
    ("load_shift", float("nan"), "load_shift"),
    ("dead", [[0, 0, 10]], "dead"),
    ("rig", "one", "rig"),
]


@pytest.mark.parametrize(("key", "value", "named"), DAMAGE)
def test_a_damaged_file_is_refused_by_its_key(tmp_path: Path, key: str, value: Any, named: str) -> None:
    path = tmp_path / "pads.yaml"
    FULL.save(path)
    write_yaml(path, yaml.safe_load(path.read_text(encoding="utf-8")) | {key: value})
    with pytest.raises(errors.SensorCalibrationError, match=named) as caught:
        TactileCalibration.load(path)
    assert str(path) in str(caught.value)
