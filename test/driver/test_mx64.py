# SPDX-License-Identifier: Apache-2.0
"""The servo's figures: registers, units, stiffness and heat."""

from __future__ import annotations

import math

import pytest

from deltacharger_core.machine import POSITION_P_GAIN, SERVO_STIFFNESS, STIFFNESS_PER_GAIN
from deltacharger_core.servo_types import MX_64, SPEEDS, TYPES, ServoType
from deltacharger_driver.errors import RangeError
from deltacharger_driver.servos import registers
from deltacharger_driver.servos.registers import REGISTERS, TICK
from deltacharger_driver.servos.report import ThermalModel, reserve


def test_no_two_registers_overlap() -> None:
    taken: dict[int, str] = {}
    blocks = {f"indirect address {n}": (registers.indirect_address(n), 2) for n in range(56)}
    blocks |= {f"indirect data {n}": (registers.indirect_data(n), 1) for n in range(56)}
    blocks |= {name: (register.address, register.size) for name, register in REGISTERS.items()}
    for name, (address, size) in blocks.items():
        for place in range(address, address + size):
            assert place not in taken, f"{name} overlaps {taken[place]}"
            taken[place] = name


def test_the_speeds_are_those_of_the_vendors_table() -> None:
    assert SPEEDS == {0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000}


def test_the_vendors_figures_give_the_assumed_stiffness() -> None:
    assert POSITION_P_GAIN == 434
    assert pytest.approx(SERVO_STIFFNESS, rel=2e-3) == POSITION_P_GAIN * STIFFNESS_PER_GAIN
    assert pytest.approx(29.3, abs=0.1) == REGISTERS["position_p_gain"].default * STIFFNESS_PER_GAIN


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("zero", [0, 2048, -511, 4095])
def test_every_tick_survives_the_round_trip(direction: int, zero: int) -> None:
    for ticks in range(-8192, 8193, 37):
        angle = registers.ticks_to_angle(ticks, zero, direction)
        assert registers.angle_to_ticks(angle, zero, direction) == ticks


def test_angle_convention() -> None:
    assert registers.ticks_to_angle(2048, 2048, 1) == 0.0
    assert registers.ticks_to_angle(3072, 2048, 1) == pytest.approx(math.pi / 2)
    assert registers.ticks_to_angle(3072, 2048, -1) == pytest.approx(-math.pi / 2)
    assert abs(registers.ticks_to_angle(registers.angle_to_ticks(0.3, 2048, 1), 2048, 1) - 0.3) <= TICK / 2


@pytest.mark.parametrize("kind", TYPES.values(), ids=lambda kind: kind.name)
def test_a_bound_is_never_rounded_up(kind: ServoType) -> None:
    for tenth_milliampere in range(0, int(1e4 * kind.largest_current), 7):
        current = tenth_milliampere * 1e-4
        counts = registers.current_to_counts(current, kind)
        assert current - kind.current_unit < counts * kind.current_unit <= current + 1e-9
        assert registers.current_to_counts(-current, kind) == -counts


def test_registers_refuse_too_large_numbers() -> None:
    with pytest.raises(RangeError):
        REGISTERS["bus_watchdog"].to_bytes(256)
    with pytest.raises(RangeError):
        REGISTERS["goal_current"].to_bytes(40_000)
    assert REGISTERS["goal_current"].from_bytes(REGISTERS["goal_current"].to_bytes(-1)) == -1


def test_usual_currents_last_for_hours_and_half_an_hour() -> None:
    assert reserve(0.0, 0.5, MX_64) >= 14_400
    assert 30 * 60 <= reserve(0.0, 0.8, MX_64) <= 45 * 60


def test_more_current_or_more_heat_never_lasts_longer() -> None:
    currents = [0.01 * n for n in range(400)]
    for heat in (0.0, 300.0, 900.0):
        times = [reserve(heat, current, MX_64) for current in currents]
        assert times == sorted(times, reverse=True)
    for current in (0.6, 1.0, 3.0):
        times = [reserve(heat, current, MX_64) for heat in range(0, 1100, 50)]
        assert times == sorted(times, reverse=True)


@pytest.mark.parametrize("current", [0.7, 1.5, 3.0])
def test_the_model_reaches_the_limit_when_predicted(current: float) -> None:
    model = ThermalModel(MX_64, smoothing=0.0)
    model.update(current, 0.0)
    promised = model.reserve()
    elapsed = 0.0
    while model.reserve() > 0.0:
        model.update(current, 1.0)
        elapsed += 1.0
    assert elapsed == pytest.approx(promised, abs=1.5)


def test_it_cools_without_current() -> None:
    model = ThermalModel(MX_64)
    model.update(3.0, 60.0)
    hot = model.heat
    model.update(0.0, 4000.0)
    assert model.heat == pytest.approx(hot / math.e)
    assert model.reserve() == math.inf


def test_missing_data_never_cool_the_model() -> None:
    model = ThermalModel(MX_64)
    model.update(2.0, 10.0)
    before = model.heat
    model.update(math.nan, 10.0)
    assert model.heat > before


def test_unknown_stays_unknown() -> None:
    model = ThermalModel(MX_64)
    assert math.isnan(model.reserve())
    model.update(math.nan, 1.0)
    assert math.isnan(model.reserve())
    assert math.isnan(reserve(math.nan, 1.0, MX_64))


def test_a_hot_servo_starts_with_the_heat_of_its_temperature() -> None:
    model = ThermalModel(MX_64)
    model.start_at(math.nan)
    assert model.heat == 0.0
    model.start_at(80.0)
    model.update(1.0, 0.0)
    assert model.reserve() == 0.0
