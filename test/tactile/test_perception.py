# SPDX-License-Identifier: Apache-2.0
"""Estimates on a robot without ROS: only fresh frames count, and invalid readings and files are refused."""

import dataclasses
import os
import threading
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deltacharger_sim.pads import ContactSource, generate_continuous
from deltacharger_tactile import MODEL_PATH, default_model
from deltacharger_tactile.calibration.rig import TactileCalibration
from deltacharger_tactile.classifiers import classifier
from deltacharger_tactile.perception import Frame, FrameWindow, Perception, PerceptionError, Refused

TRUTH = (0.001, 0.003, 0.08)


@cache
def docked() -> tuple[Any, ...]:
    """Tared frames (2, 10, 10) N of one simulated docking at TRUTH."""
    source = ContactSource(rig_seed=21, seed=3)
    tare = np.mean([source.sample(i / 120, None, 0.0) for i in range(60)], axis=0)
    source.begin_docking()
    return tuple(np.maximum(source.sample(1 + i / 120, TRUTH, 65.0) - tare, 0.0) for i in range(24))


def half_dead(pad: Any) -> Any:
    return np.where(np.arange(10) < 5, np.nan, pad)


def row_at_full_scale(pad: Any) -> Any:
    return np.where(np.arange(10)[:, None] == 4, 9.0, pad)


@pytest.mark.parametrize("both", [True, False])
@pytest.mark.parametrize(
    ("bad", "contact"),
    [(0.0, False), (np.nan, False), (1e30, False), (-5.0, False), (half_dead, True), (row_at_full_scale, True)],
)
def test_invalid_readings_are_out_of_range(bad: Any, contact: bool, both: bool) -> None:
    made = TactileCalibration(rig=3, load_shift=8.0, bias=np.full(3, 1e-3), bias_stddev=np.full(3, 1e-4))
    perception = dataclasses.replace(Perception.load(), calibration=made)
    left, right = (bad(pad) if callable(bad) else np.full((10, 10), bad) for pad in docked()[0])
    found = perception.predict(left, right if both else docked()[0][1])
    assert (found.in_range, found.sure, found.contact) == (False, False, contact or not both)
    if not found.contact:
        assert np.isnan([found.angle, found.vertical, found.horizontal, found.vertical_stddev]).all()
    good = perception.predict(*docked()[0])
    assert (good.contact, good.in_range, good.sure) == (True, True, True)


def test_a_calibration_moves_the_estimate_and_kills_taxels(tmp_path: Path) -> None:
    bias, dead = np.array([0.002, 0.0005, 0.01]), np.zeros((2, 10, 10), dtype=bool)
    dead[0, :3] = True
    raw = Perception.load().predict(*docked()[0])
    for made, name in (({"bias": bias, "bias_stddev": np.full(3, 1e-4)}, "biased"), ({"dead": dead}, "dead")):
        TactileCalibration(rig=4, **made).save(tmp_path / name)
    biased, crippled = (Perception.load(calibration=str(tmp_path / name)) for name in ("biased", "dead"))
    got = biased.predict(*docked()[0])
    assert (got.horizontal, got.angle) == pytest.approx((raw.horizontal - bias[0], raw.angle - bias[2]))
    assert biased.name.endswith("+rig4")
    blind = crippled.predict(*docked()[0])
    assert (blind.contact, blind.in_range, blind.sure) == (True, False, False)


@pytest.mark.parametrize("model", [None, "pose-1"])
def test_a_calibration_made_for_an_earlier_model_is_used_and_warned_of(tmp_path: Path, model: str | None) -> None:
    TactileCalibration(rig=7, model=model or default_model().name).save(tmp_path / "pads.yaml")
    perception = Perception.load(calibration=str(tmp_path / "pads.yaml"))
    assert perception.calibration is not None
    assert ("pose-1" in perception.doubt) == bool(perception.doubt) == bool(model)


