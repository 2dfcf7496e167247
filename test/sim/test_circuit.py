# SPDX-License-Identifier: Apache-2.0
"""The power stage: pre-charge, ramp, constant current and voltage, resistance, openings and fault detection."""

from __future__ import annotations

import math
from typing import Any

import pytest

from deltacharger_core.machine import BATTERY_MAX, BATTERY_MIN
from deltacharger_sim.bars import Bars
from deltacharger_sim.circuit import (
    NO_CHARGE_CURRENT,
    REVERSE_CURRENT,
    REVERSE_POLARITY,
    SHORT,
    VOLTAGE,
    WELDED,
    Circuit,
)
from deltacharger_sim.clearance import Overlap
from deltacharger_sim.parameters import CircuitParameters, TerminalParameters

TERMINAL = TerminalParameters()
FULL = Overlap(TERMINAL, 0.0, 0.0, 0.0)
HALF = Overlap(TERMINAL, 0.5 * TERMINAL.length, 0.0, 0.0)
BRIDGED = Overlap(TERMINAL, 0.0, 0.0, math.radians(14.0))
PRESSED = Bars.flat(77.0)
LIFTED = Bars(0.0, 77.0, 0.0, 1.0)


def run(
    circuit: Circuit, seconds: float, lies: Overlap | None = FULL, bars: Bars = PRESSED, step: float = 0.005
) -> Circuit:
    for _ in range(round(seconds / step)):
        circuit.step(step, lies, bars)
    return circuit


def make(lies: Overlap | None = FULL, bars: Bars = PRESSED, **changes: Any) -> Circuit:
    """A circuit whose electrodes have just touched."""
    return run(Circuit(CircuitParameters(**changes)), 0.02, lies, bars)


def charging(**changes: Any) -> Circuit:
    circuit = make(**changes)
    circuit.close()
    run(circuit, 1.0)
    assert circuit.measured()[3:] == (True, 0)
    return circuit


def test_closing_waits_for_the_pre_charge_and_then_ramps() -> None:
    circuit = Circuit(CircuitParameters(precharge_time=0.1, ramp_up=40.0))
    circuit.close()
    run(circuit, 0.09)
    assert (circuit.closed, circuit.current) == (False, 0.0)
    run(circuit, 0.02)
    assert circuit.closed
    before = circuit.current
    while circuit.current < 10.0:
        run(circuit, 0.005)
        assert circuit.current - before <= 40.0 * 0.005 + 1e-9
        before = circuit.current


def test_current_is_constant_up_to_the_voltage_limit_and_worse_contact_means_less() -> None:
    for limit in (2.0, 18.0):
        assert charging(current_limit=limit, target_voltage=20.0).current == pytest.approx(limit)
    circuit = charging(target_voltage=28.5, voltage_limit=29.0)
    good = circuit.current
    assert 0.5 < good < 10.0
    assert 28.5 < circuit.voltages()[1] < 29.0
    run(circuit, 0.1, Overlap(TERMINAL, 0.993 * TERMINAL.length, 0.0, 0.0))
    assert circuit.current < 0.8 * good


def test_the_target_voltage_is_measured_only_in_contact() -> None:
    circuit = make(None)
    battery, target = circuit.voltages()
    assert BATTERY_MIN <= battery <= BATTERY_MAX
    assert math.isnan(target)
    assert run(circuit, 0.02).voltages()[1] == pytest.approx(24.0)


@pytest.mark.parametrize(
    ("lies", "bars", "ohm"),
    [
        (FULL, Bars.flat(80.0), 0.01),
        (FULL, Bars.flat(20.0), 0.02),
        (HALF, Bars.flat(31.0), 0.01 / (HALF.fraction * math.sqrt(31.0 / 80.0))),
        # Two contacts in series, each with its own force and pressed length.
        (FULL, Bars(10.0, 70.0), 0.005 * (math.sqrt(40.0 / 10.0) + math.sqrt(40.0 / 70.0))),
        (FULL, Bars(70.0, 10.0), 0.005 * (math.sqrt(40.0 / 10.0) + math.sqrt(40.0 / 70.0))),
        (FULL, Bars(40.0, 40.0, 0.25, 1.0), 0.005 * (4.0 + 1.0)),
        (FULL, Bars.flat(0.0), math.inf),
        (FULL, LIFTED, math.inf),
        (FULL, Bars(77.0, 0.0, 1.0, 0.0), math.inf),
    ],
)
def test_contact_resistance_follows_overlap_and_the_force_on_each_bar(lies: Overlap, bars: Bars, ohm: float) -> None:
    assert make(lies, bars, target_leakage=0.0).probe()[0] == pytest.approx(ohm)


