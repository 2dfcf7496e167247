# SPDX-License-Identifier: Apache-2.0
"""The servo's figures: registers, units, stiffness and heat."""

from __future__ import annotations

import math

import pytest

from deltacharger_core.servo_types import MX_64, TYPES, ServoType
from deltacharger_driver.servos import registers
from deltacharger_driver.servos.controller import ThermalModel
from deltacharger_driver.servos.registers import REGISTERS, TICK


def test_no_two_registers_overlap() -> None:
    taken: dict[int, str] = {}
    blocks = {f"indirect address {n}": (registers.indirect_address(n), 2) for n in range(56)}
    blocks |= {f"indirect data {n}": (registers.indirect_data(n), 1) for n in range(56)}
    blocks |= {name: (register.address, register.size) for name, register in REGISTERS.items()}
    for name, (address, size) in blocks.items():
        for place in range(address, address + size):
            assert place not in taken, f"{name} overlaps {taken[place]}"
            taken[place] = name


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


def test_missing_data_never_cool_the_model() -> None:
    model = ThermalModel(MX_64)
    model.update(2.0, 10.0)
    before = model.heat
    model.update(math.nan, 10.0)
    assert model.heat > before


def test_a_hot_servo_starts_with_the_heat_of_its_temperature() -> None:
    model = ThermalModel(MX_64)
    model.start_at(math.nan)
    assert model.heat == 0.0
    model.start_at(80.0)
    model.update(1.0, 0.0)
    assert model.reserve() == 0.0
