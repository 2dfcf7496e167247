# SPDX-License-Identifier: Apache-2.0
"""battery and target_battery report exactly what the power stage measures."""

from __future__ import annotations

import math

import pytest
from sensor_msgs.msg import BatteryState

from deltacharger_driver.board.protocol import Power, PowerSample
from deltacharger_driver.board.tactile_node import own_battery, target_battery

UNKNOWN = BatteryState.POWER_SUPPLY_STATUS_UNKNOWN
CHARGING = BatteryState.POWER_SUPPLY_STATUS_CHARGING
DISCHARGING = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
NOT_CHARGING = BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING
NAN = math.nan


def sample(battery: float = 26.0, target: float = 24.0, current: float = 0.0, closed: bool = False) -> PowerSample:
    return PowerSample(1.0, Power(battery, target, current, closed, 0))


@pytest.mark.parametrize(
    ("power", "own", "target"),
    [
        (None, UNKNOWN, UNKNOWN),
        (sample(target=NAN), UNKNOWN, UNKNOWN),
        (sample(), UNKNOWN, NOT_CHARGING),
        (sample(current=10.0, closed=True), DISCHARGING, CHARGING),
        (sample(current=0.2, closed=True), UNKNOWN, NOT_CHARGING),
        (sample(current=-3.0, closed=True), UNKNOWN, DISCHARGING),
        (sample(current=10.0), DISCHARGING, CHARGING),
        (sample(current=NAN, closed=True), UNKNOWN, UNKNOWN),
        (sample(battery=NAN, current=10.0, closed=True), UNKNOWN, CHARGING),
    ],
)
def test_the_status_follows_the_measured_current(power: PowerSample | None, own: int, target: int) -> None:
    assert own_battery(power).power_supply_status == own
    assert target_battery(power).power_supply_status == target


@pytest.mark.parametrize(
    ("volts", "present"), [(NAN, False), (0.0, False), (5.0, False), (10.0, True), (-24.0, True), (29.8, True)]
)
def test_a_battery_is_present_above_the_voltage_of_a_probe(volts: float, present: bool) -> None:
    for battery in (own_battery(sample(battery=volts)), target_battery(sample(target=volts))):
        assert battery.present == present
        assert battery.voltage == pytest.approx(volts, nan_ok=True)


@pytest.mark.parametrize("power", [None, sample(), sample(current=10.0, closed=True)])
def test_unmeasured_values_are_unknown(power: PowerSample | None) -> None:
    for battery in (own_battery(power), target_battery(power)):
        for name in ("temperature", "charge", "capacity", "design_capacity", "percentage"):
            assert math.isnan(getattr(battery, name)), name
        assert battery.power_supply_health == battery.power_supply_technology == UNKNOWN
    assert math.isnan(own_battery(power).current), "it feeds servos and computer, too"


def test_the_current_of_the_target_is_positive_into_it() -> None:
    assert target_battery(sample(current=10.0, closed=True)).current == 10.0
    assert math.isnan(target_battery(sample(target=NAN, current=0.0)).current)