def test_the_probe_distinguishes_healthy_short_reversed_and_open() -> None:
    ohm, volt = make().probe()
    assert ohm >= 1.0
    assert volt == pytest.approx(24.0)
    assert make(BRIDGED).probe()[0] < 1.0
    assert make(target_voltage=-24.0).probe()[1] < 0.0
    for apart in (make(None), make(bars=LIFTED)):
        assert math.isinf(apart.probe()[0])
        assert math.isnan(apart.probe()[1])


def test_a_normal_opening_ramps_below_one_ampere_within_50_ms_and_an_emergency_is_immediate() -> None:
    circuit = charging(current_limit=18.0)
    circuit.open(True)
    elapsed, last = 0.0, circuit.current
    while circuit.closed:
        last = circuit.current
        run(circuit, 0.001, step=0.001)
        elapsed += 0.001
    assert elapsed <= 0.050
    assert last < 1.0 + 500.0 * 0.001
    assert (circuit.current, circuit.fault) == (0.0, 0)
    circuit = charging(current_limit=18.0)
    circuit.open(False)
    assert (circuit.closed, circuit.current) == (False, 0.0)


def test_an_opening_during_pre_charge_ends_it() -> None:
    circuit = make()
    circuit.close()
    run(circuit, 0.05)
    circuit.open(True)
    assert not run(circuit, 0.5).closed


@pytest.mark.parametrize(
    ("changes", "lies", "fault"),
    [
        ({}, BRIDGED, SHORT),
        ({}, None, NO_CHARGE_CURRENT),
        ({"target_voltage": -24.0}, FULL, REVERSE_POLARITY),
        ({"target_voltage": 8.0}, FULL, VOLTAGE),
        ({"target_voltage": 31.0}, FULL, VOLTAGE),
    ],
)
def test_a_wrong_target_prevents_closing(changes: dict[str, float], lies: Overlap | None, fault: int) -> None:
    circuit = make(lies, **changes)
    circuit.close()
    for _ in range(100):
        run(circuit, 0.005, lies)
        assert (circuit.closed, circuit.current) == (False, 0.0)
    assert circuit.fault == fault


@pytest.mark.parametrize(
    ("changes", "seconds", "fault"),
    [
        ({"target_voltage": 29.5, "voltage_limit": 29.0}, 0.3, REVERSE_CURRENT),
        ({"target_accepts": False}, 5.0, NO_CHARGE_CURRENT),
    ],
)
def test_a_target_that_feeds_back_or_takes_no_current_is_cut_off(
    changes: dict[str, float], seconds: float, fault: int
) -> None:
    circuit = make(**changes)
    circuit.close()
    run(circuit, seconds)
    assert (circuit.closed, circuit.fault) == (False, fault)


def test_a_short_while_charging_lasts_one_step_and_opens_which_clears_the_fault() -> None:
    circuit = charging()
    run(circuit, 0.005, BRIDGED)
    assert circuit.closed
    assert circuit.current > 100.0  # until the stage detects it
    assert circuit.heat == 0.0
    run(circuit, 0.005, BRIDGED)
    assert (circuit.closed, circuit.fault) == (False, SHORT)
    circuit.open(True)
    assert circuit.fault == 0


@pytest.mark.parametrize("charged", [0.2, 1.0, 5.0])
@pytest.mark.parametrize(("lies", "bars"), [(None, PRESSED), (FULL, LIFTED)])
def test_contact_lost_while_charging_opens_within_100_ms(charged: float, lies: Overlap | None, bars: Bars) -> None:
    circuit = make()
    circuit.close()
    assert run(circuit, charged).current > 1.0
    run(circuit, 0.005, lies, bars)
    assert (circuit.current, circuit.heat) == (0.0, 0.0)
    run(circuit, 0.095, lies, bars)
    assert (circuit.closed, circuit.fault) == (False, NO_CHARGE_CURRENT)


