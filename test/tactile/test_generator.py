# SPDX-License-Identifier: Apache-2.0
"""Data sets: the frozen parameters, both protocols, seeds, and files of other programs."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deltacharger_tactile
from deltacharger_core.machine import DOCKING_JITTER
from deltacharger_sim.pads import generate_continuous, generate_paper
from deltacharger_tactile import default_model
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.errors import DatasetError
from deltacharger_tactile.parameters import TactileParameters

# Data sets and models store this digest: a changed default needs a new model and new figures in docs/tactile.md.
FROZEN_DEFAULTS = "a9414fdef7f55adb"
FROZEN = json.loads((Path(deltacharger_tactile.__file__).parent / "frozen.json").read_text())


def test_the_defaults_match_the_frozen_parameters() -> None:
    assert TactileParameters().digest() == FROZEN["digest"] == FROZEN_DEFAULTS
    assert json.loads(TactileParameters().to_json()) == FROZEN["parameters"]
    assert default_model().about["parameters"] == FROZEN_DEFAULTS
    assert TactileParameters().docking.position_jitter == DOCKING_JITTER


@pytest.mark.rest
def test_the_papers_protocol() -> None:
    data = generate_paper(rigs=(3, 4), seed=5)
    assert len(data) == 2 * 1100
    first, positions = data.rig == 3, data.subset == 1
    angles = np.round(np.degrees(data.angle[first & ~positions]))
    assert {int(k): int((angles == k).sum()) for k in np.unique(angles)} == dict.fromkeys(range(6), 100)
    pairs = np.unique(np.round(1e3 * np.column_stack([data.horizontal, data.vertical])[first & positions]), axis=0)
    assert (len(pairs), (first & positions).sum(), data.angle[positions].any()) == (25, 500, False)
    assert len(np.unique(data.attempt)) == len(data)
    assert not set(data.session[first]) & set(data.session[~first])
    lit = np.concatenate([data.left, data.right])
    assert lit[lit > 0].min() >= 1.0
    assert 0.4 <= data.current.min() <= data.current.max() <= 0.5


def test_the_continuous_protocol_is_signed_and_jittered() -> None:
    data = generate_continuous(rigs=(6,), count=300, seed=1)
    assert set(data.subset) == {-1}
    assert data.angle.min() < -0.3 < 0.3 < data.angle.max()
    jitter = data.contact_pose - np.column_stack([data.horizontal, data.vertical, data.angle])
    assert np.allclose(jitter.std(axis=0), [1e-3, 1e-3, np.radians(0.19)], rtol=0.2)
    left, right = data.robot_frames()
    assert np.array_equal(np.isnan(np.stack([left, right], axis=1)), data.dead)


def test_a_seed_determines_the_data_set(tmp_path: Path) -> None:
    data, again = (generate_continuous(rigs=(2, 3), count=20, seed=8) for _ in range(2))
    other = generate_continuous(rigs=(2, 3), count=20, seed=9)
    assert np.array_equal(data.left, again.left)
    assert not np.array_equal(data.left, other.left)
    data.save(tmp_path / "set.npz")
    loaded = Dataset.load(tmp_path / "set.npz")
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
    needed["meta"] = np.array("{}")
    np.savez(tmp_path / "other.npz", **needed)
    data = Dataset.load(tmp_path / "other.npz")
    assert not data.dead.any()
    assert np.isnan(data.contact_pose).all()
    assert np.isnan(data.force).all()
    assert np.isnan(data.threshold)
    assert not data.simulated
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
        ("rig", lambda rig: rig.astype(float), "integers"),
        ("left", spoilt(np.nan), "row 3 of left"),
        ("angle", lambda angle: np.full_like(angle, -3.0), "row 0 of angle: -3.0 .* degrees"),
        ("vertical", lambda vertical: np.full_like(vertical, 5.0), "row 0 of vertical: 5.0 .* millimetres"),
        ("contact_pose", spoilt(10.0), r"row 3 of contact_pose \(horizontal\): 10.0 .* millimetres"),
    ],
)
def test_a_mistake_is_named(arrays: Arrays, tmp_path: Path, name: str, change: Any, words: str) -> None:
    wrong = {key: value for key, value in arrays.items() if key != name or change}
    if change:
        wrong[name] = change(wrong[name].copy())
    np.savez(tmp_path / "bad.npz", **wrong)
    with pytest.raises(DatasetError, match=words):
        Dataset.load(tmp_path / "bad.npz")
