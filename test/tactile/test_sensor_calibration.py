# SPDX-License-Identifier: Apache-2.0
"""Calibration of a rig's pads: detected errors, unchanged sound parts, and benefit on other dockings."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from deltacharger_core.yaml_file import write_yaml
from deltacharger_tactile import PoseEstimator, default_model
from deltacharger_tactile.calibration.faults import KnownDockings, compare_tares, find, select
from deltacharger_tactile.calibration.fit import JITTER, MISFIT_LIMIT, Parts, fit, judge, predict
from deltacharger_tactile.calibration.rig import AXES, SHAPE, TactileCalibration
from deltacharger_tactile.errors import FrameError, SensorCalibrationError
from deltacharger_tactile.estimate import Limits
from deltacharger_tactile.generator import generate_continuous, measure
from deltacharger_tactile.parameters import TactileParameters
from deltacharger_tactile.perception import Perception
from deltacharger_tactile.sensor import Rig

RIG = 655
REACH = np.array([0.010, 0.010, math.radians(12.0)])
FAMILY = TactileParameters()
UNEVEN = dataclasses.replace(FAMILY, sensor=dataclasses.replace(FAMILY.sensor, gain_spread=0.25))


@pytest.fixture(scope="module")
def model() -> PoseEstimator:
    return default_model()


def dock(
    count: int = 60,
    seed: int = 1,
    rig: Rig | None = None,
    family: TactileParameters = FAMILY,
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


@pytest.mark.rest
def test_gains_are_found_and_help_on_other_dockings(model: PoseEstimator) -> None:
    before, after = [], []
    for seed in range(650, 656):
        rig = Rig.draw(UNEVEN, seed)
        made = fit(dock(100, seed, rig, UNEVEN), model).calibration
        true = rig.gain / rig.gain.mean(axis=(1, 2), keepdims=True)
        assert (made.gain / true)[~rig.dead].std() < 0.5 * true[~rig.dead].std()
        assert np.array_equal(made.dead, rig.dead)
        fresh = dock(200, 2, rig, UNEVEN)
        before.append(error(model, TactileCalibration(), fresh))
        after.append(error(model, made, fresh))
    assert np.all(np.mean(np.square(after), axis=0)[:2] < np.mean(np.square(before), axis=0)[:2])


def test_a_tilt_is_found_by_ten_dockings(model: PoseEstimator) -> None:
    rig = dataclasses.replace(Rig.draw(FAMILY, RIG), tilt=np.array([0.0, math.radians(0.06)]))
    made = fit(dock(10, rig=rig), model).calibration
    assert made.load_shift > 4.0
    fresh = dock(400, 2, rig)
    before, after = error(model, TactileCalibration(), fresh), error(model, made, fresh)
    assert after[0] < 0.6 * before[0]
    assert after[1] < before[1]
    assert after[2] < 1.1 * before[2]


def test_a_mounting_error_of_the_pads_is_found(model: PoseEstimator) -> None:
    off = (0.0, 0.0015, math.radians(0.8))
    made = fit(dock(100, off=off), model).calibration
    assert made.bias[1] == pytest.approx(off[1], abs=4e-4)
    assert made.bias[2] == pytest.approx(off[2], abs=math.radians(0.15))
    assert np.all(made.bias_stddev[1:] > 0.0)
    fresh = dock(400, 2, off=off)
    assert np.all(error(model, made, fresh)[1:] < 0.5 * error(model, TactileCalibration(), fresh)[1:])


@pytest.mark.rest
def test_jitter_of_few_dockings_is_not_taken_for_an_error(model: PoseEstimator) -> None:
    kept = []
    for seed in range(16):
        found = fit(dock(12, seed), model, Parts(False, False, True))
        assert np.all(found.bias_error >= 0.9 * JITTER / math.sqrt(found.in_range))
        assert np.all(np.abs(found.calibration.bias) <= np.abs(found.bias))
        kept.append(found.calibration.bias)
    spread = np.sqrt(np.mean(np.square(kept), axis=0))
    assert np.all(spread < 0.5 * JITTER / math.sqrt(12))  # the error of using every mean unshrunk


def test_another_ridge_is_detected_and_not_fitted(model: PoseEstimator) -> None:
    other = dataclasses.replace(FAMILY, contact=dataclasses.replace(FAMILY.contact, ridge_height=0.008))
    found = fit(dock(family=other), model)
    assert found.misfit > MISFIT_LIMIT
    assert np.all(found.calibration.gain == 1.0)
    assert found.calibration.load_shift == 0.0
    assert fit(dock(), model).misfit < MISFIT_LIMIT


def test_the_benefit_is_measured_on_held_out_dockings(model: PoseEstimator) -> None:
    rig = dataclasses.replace(Rig.draw(FAMILY, RIG), tilt=np.array([0.0, math.radians(0.06)]))
    tilted = judge(dock(60, rig=rig), model)
    assert tilted.after[0] < 0.75 * tilted.before[0]
    assert tilted.known
    assert not tilted.worse.any()
    blind = dataclasses.replace(dock(60, rig=rig), truth=np.full((60, 3), np.nan))
    unknown_truth = judge(blind, model)
    assert not unknown_truth.known
    assert unknown_truth.before[1] > tilted.before[1]  # includes the jitter


@pytest.mark.parametrize("count", [30, 200])
def test_a_sound_rig_has_only_the_dead_taxels_that_the_board_reports(count: int) -> None:
    faults = find(dock(count))
    assert np.array_equal(faults.dead, Rig.draw(FAMILY, RIG).dead)
    assert np.array_equal(faults.dead, faults.reported)


def test_faulty_taxels_are_found() -> None:
    sound = dock(100)
    random = np.random.default_rng(3)
    frames = sound.frames.copy()
    frames[:, 0, 4, 3] = 0.0
    frames[:, 1, 5, 6] = 1.2
    frames[:, 0, 7, 7] = np.maximum(frames[:, 0, 7, 7] + random.normal(0.0, 0.8, 100), 0.0)
    frames[:, 1, 2, :] += 1.5  # the entire row
    frames[::10, 1, 8, 1] = np.nan
    faults = find(dataclasses.replace(sound, frames=frames))
    assert faults.silent[0, 4, 3]
    assert faults.loud[1, 5, 6]
    assert faults.noisy[0, 7, 7]
    row = faults.loud[1, 2] | faults.reported[1, 2]
    assert row.all()
    assert faults.reported[1, 8, 1]
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
    unknown = compare_tares(dataclasses.replace(dock(10), tares=np.full((3, *SHAPE), np.nan)), dead)
    assert not unknown.drifted.any()
    assert np.isnan(unknown.drift).all()


def test_one_rig_is_chosen_and_rows_of_a_docking_are_averaged(model: PoseEstimator) -> None:
    data = generate_continuous(rigs=(3, 4), count=20, threshold=0.0)
    with pytest.raises(SensorCalibrationError, match=r"3, 4; pick one with --rig"):
        select(data)
    with pytest.raises(SensorCalibrationError, match="rig 5"):
        select(data, 5)
    assert np.array_equal(select(data, 4).pose[:, 2], data.angle[20:])
    twice = dataclasses.replace(
        data, **{name: np.repeat(getattr(data, name), 2, axis=0) for name in vars(data) if name != "meta"}
    )
    assert np.allclose(select(twice, 4).frames, select(data, 4).frames, equal_nan=True)
    with pytest.raises(SensorCalibrationError, match="in range"):
        fit(dataclasses.replace(select(data, 3), frames=np.zeros((20, *SHAPE))), model)
    with pytest.raises(SensorCalibrationError, match="--threshold"):
        fit(select(generate_continuous(rigs=(3,), count=20, threshold=1.0)), model)


def full() -> TactileCalibration:
    random = np.random.default_rng(5)
    dead = np.zeros(SHAPE, dtype=bool)
    dead[1, 2, 3] = True
    return TactileCalibration(
        gain=np.round(random.uniform(0.5, 1.5, SHAPE), 4),
        dead=dead,
        load_shift=-4.5,
        bias=np.array([1e-3, -2e-4, 0.01]),
        bias_stddev=np.array([3e-4, 1e-4, 1e-3]),
        rig=7,
        sensor="left A, right B",
        model="pose-1",
        date="2026-01-01T00:00Z",
        dockings=60,
        data="0" * 64,
        simulated=True,
    )


def test_applying_undoes_gain_and_load_shift() -> None:
    made = dataclasses.replace(full(), load_shift=0.0)
    even = np.random.default_rng(1).uniform(1.0, 5.0, (3, *SHAPE))
    seen = made.apply(*(even * made.gain).transpose(1, 0, 2, 3))
    assert np.isnan(seen[1][:, 2, 3]).all()
    assert np.allclose(np.stack(seen, axis=1)[:, ~made.dead], even[:, ~made.dead])
    loads = [pad[~made.dead[index]].sum() for index, pad in enumerate(np.ones(SHAPE))]
    left, right = dataclasses.replace(made, gain=np.ones(SHAPE), load_shift=6.0).apply(*np.ones(SHAPE))
    assert left.sum() == pytest.approx(loads[0] - 3.0)
    assert np.nansum(right) == pytest.approx(loads[1] + 3.0)


def test_a_light_pad_stays_light() -> None:
    shifting = TactileCalibration(load_shift=20.0)
    heavy, light = np.ones(SHAPE[1:]), np.zeros(SHAPE[1:])
    light[4] = 0.25  # 2.5 N: too little for a pad that holds the ridge
    assert np.array_equal(shifting.apply(heavy, light)[1], light)
    light[4] = 1.0
    assert shifting.apply(heavy, light)[1].sum() <= 1.3 * light.sum() + 1e-9
    with pytest.raises(FrameError):
        shifting.apply(heavy, light[:9])


def test_correction_moves_the_estimate_and_derived_values(model: PoseEstimator) -> None:
    frames = dock(40).frames
    raw = model.predict(frames[:, 0], frames[:, 1])
    made = full()
    got = made.correct(raw)
    for axis, bias, stddev in zip(AXES, made.bias, made.bias_stddev, strict=True):
        assert np.allclose(getattr(got, axis), getattr(raw, axis) - bias, equal_nan=True)
        assert np.allclose(
            getattr(got, f"{axis}_stddev"), np.hypot(getattr(raw, f"{axis}_stddev"), stddev), equal_nan=True
        )
        shares = getattr(got, f"{axis}_probability")[raw.contact]
        assert np.allclose(shares.sum(axis=1), 1.0)
    likely = np.argmax(got.vertical_probability[raw.contact], axis=1)
    assert np.array_equal(likely, np.clip(np.round(got.vertical[raw.contact] / 0.005), -2, 2) + 2)
    assert not np.any(got.in_range & ~raw.in_range)
    assert not np.any(got.sure & ~raw.sure)
    vague = dataclasses.replace(made, bias_stddev=np.array([0.0, 0.01, 0.0])).correct(raw)
    assert vague.in_range.any()
    assert not vague.sure.any()
    # An error along x affects the offset across the bars only through roll.
    vague = dataclasses.replace(made, bias_stddev=np.array([0.01, 0.0, 0.0])).correct(raw)
    assert vague.sure.any()
    assert not np.any(vague.sure & (0.01 * np.abs(np.sin(raw.angle)) > Limits().across_stddev))
    assert np.any(raw.sure & ~vague.sure)
    far = dataclasses.replace(made, bias=np.array([0.0, 0.02, 0.0])).correct(raw)
    assert not far.in_range[raw.vertical < 0.0].any()
    one = made.correct(model.predict(frames[0, 0], frames[0, 1]))
    assert isinstance(one.angle, float)
    assert isinstance(one.sure, bool)
    assert one.angle_probability.shape == (6,)
    nothing = made.correct(model.predict(np.zeros(SHAPE[1:]), np.zeros(SHAPE[1:])))
    assert math.isnan(nothing.angle)
    assert (nothing.contact, nothing.in_range, nothing.sure) == (False, False, False)
    assert TactileCalibration().correct(raw) is raw


def test_a_saved_file_loads_unchanged(tmp_path: Path) -> None:
    made, path = full(), tmp_path / "pads.yaml"
    made.save(path, "first line\nsecond")
    assert path.read_text(encoding="utf-8").startswith("# first line\n# second\n")
    got = TactileCalibration.load(path)
    for name, value in vars(made).items():
        assert np.array_equal(getattr(got, name), value), name


def test_a_calibration_made_for_an_earlier_model_is_used_and_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "pads.yaml"
    for model, warned in ((default_model().name, False), ("pose-1", True)):
        dataclasses.replace(full(), model=model).save(path)
        perception = Perception.load(calibration=str(path))
        assert perception.calibration is not None
        assert bool(perception.doubt) == warned
        assert ("pose-1" in perception.doubt) == warned


DAMAGE: list[tuple[dict[str, Any], str]] = [
    ({"version": 2}, "version"),
    ({"gian": 1}, "did you mean 'gain'"),
    ({"gain": None}, "gain"),
    ({"gain": {"left": [[1.0] * 10] * 10}}, "right"),
    ({"gain": {"left": [[1.0] * 10] * 10, "right": [[1.0] * 10] * 9}}, "gain.right"),
    ({"gain": {"left": [[1.0] * 10] * 10, "right": [[0.0] * 10] * 10}}, "gain"),
    ({"gain": {"left": [[1.0] * 10] * 10, "right": [[float("nan")] * 10] * 10}}, "gain.right"),
    ({"bias": {"horizontal": 1.0, "vertical": 0.0, "angle": 0.0}}, "bias.horizontal"),
    ({"bias": {"horizontal": True, "vertical": 0.0, "angle": 0.0}}, "bias.horizontal"),
    ({"bias_stddev": {"horizontal": 0.0, "vertical": -1e-4, "angle": 0.0}}, "bias_stddev.vertical"),
    ({"load_shift": float("inf")}, "load_shift"),
    ({"load_shift": 1000.0}, "load_shift"),
    ({"load_shift": 10**400}, "load_shift"),
    ({"dead": [[0, 0, 10]]}, "dead"),
    ({"dead": [[0, 0, -1]]}, "dead"),
    ({"dead": "all"}, "dead"),
    ({"rig": "one"}, "rig"),
    ({"simulated": 1}, "simulated"),
]


@pytest.mark.parametrize(("change", "named"), DAMAGE)
def test_a_damaged_file_is_refused_by_its_key(tmp_path: Path, change: dict[str, Any], named: str) -> None:
    path = tmp_path / "pads.yaml"
    full().save(path)
    content = yaml.safe_load(path.read_text(encoding="utf-8")) | change
    write_yaml(path, content)
    with pytest.raises(SensorCalibrationError, match=named) as caught:
        TactileCalibration.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "5", "[1, 2]", "a: [", "!!python/object/apply:os.system [ls]", "\x00", "[" * 5000, "version: 1"]
)
def test_files_that_are_not_calibrations_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "pads.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SensorCalibrationError):
        TactileCalibration.load(path)
    with pytest.raises(SensorCalibrationError, match="folder"):
        TactileCalibration.load(tmp_path)
    with pytest.raises(FileNotFoundError):
        TactileCalibration.load(tmp_path / "none.yaml")
