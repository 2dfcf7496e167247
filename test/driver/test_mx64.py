# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import math

import pytest

from deltacharger_core.machine import POSITION_P_GAIN, SERVO_STIFFNESS, STIFFNESS_PER_GAIN
from deltacharger_driver.errors import DriverError, RangeError
from deltacharger_driver.servos.mx64 import (
    CURRENT_UNIT,
    REGISTERS,
    TICK,
    angle_to_ticks,
    current_to_counts,
    indirect_address,
    indirect_data,
    ticks_to_angle,
)


def test_no_two_registers_overlap():
    taken: dict[int, str] = {}
    blocks = {f"indirect address {n}": (indirect_address(n), 2) for n in range(56)}
    blocks |= {f"indirect data {n}": (indirect_data(n), 1) for n in range(56)}
    blocks |= {name: (register.address, register.size) for name, register in REGISTERS.items()}
    for name, (address, size) in blocks.items():
        for place in range(address, address + size):
            assert place not in taken, f"{name} overlaps {taken[place]}"
            taken[place] = name


def test_the_vendors_figures_give_the_assumed_stiffness():
    assert POSITION_P_GAIN == 434
    assert pytest.approx(SERVO_STIFFNESS, rel=2e-3) == POSITION_P_GAIN * STIFFNESS_PER_GAIN
    assert pytest.approx(29.3, abs=0.1) == REGISTERS["position_p_gain"].default * STIFFNESS_PER_GAIN


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("zero", [0, 2048, -511, 4095])
def test_every_tick_survives_the_round_trip(direction, zero):
    for ticks in range(-8192, 8193, 37):
        angle = ticks_to_angle(ticks, zero, direction)
        assert angle_to_ticks(angle, zero, direction) == ticks


def test_angle_convention():
    assert ticks_to_angle(2048, 2048, 1) == 0.0
    assert ticks_to_angle(3072, 2048, 1) == pytest.approx(math.pi / 2)
    assert ticks_to_angle(3072, 2048, -1) == pytest.approx(-math.pi / 2)
    assert abs(ticks_to_angle(angle_to_ticks(0.3, 2048, 1), 2048, 1) - 0.3) <= TICK / 2


def test_a_bound_is_never_rounded_up():
    for tenth_milliampere in range(0, 42_000, 7):
        current = tenth_milliampere * 1e-4
        assert current_to_counts(current) * CURRENT_UNIT <= current + 1e-9
        assert current_to_counts(-current) == -current_to_counts(current)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e9])
def test_a_value_outside_a_registers_range_is_refused_by_name(value):
    for encode in (lambda v: angle_to_ticks(v, 2048, 1), current_to_counts):
        with pytest.raises(RangeError) as caught:
            encode(value)
        assert isinstance(caught.value, DriverError)
        assert isinstance(caught.value, ValueError)
        assert caught.value.value is value or caught.value.value == value


def test_registers_refuse_too_large_numbers():
    with pytest.raises(RangeError):
        REGISTERS["bus_watchdog"].to_bytes(256)
    with pytest.raises(RangeError):
        REGISTERS["goal_current"].to_bytes(40_000)
    assert REGISTERS["goal_current"].from_bytes(REGISTERS["goal_current"].to_bytes(-1)) == -1
