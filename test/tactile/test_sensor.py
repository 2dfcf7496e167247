# SPDX-License-Identifier: Apache-2.0
"""The sensor chain and the source that a world samples."""

from __future__ import annotations

import dataclasses
from typing import Any
from unittest import mock

import numpy as np
import pytest

from deltacharger_tactile.contact import ContactModel
from deltacharger_tactile.parameters import SensorParameters, TactileParameters
from deltacharger_tactile.second.source import SecondSource
from deltacharger_tactile.sensor import Dockings, Rig, Sensor
from deltacharger_tactile.source import ContactSource

PERFECT = SensorParameters(
    hysteresis=0.0, creep=0.0, gain_spread=0.0, cross_talk=0.0, fixed_offset=0.0, docking_offset=0.0,
    noise=0.0, noise_gain=0.0, dead_taxels=0,
)  # fmt: skip


def sensor(parameters: SensorParameters, seed: int = 1) -> tuple[Sensor, TactileParameters, Rig]:
    family = dataclasses.replace(TactileParameters(), sensor=parameters)
    rig = Rig.draw(family, seed)
    return Sensor(parameters, rig, np.random.default_rng(seed)), family, rig


def test_a_perfect_sensor_reads_force_plus_pedestal_within_one_code() -> None:
    chain, _, _ = sensor(PERFECT)
    force = np.random.default_rng(0).uniform(0.0, 9.0, (1, 2, 10, 10))
    raw = chain.read(force, None, 0.0, 1 / 120)
    assert np.abs(raw - force - PERFECT.pedestal).max() <= 0.5 * 9.5 / 1023 + 1e-12


def test_readings_stay_within_the_scale_and_on_its_codes() -> None:
    chain, family, rig = sensor(SensorParameters(dead_taxels=2))
    docking = Dockings.draw(family, np.random.default_rng(2))
    raw = chain.read(np.full((1, 2, 10, 10), 50.0), docking, 1.0, 1 / 120)[0]
    assert np.array_equal(np.isnan(raw), rig.dead)
    assert rig.dead.sum() == 2
    codes = raw[~rig.dead] * 1023 / 9.5
    assert 0.0 <= codes.min() <= codes.max() <= 1023 + 1e-9
    assert np.allclose(codes, np.round(codes), atol=1e-9)


def test_creep_grows_by_its_share_per_decade() -> None:
    chain, _, _ = sensor(dataclasses.replace(PERFECT, creep=0.03, bits=16))
    force = np.full((1, 2, 10, 10), 5.0)
    early, late = (chain.read(force, None, t, 1 / 120)[0, 0, 0, 0] - 0.5 for t in (99.0, 999.0))
    assert abs((late - early) / 5.0 - 0.03) < 1e-3


def test_noise_has_the_stated_size_and_memory() -> None:
    chain, _, _ = sensor(dataclasses.replace(PERFECT, noise=0.08, pedestal=0.5))
    raw, step = np.stack([chain.read(None, None, 0.0, 1 / 120)[0] for _ in range(600)]) - 0.5, 6
    assert raw.std() == pytest.approx(0.08, abs=0.004)
    memory = np.mean(raw[step:] * raw[:-step]) / raw.var()
    assert memory == pytest.approx(0.3 * np.exp(-step / 120 / 0.25), abs=0.05)


def test_a_source_reads_force_only_in_contact() -> None:
    source = ContactSource(rig_seed=4, seed=9)
    free = np.mean([source.sample(i / 120, None, 0.0) for i in range(60)], axis=0)
    assert abs(np.nanmean(free) - 0.5) < 0.05
    jitter = source.begin_docking()
    assert np.all(np.abs(jitter) < [0.005, 0.005, 0.02])
    readings = source.sample(1.0, jitter, 70.0) - free
    assert 60.0 < np.nansum(readings) < 90.0
    after = source.sample(2.0, None, 0.0) - free
    assert np.nanmax(np.abs(after)) < 0.6


@pytest.mark.parametrize("kind", [ContactSource, SecondSource])
def test_the_first_touch_builds_no_model(kind: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    source = kind()
    monkeypatch.setattr(f"{kind.__module__}._model", None)  # it takes longer than emulated servos may be silent
    assert np.nansum(source.sample(0.0, (0.0, 0.0, 0.05), 15.0)) > 10.0


def test_seeds_determine_the_run() -> None:
    def run(rig: int, seed: int) -> Any:
        source = ContactSource(rig_seed=rig, seed=seed)
        jitter = source.begin_docking()
        return np.nan_to_num([source.sample(i / 120, jitter, 60.0) for i in range(3)], nan=-1.0)

    first, again, other, device = (run(*seeds) for seeds in ((1, 2), (1, 2), (1, 3), (2, 2)))
    assert (first == again).all()
    assert (first != other).any()
    assert (first != device).any()


def test_frames_at_rest_share_one_solution_with_equal_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = mock.Mock(side_effect=ContactModel.solve, spec=ContactModel.solve)
    monkeypatch.setattr(ContactModel, "solve", lambda *args: solve(*args))
    runs = []
    for forget in (False, True):
        source = ContactSource(rig_seed=4, seed=9)
        jitter, readings = source.begin_docking(), []
        for index, force in enumerate((50.0, 50.0, 50.0, 60.0, 50.0)):
            source._pressed = None if forget else source._pressed
            readings.append(source.sample(index / 120, jitter, force))
        runs.append(np.array(readings))
    assert np.array_equal(*runs, equal_nan=True)
    assert solve.call_count == 3 + 5
