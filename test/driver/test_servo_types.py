# SPDX-License-Identifier: Apache-2.0
"""Each type of servo is one row: the driver reads units, limits and constants of the servos that it finds from it.

Every row is driven over its own bytes: here mostly in virtual time, in contract/ on a real port. A further type needs
nothing else than its row in deltacharger_core/servo_types.py and its figures here.
"""

import contextlib
import math
from typing import Any

import numpy as np
import pytest

from deltacharger_core import machine
from deltacharger_core.servo_types import MX_64, TYPES, XM430_W350, ServoType
from deltacharger_driver import errors, ports
from deltacharger_driver.servos import controller, registers
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ..plants import BenchArm
from ..quick import PATIENT_MARGIN
from .servo_rig import START, Rig

KINDS = pytest.mark.parametrize("kind", TYPES.values(), ids=lambda kind: kind.name)


XM430 = pytest.mark.parametrize("kind", [XM430_W350], ids=[XM430_W350.name])


def test_the_mx_64_has_the_constants_of_the_papers_machine() -> None:
    assert MX_64.torque_constant == machine.TORQUE_CONSTANT
    assert (MX_64.stall_torque, MX_64.stall_current) == (machine.STALL_TORQUE, machine.STALL_CURRENT) == (6.0, 4.1)
    assert MX_64.gains == (machine.POSITION_P_GAIN, machine.POSITION_D_GAIN) == (434, 2715)
    assert MX_64.stiffness_per_gain == machine.STIFFNESS_PER_GAIN
    assert MX_64.damping_per_gain == machine.DAMPING_PER_GAIN
    assert (MX_64.current_bound, MX_64.joint_speed) == (machine.CURRENT_BOUND, machine.JOINT_SPEED) == (0.83, 4.9)
    assert MX_64.largest_current == pytest.approx(6.52, abs=0.01)
    assert registers.registers_of(MX_64) == registers.REGISTERS


def test_the_xm430_has_the_figures_of_its_e_manual() -> None:
    table = registers.registers_of(XM430_W350)
    assert XM430_W350.torque_constant == pytest.approx(1.783, abs=1e-3)
    assert XM430_W350.largest_current == pytest.approx(3.209, abs=1e-3)
    assert (table["current_limit"].default, table["goal_current"].low, table["pwm_limit"].default) == (1193, -1193, 885)
    assert (table["velocity_limit"].default, table["velocity_limit"].high) == (200, 1023)
    assert (table["temperature_limit"].default, table["position_p_gain"].default, table["model"].default) == (
        80,
        800,
        1020,
    )
    assert registers.REGISTERS.keys() - table.keys() == {"acceleration_limit"}
    places = {
        name: (register.address, register.size, register.signed) for name, register in registers.REGISTERS.items()
    }
    assert all(places[name] == (each.address, each.size, each.signed) for name, each in table.items())
    assert [registers.current_to_counts(sign * 0.5, XM430_W350) for sign in (1, -1)] == [185, -185]
    assert [registers.current_to_counts(sign * 0.5, MX_64) for sign in (1, -1)] == [148, -148]


@KINDS
def test_every_type_is_as_stiff_as_the_others_and_never_hotter_than_its_row_says(kind: ServoType) -> None:
    assert kind.gains[0] * kind.stiffness_per_gain == pytest.approx(machine.SERVO_STIFFNESS, rel=2e-3)
    assert kind.gains[1] * kind.damping_per_gain == pytest.approx(machine.SERVO_DAMPING, rel=2e-3)
    assert controller.reserve(0.0, kind.heat_current, kind) == pytest.approx(kind.heat_time)
    assert controller.reserve(0.0, 0.99 * math.sqrt(kind.heat_limit / kind.heat_constant), kind) == math.inf
    hot = controller.ThermalModel(kind)
    hot.start_at(kind.temperature_limit)
    hot.update(0.1, 0.0)
    assert hot.reserve() == 0.0
    assert controller.reserve(0.0, 0.5, XM430_W350) < controller.reserve(0.0, 0.8, MX_64)


@KINDS
def test_currents_have_the_types_unit(
    bus: ServoBus, arm: BenchArm, emulator: ServoBusEmulator, clock: Any, kind: ServoType
) -> None:
    bus.enable_torque((2.0,) * 3)
    arm.load[:] = [0.3 * kind.torque_constant, -0.9 * kind.torque_constant, 0.0]
    clock.sleep(1.0)
    snapshot = bus.read()
    assert snapshot.current == pytest.approx((-0.3, 0.9, 0.0), abs=kind.current_unit)
    counts = [emulator.servo(servo).table.get("present_current") for servo in (1, 2, 3)]
    assert snapshot.current == pytest.approx([count * kind.current_unit for count in counts])
    assert snapshot.voltage == pytest.approx((12.0,) * 3)


