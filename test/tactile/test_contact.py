# SPDX-License-Identifier: Apache-2.0
"""Laws of the contact model, the sensor chain, the source that a world samples, and data sets."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deltacharger_tactile
from deltacharger_core.machine import DOCKING_JITTER
from deltacharger_sim.pads import ContactSource, Dockings, Rig, Sensor, generate_continuous
from deltacharger_tactile import contact, dataset, default_model, errors
from deltacharger_tactile.parameters import PadContactParameters, SensorParameters, TactileParameters

MODEL = contact.ContactModel()
V = 1.2e-3 * (9 - 2 * np.arange(10))  # taxel centres: row 0 at +y, column 0 at +x


def poses(count: int, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.uniform([-0.012, -0.012, -0.35], [0.012, 0.012, 0.35], (count, 3))


def centre(pad: np.ndarray, axis: int) -> float:
    line = pad.sum(axis=1 - axis)
    return float(line @ V / line.sum())


def test_the_pads_carry_the_entire_force() -> None:
    force = np.linspace(5.0, 120.0, 200)
    taxels = MODEL.solve(poses(200), force, (0.001, 0.002))
    carried = taxels.sum(axis=(1, 2, 3))
    touching = carried > 0.0
    assert np.allclose(carried[touching], force[touching], rtol=1e-6)
    assert touching.mean() > 0.8
    assert taxels.min() >= 0.0


WAVES = contact.Waviness.draw(PadContactParameters(), np.random.default_rng(1))


def batch_equals_its_single_contacts(solve: Any, error: float) -> None:
    """The law of every contact model; the laboratory's has it, too."""
    many = poses(8, 3)
    batch = solve(many)
    for index, pose in enumerate(many):
        assert np.allclose(batch[index], solve(pose)[0], atol=error)


def test_a_batch_equals_its_single_contacts() -> None:
    batch_equals_its_single_contacts(lambda pose: MODEL.solve(pose, 60.0, (0.0005, -0.001), WAVES), 1e-9)


def test_signs_follow_the_target() -> None:
    """The pads read pressure where trigonometry puts the ridge's points."""
    up = MODEL.solve((0.0, 0.005, 0.0), 60.0)[0]
    assert [centre(pad, 0) for pad in up] == pytest.approx([0.005] * 2, abs=4e-4)  # higher on both pads
    angle = np.radians(6.0)
    turned = MODEL.solve((0.0, 0.0, angle), 60.0)[0]
    # A turn from +x to +y lifts the target's ridge at +x (left pad) and lowers the one at −x (right pad).
    rise = 0.048 * np.tan(angle)
    assert [centre(pad, 0) for pad in turned] == pytest.approx([rise, -rise], abs=5e-4)
    # Within a pad the ridge rises toward +x, which is toward column 0.
    assert centre(turned[0][:, :3], 0) > centre(turned[0][:, 7:], 0) + 1e-3
    # A target far to +x leaves the −x end of the left pad.
    assert centre(MODEL.solve((0.016, 0.0, 0.0), 60.0)[0, 0], 1) > 1e-3
    # Tilts press the sides that the docstring states.
    tilted = MODEL.solve((0.0, 0.0, 0.0), 60.0, (0.0, 0.001))[0]
    assert tilted[0].sum() > tilted[1].sum() + 5.0
    assert centre(MODEL.solve((0.0, 0.0, 0.0), 60.0, (0.005, 0.0))[0, 0], 0) > 1e-5


def test_a_missed_ridge_exerts_no_force() -> None:
    assert not MODEL.solve((0.0, 0.05, 0.0), 60.0).any()
    assert not MODEL.solve((0.0, 0.0, 0.0), 0.0).any()
    one = MODEL.solve((0.0, 0.012, np.radians(12.0)), 60.0)[0]
    assert not one[0].any()
    assert one[1].sum() == pytest.approx(60.0)


def sensor(parameters: SensorParameters, seed: int = 1) -> tuple[Sensor, TactileParameters, Rig]:
    family = dataclasses.replace(TactileParameters(), sensor=parameters)
    rig = Rig.draw(family, seed)
    return Sensor(parameters, rig, np.random.default_rng(seed)), family, rig


def test_readings_stay_within_the_scale_and_on_its_codes() -> None:
    chain, family, rig = sensor(SensorParameters(dead_taxels=2))
    docking = Dockings.draw(family, np.random.default_rng(2))
    raw = chain.read(np.full((1, 2, 10, 10), 50.0), docking, 1.0, 1 / 120)[0]
    assert np.array_equal(np.isnan(raw), rig.dead)
    assert rig.dead.sum() == 2
    codes = raw[~rig.dead] * 1023 / 9.5
    assert 0.0 <= codes.min() <= codes.max() <= 1023 + 1e-9
    assert np.allclose(codes, np.round(codes), atol=1e-9)


