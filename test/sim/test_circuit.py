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
FORCE = 77.0
PRESSED = Bars.flat(FORCE)


def make(**changes: Any) -> Circuit:
    return Circuit(CircuitParameters(**changes))


def run(
    circuit: Circuit, seconds: float, lies: Overlap | None = FULL, force: float = FORCE, step: float = 0.005
) -> None:
    for _ in range(round(seconds / step)):
        circuit.step(step, lies, Bars.flat(force))


def charging(**changes: Any) -> Circuit:
    circuit = make(**changes)
    run(circuit, 0.02)
    circuit.close()
    run(circuit, 1.0)
    assert circuit.closed
    assert circuit.fault == 0
    return circuit


def test_closing_waits_for_the_pre_charge_and_then_ramps() -> None:
    circuit = make(precharge_time=0.1, ramp_up=40.0)
    circuit.close()
    run(circuit, 0.09)
    assert not circuit.closed
    assert circuit.current == 0.0
    run(circuit, 0.02)
    assert circuit.closed
    before = circuit.current
    while circuit.current < 10.0:
        circuit.step(0.005, FULL, PRESSED)
        assert circuit.current - before <= 40.0 * 0.005 + 1e-9
        before = circuit.current


@pytest.mark.parametrize("limit", [2.0, 10.0, 18.0])
def test_the_current_is_constant_below_the_voltage_limit(limit: float) -> None:
    circuit = charging(current_limit=limit, target_voltage=20.0)
    assert circuit.current == pytest.approx(limit)


def test_a_nearly_full_target_is_fed_at_constant_voltage() -> None:
    circuit = charging(target_voltage=28.5, voltage_limit=29.0)
    assert 0.5 < circuit.current < 10.0
    _, terminals = circuit.voltages()
    assert 28.5 < terminals < 29.0


def test_the_target_voltage_is_measured_only_in_contact() -> None:
    circuit = make()
    run(circuit, 0.02, None)
    battery, target = circuit.voltages()
    assert BATTERY_MIN <= battery <= BATTERY_MAX
    assert math.isnan(target)
    run(circuit, 0.02)
    assert circuit.voltages()[1] == pytest.approx(24.0)


def test_contact_resistance_falls_with_overlap_and_with_force() -> None:
    def resistance(lies: Overlap, force: float) -> float:
        circuit = make(target_leakage=0.0)
        circuit.step(0.005, lies, Bars.flat(force))
        return circuit.probe()[0]

    assert resistance(FULL, 80.0) == pytest.approx(0.01)
    assert resistance(HALF, 80.0) > 1.9 * resistance(FULL, 80.0)
    assert resistance(FULL, 20.0) == pytest.approx(2.0 * resistance(FULL, 80.0))
    assert math.isinf(resistance(FULL, 0.0))


def test_the_probe_distinguishes_healthy_short_reversed_and_open() -> None:
    cases: list[tuple[dict[str, float], Overlap | None]] = [
        ({}, FULL),
        ({}, BRIDGED),
        ({"target_voltage": -24.0}, FULL),
        ({}, None),
    ]
    probes = []
    for changes, lies in cases:
        circuit = make(**changes)
        circuit.step(0.005, lies, PRESSED)
        probes.append(circuit.probe())
    (ohm, volt), (short, _), (_, reverse), (apart, nothing) = probes
    assert ohm >= 1.0
    assert volt == pytest.approx(24.0)
    assert short < 1.0
    assert reverse < 0.0
    assert math.isinf(apart)
    assert math.isnan(nothing)


def test_a_normal_opening_ramps_below_one_ampere_within_50_ms() -> None:
    circuit = charging(current_limit=18.0)
    circuit.open(True)
    elapsed, last = 0.0, circuit.current
    while circuit.closed:
        last = circuit.current
        circuit.step(0.001, FULL, PRESSED)
        elapsed += 0.001
    assert elapsed <= 0.050
    assert last < 1.0 + 500.0 * 0.001
    assert circuit.current == 0.0
    assert circuit.fault == 0


def test_an_emergency_opening_is_immediate() -> None:
    circuit = charging(current_limit=18.0)
    circuit.open(False)
    assert not circuit.closed
    assert circuit.current == 0.0


def test_an_opening_during_pre_charge_ends_it() -> None:
    circuit = make()
    circuit.close()
    run(circuit, 0.05)
    circuit.open(True)
    run(circuit, 0.5)
    assert not circuit.closed


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
    circuit = make(**changes)
    run(circuit, 0.02, lies)
    circuit.close()
    for _ in range(100):
        circuit.step(0.005, lies, PRESSED)
        assert not circuit.closed
        assert circuit.current == 0.0
    assert circuit.fault == fault


def test_a_target_that_feeds_back_is_cut_off() -> None:
    circuit = make(target_voltage=29.5, voltage_limit=29.0)
    run(circuit, 0.02)
    circuit.close()
    run(circuit, 0.3)
    assert not circuit.closed
    assert circuit.fault == REVERSE_CURRENT


def test_a_target_that_takes_no_current_is_reported() -> None:
    circuit = make(target_accepts=False)
    run(circuit, 0.02)
    circuit.close()
    run(circuit, 5.0)
    assert not circuit.closed
    assert circuit.fault == NO_CHARGE_CURRENT


def test_a_short_while_charging_lasts_one_step_and_opens() -> None:
    circuit = charging()
    circuit.step(0.005, BRIDGED, PRESSED)
    assert circuit.closed
    assert circuit.current > 100.0  # until the stage detects it
    circuit.step(0.005, BRIDGED, PRESSED)
    assert not circuit.closed
    assert circuit.fault == SHORT


