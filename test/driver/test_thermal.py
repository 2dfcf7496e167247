# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import pytest

from deltacharger_driver.servos.thermal import HEAT_LIMIT, ThermalModel, reserve


def test_the_constants_match_their_sources():
    assert reserve(0.0, 0.0) == math.inf
    assert reserve(0.0, 0.5) >= 14_400
    assert 60 <= reserve(0.0, 3.0) <= 180
    assert 30 * 60 <= reserve(0.0, 0.8) <= 45 * 60


def test_more_current_or_more_heat_never_lasts_longer():
    currents = [0.01 * n for n in range(400)]
    for heat in (0.0, 300.0, 900.0):
        times = [reserve(heat, current) for current in currents]
        assert times == sorted(times, reverse=True)
    for current in (0.6, 1.0, 3.0):
        times = [reserve(heat, current) for heat in range(0, 1100, 50)]
        assert times == sorted(times, reverse=True)


@pytest.mark.parametrize("current", [0.7, 1.5, 3.0])
def test_the_model_reaches_the_limit_when_predicted(current):
    model = ThermalModel(smoothing=0.0)
    model.update(current, 0.0)
    promised = model.reserve()
    elapsed = 0.0
    while model.reserve() > 0.0:
        model.update(current, 1.0)
        elapsed += 1.0
    assert elapsed == pytest.approx(promised, abs=1.5)


def test_it_cools_without_current():
    model = ThermalModel()
    model.update(3.0, 60.0)
    hot = model.heat
    model.update(0.0, 4000.0)
    assert model.heat == pytest.approx(hot / math.e)
    assert model.reserve() == math.inf


def test_missing_data_never_cool_the_model():
    model = ThermalModel()
    model.update(2.0, 10.0)
    before = model.heat
    model.update(math.nan, 10.0)
    assert model.heat > before


def test_unknown_stays_unknown():
    model = ThermalModel()
    assert math.isnan(model.reserve())
    model.update(math.nan, 1.0)
    assert math.isnan(model.reserve())
    assert math.isnan(reserve(math.nan, 1.0))


def test_a_hot_servo_starts_with_the_heat_of_its_temperature():
    model = ThermalModel()
    model.start_at(math.nan)
    assert model.heat == 0.0
    model.start_at(80.0)
    assert model.heat == HEAT_LIMIT
    model.update(1.0, 0.0)
    assert model.reserve() == 0.0