def seeds_determine_readings_and_force_is_read_only_in_contact(kind: Any, least: float) -> None:
    """The law of every source of frames; the laboratory's has it, too."""

    def run(rig: int, seed: int) -> Any:
        source = kind(rig_seed=rig, seed=seed)
        free = [source.sample(i / 120, None, 0.0) for i in range(30)]
        jitter = source.begin_docking()
        assert np.all(np.abs(jitter) < [0.005, 0.005, 0.02])
        pressed = [source.sample(1.0 + i / 120, jitter, 70.0) for i in range(3)]
        return np.array([*free, *pressed, source.sample(9.0, None, 0.0)])

    first, again, other, device = (run(*seeds) for seeds in ((1, 2), (1, 2), (1, 3), (2, 2)))
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(first, other, equal_nan=True)
    assert not np.array_equal(np.isnan(first), np.isnan(device))
    free = first[:30].mean(axis=0)
    assert np.nansum(first[30] - free) > least
    assert np.nanmax(np.abs(first[33] - free)) < 0.7


def test_seeds_determine_readings_and_force_is_read_only_in_contact() -> None:
    seeds_determine_readings_and_force_is_read_only_in_contact(ContactSource, 60.0)


# Data sets and models store this digest: a changed default needs a new model and new figures in docs/tactile.md.
FROZEN_DEFAULTS = "a9414fdef7f55adb"
FROZEN = json.loads((Path(deltacharger_tactile.__file__).parent / "frozen.json").read_text())


def test_the_defaults_match_the_frozen_parameters() -> None:
    assert TactileParameters().digest() == FROZEN["digest"] == FROZEN_DEFAULTS
    assert json.loads(TactileParameters().to_json()) == FROZEN["parameters"]
    assert default_model().about["parameters"] == FROZEN_DEFAULTS
    assert TactileParameters().docking.position_jitter == DOCKING_JITTER


def test_a_seed_determines_the_data_set(tmp_path: Path) -> None:
    data, again = (generate_continuous(rigs=(2, 3), count=20, seed=8) for _ in range(2))
    other = generate_continuous(rigs=(2, 3), count=20, seed=9)
    assert np.array_equal(data.left, again.left)
    assert not np.array_equal(data.left, other.left)
    data.save(tmp_path / "set.npz")
    loaded = dataset.Dataset.load(tmp_path / "set.npz")
    assert loaded.meta == data.meta
    assert loaded.meta["digest"] == TactileParameters().digest()
    for name in ("left", "tare", "contact_pose", "session", "force"):
        assert np.array_equal(getattr(loaded, name), getattr(data, name))


Arrays = dict[str, Any]


@pytest.fixture(scope="module")
def arrays(tmp_path_factory: pytest.TempPathFactory) -> Arrays:
    path = tmp_path_factory.mktemp("data") / "good.npz"
    generate_continuous(rigs=(4, 5), count=10, seed=1).save(path)
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def test_missing_optional_arrays_are_unknown(arrays: Arrays, tmp_path: Path) -> None:
    needed = {name: value for name, value in arrays.items() if name not in ("dead", "contact_pose", "force")}
    np.savez(tmp_path / "other.npz", **needed)
    data = dataset.Dataset.load(tmp_path / "other.npz")
    assert not data.dead.any()
    assert np.isnan(data.force).all()
    assert np.array_equal(data.poses()[:, 2], data.angle)


def spoilt(value: float) -> Callable[[Any], Any]:
    def change(array: Any) -> Any:
        array.reshape(len(array), -1)[3, 0] = value
        return array

    return change


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("left", None, "no array left"),
        ("meta", lambda meta: np.array(json.dumps({"version": 99})), "version 1"),
        ("left", lambda left: left.reshape(-1, 100), "has shape"),
        ("left", spoilt(np.nan), "row 3 of left"),
        ("angle", lambda angle: np.full_like(angle, -3.0), "row 0 of angle: -3.0 .* degrees"),
        ("contact_pose", spoilt(10.0), r"row 3 of contact_pose \(horizontal\): 10.0 .* millimetres"),
    ],
)
def test_a_mistake_is_named(arrays: Arrays, tmp_path: Path, name: str, change: Any, words: str) -> None:
    wrong = {key: value for key, value in arrays.items() if key != name or change}
    if change:
        wrong[name] = change(wrong[name].copy())
    np.savez(tmp_path / "bad.npz", **wrong)
    with pytest.raises(errors.DatasetError, match=words):
        dataset.Dataset.load(tmp_path / "bad.npz")
