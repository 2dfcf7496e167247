# SPDX-License-Identifier: Apache-2.0
"""The sensor chain and the source that a world samples."""

from __future__ import annotations

import dataclasses
from typing import Any

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
    parameters = SensorParameters(dead_taxels=2)
    chain, family, rig = sensor(parameters)
    docking = Dockings.draw(family, np.random.default_rng(2))
    raw = chain.read(np.full((1, 2, 10, 10), 50.0), docking, 1.0, 1 / 120)[0]
    assert np.array_equal(np.isnan(raw), rig.dead)
    assert rig.dead.sum() == 2
    live = raw[~rig.dead]
    assert live.max() <= 9.5 + 1e-12
    assert live.min() >= 0.0
    codes = live * 1023 / 9.5
    assert np.allclose(codes, np.round(codes), atol=1e-9)


def test_creep_grows_by_its_share_per_decade() -> None:
    chain, _, _ = sensor(dataclasses.replace(PERFECT, creep=0.03, bits=16))
    force = np.full((1, 2, 10, 10), 5.0)
    early, late = (chain.read(force, None, t, 1 / 120)[0, 0, 0, 0] - 0.5 for t in (99.0, 999.0))
    assert abs((late - early) / 5.0 - 0.03) < 1e-3


def test_noise_has_the_stated_size_and_memory() -> None:
    parameters = dataclasses.replace(PERFECT, noise=0.08, pedestal=0.5)
    chain, _, _ = sensor(parameters)
    raw = np.stack([chain.read(None, None, 0.0, 1 / 120)[0] for _ in range(600)]) - 0.5
    assert abs(raw.std() - 0.08) < 0.004
    step = 6
    memory = np.mean(raw[step:] * raw[:-step]) / raw.var()
    assert abs(memory - 0.3 * np.exp(-step / 120 / 0.25)) < 0.05


def test_a_source_reads_force_only_in_contact() -> None:
    source = ContactSource(rig_seed=4, seed=9)
    free = np.mean([source.sample(i / 120, None, 0.0) for i in range(60)], axis=0)
    assert abs(np.nanmean(free) - 0.5) < 0.05
    dx, dy, turn = source.begin_docking()
    assert abs(dx) < 0.005
    assert abs(dy) < 0.005
    assert abs(turn) < 0.02
    readings = source.sample(1.0, (dx, dy, turn), 70.0) - free
    assert 60.0 < np.nansum(readings) < 90.0
    after = source.sample(2.0, None, 0.0) - free
    assert np.nanmax(np.abs(after)) < 0.6


@pytest.mark.parametrize("kind", [ContactSource, SecondSource])
def test_the_first_touch_builds_no_model(kind: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    source = kind()
    monkeypatch.setattr(f"{kind.__module__}._model", None)  # it takes longer than emulated servos may be silent
    assert np.nansum(source.sample(0.0, (0.0, 0.0, 0.05), 15.0)) > 10.0


def test_seeds_determine_the_run() -> None:
    def run(rig: int, seed: int) -> list[np.ndarray]:
        source = ContactSource(rig_seed=rig, seed=seed)
        jitter = source.begin_docking()
        return [np.array(source.sample(i / 120, jitter, 60.0)) for i in range(3)]

    assert np.array_equal(run(1, 2), run(1, 2), equal_nan=True)
    assert not np.array_equal(run(1, 2), run(1, 3), equal_nan=True)
    assert not np.array_equal(run(1, 2), run(2, 2), equal_nan=True)


def test_frames_at_rest_share_one_solution_with_equal_readings(monkeypatch: pytest.MonkeyPatch) -> None:
    solved = []
    solve = ContactModel.solve

    def counted(*args: Any, **options: Any) -> Any:
        solved.append(args)
        return solve(*args, **options)

    monkeypatch.setattr(ContactModel, "solve", counted)

    def run(forget: bool) -> list[Any]:
        source, readings = ContactSource(rig_seed=4, seed=9), []
        for contact in range(2):
            x, y, turn = source.begin_docking()
            for index, force in enumerate((50.0, 50.0, 50.0, 60.0, 50.0)):
                source._pressed = None if forget else source._pressed
                readings.append(source.sample(contact + index / 120, (x, y, turn), force))
            source.sample(contact + 0.5, None, 0.0)
        return readings

    shared, each = run(False), run(True)
    assert np.array_equal(shared, each, equal_nan=True)
    assert len(solved) == 2 * 3 + 2 * 5
