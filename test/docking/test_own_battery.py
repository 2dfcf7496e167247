# SPDX-License-Identifier: Apache-2.0
"""The charger's own battery feeds the electrodes only while its voltage is measured and in range."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from deltacharger_core.machine import BATTERY_MAX, BATTERY_MIN
from deltacharger_core.parameters import ParameterError
from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import DockGoal
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.virtual_charger import GOAL

from .dockings import assert_safe_at_home, quick_charger


@pytest.mark.parametrize(
    ("volts", "code", "words"),
    [
        (22.6, Code.VOLTAGE_OUT_OF_RANGE, ("own battery", "22.6 V", "22.7 to 29.8 V", "charge it")),
        (29.9, Code.VOLTAGE_OUT_OF_RANGE, ("own battery", "29.9 V", "22.7 to 29.8 V", "check it")),
        (-24.0, Code.VOLTAGE_OUT_OF_RANGE, ("own battery", "-24.0 V")),
        (math.nan, Code.POWER_STALE, ("own battery", "not measured", "divider")),
        (math.inf, Code.POWER_STALE, ("own battery", "not measured", "divider")),
    ],
)
def test_a_battery_that_is_unfit_or_unknown_is_not_energised(volts: float, code: Code, words: tuple[str, ...]) -> None:
    run = quick_charger()
    run.distort = lambda observation: replace(observation, battery_voltage=volts)
    outcome = run.dock()
    assert outcome.code is code
    for word in words:
        assert word in outcome.message
    assert run.world.record.contacts == 0, "it is known before anything touches"
    assert_safe_at_home(run)


def test_a_battery_that_becomes_unfit_during_docking_is_not_energised() -> None:
    run = quick_charger()
    run.begin(DockGoal(GOAL))
    run.until(lambda: run.machine.status.state is State.CONTACT, 30.0)
    run.distort = lambda observation: replace(observation, battery_voltage=20.0)
    assert run.finish(60.0).code is Code.VOLTAGE_OUT_OF_RANGE
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


@pytest.mark.parametrize(("charges", "power_age"), [(False, 0.0), (True, math.inf)])
def test_it_docks_without_charging_or_before_the_first_voltage(charges: bool, power_age: float) -> None:
    run = quick_charger()
    run.distort = lambda observation: replace(observation, battery_voltage=math.nan, power_age=power_age)
    run.dock(DockGoal(GOAL, start_charging=charges))
    assert run.world.record.contacts > 0
    assert run.world.record.energised == 0.0


@pytest.mark.parametrize("volts", [BATTERY_MIN, BATTERY_MAX])
def test_the_bounds_themselves_are_in_range(volts: float) -> None:
    """Also as charger_power carries them, in 32 bits."""
    run = quick_charger()
    run.distort = lambda observation: replace(observation, battery_voltage=float(np.float32(volts)))
    assert run.dock().success


def test_another_battery_has_its_own_bounds() -> None:
    run = quick_charger(parameters={"battery_voltage_min": 18.0})
    run.distort = lambda observation: replace(observation, battery_voltage=19.0)
    assert run.dock().success


def test_bounds_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ParameterError, match="battery_voltage_min must not lie above battery_voltage_max"):
        DockingParameters(battery_voltage_min=26.0, battery_voltage_max=24.0)
