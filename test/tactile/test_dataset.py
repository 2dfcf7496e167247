# SPDX-License-Identifier: Apache-2.0
"""Data files of other programs: optional arrays, and the error for each kind of mistake."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_tactile import npz
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.errors import DatasetError
from deltacharger_tactile.generator import generate_continuous

Arrays = dict[str, Any]


@pytest.fixture(scope="module")
def arrays(tmp_path_factory: pytest.TempPathFactory) -> Arrays:
    path = tmp_path_factory.mktemp("data") / "good.npz"
    generate_continuous(rigs=(4, 5), count=10, seed=1).save(path)
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def written(path: Path, arrays: Arrays) -> Path:
    np.savez(path, **arrays)
    return path


def test_missing_optional_arrays_are_unknown(arrays: Arrays, tmp_path: Path) -> None:
    needed = {name: value for name, value in arrays.items() if name not in ("dead", "contact_pose", "force")}
    needed["meta"] = np.array("{}")
    data = Dataset.load(written(tmp_path / "other.npz", needed))
    assert not data.dead.any()
    assert np.isnan(data.contact_pose).all()
    assert np.isnan(data.force).all()
    assert np.isnan(data.threshold)
    assert not data.simulated
    assert np.array_equal(data.poses()[:, 2], data.angle)


def drop(name: str) -> Callable[[Arrays], None]:
    return lambda arrays: arrays.pop(name)


def put(name: str, change: Callable[[Any], Any]) -> Callable[[Arrays], None]:
    def apply(arrays: Arrays) -> None:
        arrays[name] = change(arrays[name].copy())

    return apply


def spoil(name: str, value: float) -> Callable[[Arrays], None]:
    def change(array: Any) -> Any:
        array.reshape(len(array), -1)[3, 0] = value
        return array

    return put(name, change)


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        (drop("left"), "no array left"),
        (drop("meta"), "no array meta"),
        (put("meta", lambda meta: np.array("[1]")), "no JSON object"),
        (put("meta", lambda meta: np.array(json.dumps({"version": 99}))), "version 1"),
        (put("left", lambda left: left.reshape(-1, 100)), "has shape"),
        (put("angle", lambda angle: np.zeros(0)), "no rows"),
        (put("rig", lambda rig: rig.astype(float)), "integers"),
        (put("current", lambda current: current.astype(str)), "must hold numbers"),
        (spoil("left", np.nan), "row 3 of left"),
        (spoil("angle", np.inf), "row 3 of angle"),
        (put("angle", np.degrees), "rad"),
        (put("vertical", lambda vertical: 1e3 * vertical), "m"),
        (put("attempt", lambda attempt: attempt % 10), "two values of rig"),
        (put("left", lambda left: left.astype(object)), "damaged"),
    ],
)
def test_a_mistake_is_named(arrays: Arrays, tmp_path: Path, mistake: Callable[[Arrays], None], words: str) -> None:
    wrong = dict(arrays)
    mistake(wrong)
    with pytest.raises(DatasetError, match=words):
        Dataset.load(written(tmp_path / "bad.npz", wrong))


def test_damaged_files_are_refused(arrays: Arrays, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = written(tmp_path / "good.npz", arrays).read_bytes()
    for number, content in enumerate((b"", b"not an archive", good[: len(good) // 2], good[:-100])):
        path = tmp_path / f"{number}.npz"
        path.write_bytes(content)
        with pytest.raises(DatasetError):
            Dataset.load(path)
    with pytest.raises(DatasetError, match="folder"):
        Dataset.load(tmp_path)
    with pytest.raises(FileNotFoundError):
        Dataset.load(tmp_path / "none.npz")
    monkeypatch.setattr(npz, "LARGEST_DATASET", 1000)
    with pytest.raises(DatasetError, match="more than"):
        Dataset.load(tmp_path / "good.npz")


def test_a_false_shape_is_refused(arrays: Arrays, tmp_path: Path) -> None:
    path = written(tmp_path / "good.npz", arrays)
    false_shape = tmp_path / "false_shape.npz"
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(false_shape, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "tare.npy":
                content = content.replace(b"(20, 2, 10, 10)", b"(9**15, 2,10,9)")
            target.writestr(name, content)
    with pytest.raises(DatasetError):
        Dataset.load(false_shape)