@KINDS
@pytest.mark.parametrize("constant", [None, 1.2])
def test_a_torque_becomes_a_current_by_the_types_constant_unless_one_is_set(
    arm: BenchArm, emulator: ServoBusEmulator, line: Any, clock: Any, kind: ServoType, constant: float | None
) -> None:
    rig = Rig(arm, emulator, line, clock, torque_constant=constant)
    rig.controller.open()
    rig.torque_on()
    assert rig.bounds() == pytest.approx([kind.current_bound] * 3, abs=kind.current_unit)
    rig.send((1.0, START, (1.0, 0.5, 0.0)))
    rig.cycle()
    by = constant or kind.torque_constant
    assert rig.bounds() == pytest.approx([1.0 / by, 0.5 / by, 0.0], abs=kind.current_unit)
    rig.controller.close()


@pytest.mark.parametrize(("kind", "allowed"), [(MX_64, True), (XM430_W350, False)])
def test_a_bound_beyond_the_types_registers_is_refused_at_the_set_up(line: Any, allowed: bool) -> None:
    bus = ServoBus(registers.BusSettings(line.path, current_max=4.0), line.handler)
    with contextlib.nullcontext() if allowed else pytest.raises(errors.RangeError):
        bus.open()
    bus.close()


@XM430
def test_a_mixture_is_refused_by_name(closed: ServoBus, arm: BenchArm, emulator: ServoBusEmulator) -> None:
    emulator.servo(2).table.set("model", 311)
    with pytest.raises(
        errors.HandshakeError, match=r"servo 2 is MX-64 \(311\), not XM430-W350 \(1020\) as servo 1"
    ) as caught:
        closed.open()
    assert len(caught.value.faults) == 1
    assert arm.torque_enabled() == [False] * 3


@pytest.mark.ros
@pytest.mark.parametrize("given", [{}, {"torque_constant": 1.463, "position_p_gain": 500}])
def test_servo_node_shows_and_uses_the_types_values_unless_they_are_given(context: Any, given: dict[str, Any]) -> None:
    from deltacharger_driver.servos.servo_node import ServoNode

    from ..nodes import options

    emulator = ServoBusEmulator(BenchArm(START), kind=XM430_W350)
    with ports.PseudoTerminal(emulator) as terminal:
        emulator.line_speed = terminal.speed
        node = ServoNode(**options(context, port=terminal.path, reply_margin=PATIENT_MARGIN, **given))
        names = ("torque_constant", "position_p_gain", "position_d_gain", "current_max")
        found = {name: node.get_parameter(name).value for name in names}
        node.close()
        node.destroy_node()
    p, d = XM430_W350.gains
    own = {"torque_constant": 4.1 / 2.3, "position_p_gain": p, "position_d_gain": d, "current_max": 2.3}
    assert found == pytest.approx({**own, **given})
    assert emulator.servo(2).table.get("position_p_gain") == found["position_p_gain"]


def test_no_two_registers_overlap() -> None:
    taken: dict[int, str] = {}
    blocks = {f"indirect address {n}": (registers.indirect_address(n), 2) for n in range(56)}
    blocks |= {f"indirect data {n}": (registers.indirect_data(n), 1) for n in range(56)}
    blocks |= {name: (register.address, register.size) for name, register in registers.REGISTERS.items()}
    for name, (address, size) in blocks.items():
        for place in range(address, address + size):
            assert place not in taken, f"{name} overlaps {taken[place]}"
            taken[place] = name


@pytest.mark.parametrize(("zero", "direction"), [(2048, 1), (-511, -1)])
def test_ticks_survive_the_round_trip(zero: int, direction: int) -> None:
    for ticks in range(-8192, 8193, 370):
        angle = registers.ticks_to_angle(ticks, zero, direction)
        assert registers.angle_to_ticks(angle, zero, direction) == ticks


def test_angle_convention() -> None:
    assert registers.ticks_to_angle(2048, 2048, 1) == 0.0
    assert registers.ticks_to_angle(3072, 2048, -1) == pytest.approx(-math.pi / 2)


@KINDS
def test_a_bound_is_never_rounded_up(kind: ServoType) -> None:
    for current in np.linspace(0.0, kind.largest_current, 500):
        counts = registers.current_to_counts(current, kind)
        assert current - kind.current_unit < counts * kind.current_unit <= current + 1e-9
        assert registers.current_to_counts(-current, kind) == -counts


@pytest.mark.parametrize("current", [0.7, 3.0])
def test_the_model_reaches_the_limit_when_predicted(current: float) -> None:
    model = controller.ThermalModel(MX_64)
    model.update(current, 0.0)
    promised = model.reserve()
    elapsed = 0.0
    while model.reserve() > 0.0:
        model.update(current, 1.0)
        elapsed += 1.0
    assert elapsed == pytest.approx(promised, abs=1.5)


def test_missing_data_never_cool_the_model() -> None:
    model = controller.ThermalModel(MX_64)
    model.update(2.0, 10.0)
    before = model.heat
    model.update(math.nan, 10.0)
    assert model.heat > before


def test_a_hot_servo_starts_with_the_heat_of_its_temperature() -> None:
    model = controller.ThermalModel(MX_64)
    model.start_at(math.nan)
    assert model.heat == 0.0
    model.start_at(80.0)
    model.update(1.0, 0.0)
    assert model.reserve() == 0.0