def test_a_short_during_a_ramped_opening_still_opens() -> None:
    circuit = charging(current_limit=18.0)
    circuit.open(True)
    run(circuit, 0.1, BRIDGED)
    assert (circuit.closed, circuit.current) == (False, 0.0)


@pytest.mark.parametrize("ramp", [True, False])
def test_a_welded_contactor_is_reported_and_stays_closed(ramp: bool) -> None:
    circuit = charging(welded=True)
    circuit.open(ramp)
    run(circuit, 0.2)
    assert (circuit.closed, circuit.fault) == (True, WELDED)
    circuit.open(ramp)
    circuit.close()
    assert circuit.fault == WELDED
    run(circuit, 0.2, None)
    assert circuit.measured() == (26.0, 26.0, 0.0, True, WELDED)  # in free air, behind the contactor


def test_the_battery_sags_under_charge_current() -> None:
    circuit = charging(battery_voltage=26.0, battery_resistance=0.13)
    assert circuit.voltages()[0] == pytest.approx(26.0 - 10.0 * 0.13)


def test_a_filling_battery_draws_constant_and_then_falling_current() -> None:
    """At constant voltage, the current falls with the time constant of total resistance times capacity."""
    circuit = Circuit(CircuitParameters(target_capacity=40.0, contact_resistance=0.01))
    circuit.close()
    currents, delivered = [], 0.0
    for _ in range(6000):
        circuit.step(0.01, FULL, Bars.flat(80.0))
        currents.append(circuit.current)
        delivered += circuit.current * 0.01
    flat = sum(current > 9.99 for current in currents) * 0.01
    expected = 40.0 * (29.0 - 10.0 * 0.16 - 24.0) / 10.0
    assert flat == pytest.approx(expected, abs=0.4)
    ratio = currents[4000] / currents[3000]
    assert ratio == pytest.approx(math.exp(-10.0 / (0.16 * 40.0)), rel=0.02)
    assert circuit.probe()[1] == pytest.approx(24.0 + delivered / 40.0, abs=0.01)
    assert circuit.probe()[1] < 29.0
    full = run(charging(), 100.0, step=0.05)
    assert full.probe()[1] == 24.0, "without capacity, it keeps its voltage"
    assert full.current == pytest.approx(10.0)


def test_heat_is_reported_of_the_bar_with_the_larger_resistance() -> None:
    circuit = charging()
    for bars, share in ((Bars.flat(80.0), 1.0), (Bars(2.5, 77.5), 4.0), (Bars(77.5, 2.5), 4.0)):
        run(circuit, 0.005, bars=bars)
        assert circuit.heat == pytest.approx(10.0**2 * 0.005 * share)


@pytest.mark.parametrize(("target", "drives"), [(24.0, 2.0), (26.0, 0.0), (29.0, -3.0), (-24.0, 50.0)])
def test_current_of_wired_electrodes_follows_both_batteries_in_either_direction(target: float, drives: float) -> None:
    resistances = {"target_resistance": 0.15, "battery_resistance": 0.13, "contact_resistance": 0.0}
    circuit = make(wired=True, target_voltage=target, **resistances)
    assert circuit.current == pytest.approx(drives / 0.28)
    run(circuit, 0.02, None)
    assert circuit.current == 0.0
    assert circuit.broken_current == pytest.approx(abs(drives) / 0.28)


def test_wired_electrodes_have_no_measurement_detection_or_opening() -> None:
    circuit = make(wired=True, battery_voltage=26.0, battery_resistance=0.13)
    circuit.close()
    run(circuit, 1.0, BRIDGED)
    circuit.open(ramp=False)
    run(circuit, 0.1, BRIDGED)
    assert circuit.current == pytest.approx(200.0), "a short lasts as long as the electrodes touch"
    battery, target, current, closed, fault = circuit.measured()
    assert all(map(math.isnan, (battery, target, current, *circuit.probe())))
    assert (closed, fault) == (False, 0)
