# SPDX-License-Identifier: Apache-2.0
"""The circuit behind the board: contacts, contactor, sag, heat, and electrodes that are wired to the battery."""

import math
from typing import Any

import pytest

from deltacharger_core.machine import BAR_LENGTH, Port, port_of
from deltacharger_sim import parameters, touch
from deltacharger_sim.circuit import Circuit, Overlap
from deltacharger_sim.emulators.power import Outputs, PortParameters

FULL = Overlap(0.0, 0.0, 0.0)
HALF = Overlap(0.5 * BAR_LENGTH, 0.0, 0.0)
BRIDGED = Overlap(0.0, 0.0, math.radians(14.0))
PRESSED = touch.Bars.flat(77.0)
LIFTED = touch.Bars(0.0, 77.0, 0.0, 1.0)


def run(
    circuit: Circuit, seconds: float, lies: Overlap | None = FULL, bars: touch.Bars = PRESSED, step: float = 0.005
) -> Circuit:
    for _ in range(round(seconds / step)):
        circuit.step(step, lies, bars)
    return circuit


def make(
    lies: Overlap | None = FULL, bars: touch.Bars = PRESSED, port: dict[str, float] | None = None, **changes: Any
) -> Circuit:
    """A circuit whose electrodes have just touched."""
    made = Circuit(parameters.CircuitParameters(**changes), PortParameters(**(port or {})))
    return run(made, 0.02, lies, bars)


def charging(current: float = 10.0, voltage: float = 29.4, **changes: Any) -> Circuit:
    circuit = make(**changes)
    circuit.drive(Outputs(True, True, current, voltage))
    run(circuit, 0.2)
    assert circuit.closed
    return circuit


def test_the_output_follows_the_target_after_the_pre_charge_and_the_contacts_their_coil() -> None:
    circuit = make()
    circuit.drive(Outputs(precharge=True, voltage=29.4))
    assert run(circuit, 0.09).read_power().output == 0.0
    assert run(circuit, 0.02).read_power().output == pytest.approx(24.0)
    assert not circuit.closed
    circuit.drive(Outputs(True, True, 5.0, 29.4))
    assert run(circuit, 0.02).read_power().closed
    assert circuit.current == pytest.approx(5.0)
    circuit.drive(Outputs())
    assert (circuit.closed, circuit.current, circuit.broken_current) == (False, 0.0, pytest.approx(5.0))


@pytest.mark.parametrize(
    ("lies", "bars", "ohm"),
    [
        (FULL, touch.Bars.flat(80.0), 0.01),
        (FULL, touch.Bars.flat(20.0), 0.02),
        (HALF, touch.Bars.flat(31.0), 0.01 / (HALF.fraction * math.sqrt(31.0 / 80.0))),
        # Two contacts in series, each with its own force and pressed length.
        (FULL, touch.Bars(10.0, 70.0), 0.005 * (math.sqrt(40.0 / 10.0) + math.sqrt(40.0 / 70.0))),
        (FULL, touch.Bars(40.0, 40.0, 0.25, 1.0), 0.005 * (4.0 + 1.0)),
        (FULL, LIFTED, math.inf),
        (FULL, touch.Bars(77.0, 0.0, 1.0, 0.0), math.inf),
    ],
)
def test_contact_resistance_follows_overlap_and_the_force_on_each_bar(
    lies: Overlap, bars: touch.Bars, ohm: float
) -> None:
    circuit = make(lies, bars)
    circuit.drive(Outputs(True, True, 2.0, 29.4))
    run(circuit, 0.2, lies, bars)
    if math.isinf(ohm):
        assert circuit.current == 0.0
    else:
        assert circuit.read_power().target == pytest.approx(24.0 + 2.0 * (0.15 + ohm))


def test_the_probe_distinguishes_live_short_reversed_and_open() -> None:
    for circuit, port in (
        (make(), Port.LIVE),
        (make(BRIDGED), Port.SHORT),
        (make(port={"voltage": -24.0}), Port.REVERSED),
        (make(port={"diode": 0.4}), Port.OPEN),
        (make(port={"voltage": 0.0, "capacitor": 0.0022}), Port.DEAD),
        (make(None), Port.OPEN),
        (make(bars=LIFTED), Port.OPEN),
    ):
        assert port_of(*circuit.probe()) is port


def test_a_bar_that_bridges_a_live_port_shorts_it_with_the_contactor_open() -> None:
    circuit = make(BRIDGED)
    assert circuit.port_shorted
    assert (circuit.closed, circuit.read_power().target) == (False, 0.0)
    assert not make().port_shorted
    assert not make(BRIDGED, port={"diode": 0.4}).port_shorted


def test_a_short_while_charging_carries_a_short_current_until_the_board_opens() -> None:
    circuit = charging()
    run(circuit, 0.005, BRIDGED)
    assert circuit.current > 100.0
    assert (circuit.read_power().target, circuit.heat) == (0.0, 0.0)
    circuit.drive(Outputs())
    assert (circuit.closed, circuit.current) == (False, 0.0)


def test_a_welded_contactor_stays_closed_and_what_flows_flows_on() -> None:
    circuit = charging(welded=True)
    circuit.drive(Outputs())
    run(circuit, 0.2)
    assert circuit.closed
    assert circuit.current == pytest.approx(10.0)
    reading = run(circuit, 0.2, None).read_power()
    assert (reading.target, reading.current, reading.closed) == (26.0, 0.0, True)  # in free air, behind the contactor


def test_heat_is_reported_of_the_bar_with_the_larger_resistance() -> None:
    circuit = charging()
    for bars, share in ((touch.Bars.flat(80.0), 1.0), (touch.Bars(2.5, 77.5), 4.0), (touch.Bars(77.5, 2.5), 4.0)):
        run(circuit, 0.005, bars=bars)
        assert circuit.heat == pytest.approx(10.0**2 * 0.005 * share)


@pytest.mark.parametrize(("target", "drives"), [(24.0, 2.0), (26.0, 0.0), (29.0, -3.0), (-24.0, 50.0)])
def test_current_of_wired_electrodes_follows_both_batteries_in_either_direction(target: float, drives: float) -> None:
    circuit = make(wired=True, port={"voltage": target})
    loop = 0.13 + 0.01 * math.sqrt(80.0 / 77.0) + 0.15
    assert circuit.current == pytest.approx(drives / loop)
    run(circuit, 0.02, None)
    assert circuit.current == 0.0
    assert circuit.broken_current == pytest.approx(abs(drives) / loop)


def test_wired_electrodes_have_no_measurement_and_no_opening() -> None:
    circuit = make(wired=True, battery_voltage=26.0)
    circuit.drive(Outputs(True, True, 10.0, 29.4))
    run(circuit, 1.0, BRIDGED)
    circuit.drive(Outputs())
    run(circuit, 0.1, BRIDGED)
    assert circuit.current == pytest.approx(200.0), "a short lasts as long as the electrodes touch"
    reading = circuit.read_power()
    assert all(map(math.isnan, (reading.battery, reading.target, reading.current, *circuit.probe())))
    assert not reading.closed