@pytest.mark.parametrize("charged", [0.2, 1.0, 5.0])
def test_contact_lost_while_charging_opens_within_100_ms(charged: float) -> None:
    circuit = make()
    run(circuit, 0.02)
    circuit.close()
    run(circuit, charged)
    assert circuit.current > 1.0
    run(circuit, 0.1, None)
    assert not circuit.closed
    assert circuit.fault == NO_CHARGE_CURRENT


def test_a_short_during_a_ramped_opening_still_opens() -> None:
    circuit = charging(current_limit=18.0)
    circuit.open(True)
    run(circuit, 0.1, BRIDGED)
    assert not circuit.closed
    assert circuit.current == 0.0


@pytest.mark.parametrize("ramp", [True, False])
def test_a_welded_contactor_is_reported_and_stays_closed(ramp: bool) -> None:
    circuit = charging(welded=True)
    circuit.open(ramp)
    run(circuit, 0.2)
    assert circuit.closed
    assert circuit.fault == WELDED


def test_an_opening_clears_the_fault() -> None:
    circuit = charging()
    run(circuit, 0.01, BRIDGED)
    circuit.open(True)
    assert circuit.fault == 0


def test_worse_contact_means_less_current_at_the_voltage_limit() -> None:
    good, bad = charging(target_voltage=28.5), charging(target_voltage=28.5)
    run(bad, 0.1, Overlap(TERMINAL, 0.993 * TERMINAL.length, 0.0, 0.0))
    assert bad.current < 0.8 * good.current


def test_a_filling_battery_draws_constant_and_then_falling_current() -> None:
    """At constant voltage, the current falls with the time constant of total resistance times capacity."""
    parameters = CircuitParameters(target_capacity=40.0, contact_resistance=0.01)
    circuit = Circuit(parameters)
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


def test_a_battery_without_capacity_keeps_its_voltage() -> None:
    circuit = Circuit(CircuitParameters())
    circuit.close()
    for _ in range(2000):
        circuit.step(0.05, FULL, Bars.flat(80.0))
    assert circuit.probe()[1] == 24.0
    assert circuit.current == pytest.approx(10.0)


def test_both_bars_are_contacts_in_series_each_with_its_own_force_and_pressed_length() -> None:
    def resistance(bars: Bars, lies: Overlap = FULL) -> float:
        circuit = make(target_leakage=0.0)
        circuit.step(0.005, lies, bars)
        return circuit.probe()[0]

    for force, lies in ((80.0, FULL), (31.0, HALF)):
        both = 0.01 / (lies.fraction * math.sqrt(force / 80.0))
        assert resistance(Bars.flat(force), lies) == both
    assert resistance(Bars(10.0, 70.0)) == pytest.approx(0.005 * (math.sqrt(40.0 / 10.0) + math.sqrt(40.0 / 70.0)))
    assert resistance(Bars(40.0, 40.0, 0.25, 1.0)) == pytest.approx(0.005 * (4.0 + 1.0))
    assert resistance(Bars(10.0, 70.0)) == resistance(Bars(70.0, 10.0))


@pytest.mark.parametrize("lifted", [Bars(0.0, FORCE, 0.0, 1.0), Bars(FORCE, 0.0, 1.0, 0.0)])
def test_a_bar_that_does_not_press_opens_the_circuit(lifted: Bars) -> None:
    circuit = make()
    circuit.step(0.005, FULL, lifted)
    resistance, target = circuit.probe()
    assert math.isinf(resistance)
    assert math.isnan(target)
    live = charging()
    for _ in range(20):
        live.step(0.005, FULL, lifted)
        assert live.current == 0.0
        assert live.heat == 0.0
    assert not live.closed
    assert live.fault == NO_CHARGE_CURRENT


def test_heat_is_reported_of_the_bar_with_the_larger_resistance() -> None:
    circuit = charging()
    circuit.step(0.005, FULL, Bars.flat(80.0))
    assert circuit.heat == pytest.approx(10.0**2 * 0.005)
    for bars in (Bars(2.5, 77.5), Bars(77.5, 2.5)):
        circuit.step(0.005, FULL, bars)
        assert circuit.heat == pytest.approx(10.0**2 * 0.005 * 4.0)
    circuit.step(0.005, BRIDGED, PRESSED)
    assert circuit.current > 100.0
    assert circuit.heat == 0.0


def wired(**changes: Any) -> Circuit:
    return make(wired=True, **changes)


@pytest.mark.parametrize(("target", "drives"), [(24.0, 2.0), (26.0, 0.0), (29.0, -3.0), (-24.0, 50.0)])
def test_current_of_wired_electrodes_follows_both_batteries_in_either_direction(target: float, drives: float) -> None:
    circuit = wired(target_voltage=target, target_resistance=0.15, battery_resistance=0.13, contact_resistance=0.0)
    run(circuit, 0.02)
    assert circuit.current == pytest.approx(drives / 0.28)
    run(circuit, 0.02, None)
    assert circuit.current == 0.0
    assert circuit.broken_current == pytest.approx(abs(drives) / 0.28)


def test_wired_electrodes_have_no_measurement_detection_or_opening() -> None:
    circuit = wired(battery_voltage=26.0, battery_resistance=0.13)
    circuit.close()
    run(circuit, 1.0, BRIDGED)
    circuit.open(ramp=False)
    run(circuit, 0.1, BRIDGED)
    assert circuit.current == pytest.approx(200.0), "a short lasts as long as the electrodes touch"
    battery, target, current, closed, fault = circuit.measured()
    assert all(map(math.isnan, (battery, target, current, *circuit.probe())))
    assert (closed, fault) == (False, 0)


def test_a_power_stage_measures() -> None:
    assert charging().measured()[3:] == (True, 0)