def test_a_packaged_model_answers_and_a_failing_one_is_never_sure() -> None:
    usual = Perception.load()
    frame = docked()[0]
    tree = usual.answering("tree")
    assert tree.name == f"{usual.name}+tree" == Perception.load(classifiers="tree").name
    found = tree.predict(*frame)
    raw = usual.predict(*frame)
    assert (found.angle, found.vertical, found.sure) == (raw.angle, raw.vertical, raw.sure)
    for target, model in classifier.load("tree").items():
        np.testing.assert_allclose(getattr(found, f"{target}_probability"), model.predict_proba(frame[None])[0])
    for shares in ([[np.nan] * 6], [[0.5] * 6], []):
        broken: Any = {"angle": SimpleNamespace(predict_proba=lambda frames, shares=shares: shares)}
        got = dataclasses.replace(usual, classifiers=broken).predict(*frame)
        assert (got.sure, got.in_range) == (False, True)
        np.testing.assert_array_equal(got.angle_probability, usual.predict(*frame).angle_probability)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files to refuse; other faults are in the tests of each reader."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "cut.npz").write_bytes(MODEL_PATH.read_bytes()[:5000])
    generate_continuous(rigs=(1,), count=5, seed=1).save(folder / "data.npz")
    (folder / "zero").symlink_to("/dev/zero")
    os.mkfifo(folder / "pipe")
    return folder


@pytest.mark.parametrize("name", ["missing", "data.npz", "zero", "pipe", "cut.npz"])
@pytest.mark.parametrize("parameter", ["model", "calibration"])
def test_unusable_files_are_refused_with_their_parameter(folder: Path, parameter: str, name: str) -> None:
    path = str(folder / name)
    with pytest.raises(PerceptionError) as refused:
        Perception.load(**{parameter: path})
    assert refused.value.parameter == parameter
    assert len(refused.value.reason) > len(path) + 5


NOW = 1000.0


def frame(sampled: float) -> Frame:
    return Frame(sampled, None, 0, True, np.ones((10, 10)), np.ones((10, 10)))


def ask(window: FrameWindow, wanted: int, then: list[Frame]) -> list[Frame]:
    """Request `wanted` fresh frames; `then` arrives during the wait."""
    sender = threading.Timer(0.02, lambda: [window.add_frame(each) for each in then])
    sender.start()
    try:
        return window.fresh(wanted, 0.1 if wanted > len(then) or then[0].sampled < NOW else 60.0)
    finally:
        sender.join()


@pytest.mark.parametrize("jump", [0.0, 1.0, 3600.0])
def test_frames_from_before_the_request_never_count(jump: float) -> None:
    window = FrameWindow(lambda: NOW)
    for index in range(50):
        window.add_frame(frame(NOW + jump - 0.5 + 0.01 * index))  # the clock was set back by `jump` since
    after = [frame(NOW + 0.01 * index) for index in range(1, 4)]
    assert ask(window, 3, after) == after
    with pytest.raises(Refused, match="0 of 1"):
        ask(FrameWindow(lambda: NOW), 1, [frame(NOW - 0.2)])


@pytest.mark.parametrize(("stamp", "noun"), [(-0.3, "old"), (0.3, "ahead")])
def test_an_average_must_be_current(stamp: float, noun: str) -> None:
    with pytest.raises(Refused, match=noun):
        FrameWindow(lambda: NOW).average([frame(NOW + stamp)], 0.25)
    FrameWindow(lambda: NOW).average([frame(NOW + stamp)], 0.35)


def test_an_average_is_tared_and_as_dead_as_its_frames() -> None:
    window, whole, dead = FrameWindow(lambda: NOW), frame(NOW), frame(NOW)
    dead.left[:], dead.left[3, 4] = 3.0, np.nan
    left, right = window.average([dead, whole], 0.25)
    assert np.isnan(left).sum() == 1
    assert (left[0, 0], right[3, 4]) == (2.0, 1.0)
    with pytest.raises(Refused, match="tare"):
        window.average([dataclasses.replace(whole, tared=False), whole], 0.25)
