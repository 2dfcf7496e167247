# SPDX-License-Identifier: Apache-2.0
"""Worlds whose parameters are each possible and together are not: which key is at fault, and what to write instead."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deltacharger_sim.parameters import WorldParameters

SOFT = 1e4  # N/m per electrode; softer springs let the magnets pull the electrodes in by more than their travel
DEEPEST_SOFT_STOP = 0.002  # m of travel that soft springs may have before their stop
_LEVER = 0.038  # m of dz/dθ at the dock: what a servo's torque presses with

Contradiction = tuple[str, Any, str]


def contradictions(world: WorldParameters) -> Iterator[Contradiction]:
    """Yield (key, value, problem) of everything in a world that cannot be together; nothing where all is well."""
    yield from _servo(world)
    yield from _contact(world)
    yield from _circuit(world)


def _servo(world: WorldParameters) -> Iterator[Contradiction]:
    servo = world.servo
    if servo.friction >= servo.stall_torque:
        yield (
            "servo.friction",
            servo.friction,
            f"{servo.friction!r} N·m is not below servo.stall_torque ({servo.stall_torque!r} N·m): no servo could turn",
        )
    drop = servo.supply_resistance * 3.0 * servo.stall_torque / servo.torque_constant
    if drop >= servo.supply_voltage:
        yield (
            "servo.supply_resistance",
            servo.supply_resistance,
            f"{servo.supply_resistance!r} Ω lets the supply fall by {drop:.1f} V when all servos stall, "
            f"more than servo.supply_voltage ({servo.supply_voltage!r} V) has; give a smaller one",
        )


def _contact(world: WorldParameters) -> Iterator[Contradiction]:
    contact = world.contact
    if contact.stiffness < SOFT and contact.hard_stop > DEEPEST_SOFT_STOP:
        yield (
            "contact.hard_stop",
            contact.hard_stop,
            f"{contact.hard_stop!r} m is too deep for contact.stiffness {contact.stiffness:g} N/m: below {SOFT:g} N/m "
            f"the magnets pull the electrodes in until they stop; give at most {DEEPEST_SOFT_STOP} m",
        )
    strongest = world.magnets.force + 3.0 * world.servo.stall_torque / _LEVER
    bottoms = 2.0 * contact.stiffness * contact.hard_stop < strongest
    if bottoms and contact.hard_stop_stiffness < 2.0 * contact.stiffness:
        yield (
            "contact.hard_stop_stiffness",
            contact.hard_stop_stiffness,
            f"{contact.hard_stop_stiffness:g} N/m is softer than the springs that bottom on it "
            f"(contact.stiffness {contact.stiffness:g} N/m each); give at least {2.0 * contact.stiffness:g} N/m",
        )


def _circuit(world: WorldParameters) -> Iterator[Contradiction]:
    circuit = world.circuit
    if circuit.voltage_min >= circuit.voltage_max:
        yield (
            "circuit.voltage_min",
            circuit.voltage_min,
            f"{circuit.voltage_min!r} V is not below circuit.voltage_max ({circuit.voltage_max!r} V)",
        )
    elif circuit.voltage_limit < circuit.voltage_min:
        yield (
            "circuit.voltage_limit",
            circuit.voltage_limit,
            f"{circuit.voltage_limit!r} V is below circuit.voltage_min ({circuit.voltage_min!r} V): "
            "no target that the stage feeds could take current",
        )
