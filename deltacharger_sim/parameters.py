# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulated world, each with bounds and unit, and where the light model has been verified."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from deltacharger_core.machine import (
    BAR_GAP,
    BAR_HEIGHT,
    BAR_LENGTH,
    BATTERY_MAX,
    BATTERY_MIN,
    DOCK_DISTANCE,
    GRAVITY,
    MAGNET_FLOOR,
    MAGNET_FORCE,
    MAGNET_WIDTH,
    NOMINAL_VOLTAGE,
    SERVO_DAMPING,
    SERVO_INERTIA,
    SERVO_STIFFNESS,
    STALL_TORQUE,
    TORQUE_CONSTANT,
)
from deltacharger_core.parameters import Bounded, ParameterError, flag, number
from deltacharger_driver.emulators.power import PortParameters, StageParameters
from deltacharger_sim.stability_map import CELLS, CONTACT_STIFFNESSES, PROVEN, SERVO_STIFFNESSES, STEPS

SOFT = 1e4  # N/m per electrode; with softer springs, the magnets pull the electrodes in by more than their travel
DEEPEST_SOFT_STOP = 0.002  # m, largest travel of soft springs before their stop
LEVER = 0.038  # m, dz/dθ at the dock: lever of a servo's torque


@dataclass(frozen=True)
class ServoParameters(Bounded):
    """MX-64 at 12 V in current-based position mode (5), at its horn; docs/simulation.md has the sources."""

    stiffness: float = number(SERVO_STIFFNESS, 2.0, 40.0, "N·m/rad", "spring of the position loop, by the P gain")
    damping: float = number(SERVO_DAMPING, 0.0, 5.0, "N·m·s/rad", "damper of the position loop, by the D gain")
    viscosity: float = number(0.02, 0.0, 1.0, "N·m·s/rad", "drag of the gear, whatever the current bound")
    stall_torque: float = number(STALL_TORQUE, 0.5, 12.0, "N·m", "largest torque whatever the current bound")
    torque_constant: float = number(TORQUE_CONSTANT, 0.5, 3.0, "N·m/A", "torque per current")
    friction: float = number(0.1, 0.0, 1.0, "N·m", "Coulomb friction of the powered gear without load")
    friction_share: float = number(0.2, 0.0, 0.9, "", "further friction as a share of the motor's torque")
    unpowered_friction: float = number(0.6, 0.0, 3.0, "N·m", "torque that turns the unpowered gear")
    backlash: float = number(0.0, 0.0, 0.05, "rad", "play between encoder and arm, from stop to stop")
    inertia: float = number(SERVO_INERTIA, 0.0001, 0.05, "kg·m²", "rotor, reflected through the gear")
    current_noise: float = number(0.008, 0.0, 0.2, "A", "standard deviation of one current reading without load")
    current_noise_share: float = number(0.02, 0.0, 0.5, "", "further deviation as a share of the current")
    supply_voltage: float = number(NOMINAL_VOLTAGE, 9.5, 16.0, "V", "output of the regulator")
    supply_resistance: float = number(0.05, 0.0, 1.0, "Ω", "resistance of regulator and cable, shared by the servos")
    stall_sag: float = number(0.0, 0.0, 1.0, "", "share of the stall torque that follows the supply voltage below 12 V")
    command_latency: float = number(0.0, 0.0, 0.2, "s", "delay until a servo obeys a command")
    reading_latency: float = number(0.0, 0.0, 0.2, "s", "age of a servo's readings")


@dataclass(frozen=True)
class ContactParameters(Bounded):
    """The two spring-mounted electrodes against the target's."""

    stiffness: float = number(1e5, 1e3, 1e9, "N/m", "normal stiffness of each electrode")
    friction: float = number(0.3, 0.0, 10.0, "", "coefficient of Coulomb friction")
    hard_stop: float = number(0.002, 0.0005, 0.02, "m", "travel at which the electrode reaches its stop")
    hard_stop_stiffness: float = number(1e6, 1e4, 1e9, "N/m", "stiffness behind the stop")


@dataclass(frozen=True)
class MagnetParameters(Bounded):
    """Six magnets together: F = force/(1 + g/range)² · max(floor, 1/(1 + (r/width)²)), gap g, lateral offset r."""

    force: float = number(MAGNET_FORCE, 0.0, 300.0, "N", "pull of all magnets at contact, without lateral offset")
    range: float = number(0.002, 0.0002, 0.02, "m", "gap at which the pull has fallen to a quarter")
    width: float = number(MAGNET_WIDTH, 0.001, 0.1, "m", "lateral offset at which the pull has fallen to a half")
    floor: float = number(MAGNET_FLOOR, 0.0, 1.0, "", "smallest share of the pull, at a large lateral offset")


@dataclass(frozen=True)
class TerminalParameters(Bounded):
    """The two bars of charger and target alike."""

    length: float = number(BAR_LENGTH, 0.01, 0.2, "m", "length of a bar, along x")
    height: float = number(BAR_HEIGHT, 0.002, 0.05, "m", "height of a bar, along y")
    gap: float = number(BAR_GAP, 0.001, 0.05, "m", "gap between the bars")


@dataclass(frozen=True)
class PlatformParameters(Bounded):
    """Tilting of the platform under an off-centre or tilted contact; rigid by default."""

    compliance: float = number(0.0, 0.0, 0.1, "rad/(N·m)", "tilt about x and y per moment; 0 = rigid")
    lever: float = number(0.02, 0.0, 0.1, "m", "distance from the point it tilts about to its contact faces")


@dataclass(frozen=True)
class CableParameters(Bounded):
    """The charging cable at the platform; none by default."""

    stiffness: float = number(0.0, 0.0, 1000.0, "N/m", "pull of the cable per way from home")
    drag: float = number(0.0, 0.0, 20.0, "N", "friction of the cable in itself and its guides")

    @property
    def acts(self) -> bool:
        """Whether there is a cable that can be felt."""
        return self.stiffness > 0.0 or self.drag > 0.0


@dataclass(frozen=True)
class StandParameters(Bounded):
    """How far charger and target together yield on their wheels; rigid by default."""

    stiffness: float = number(
        0.0, 0.0, 1e6, "N/m", "of both robots' tyres and suspensions at the electrodes; 0 = rigid, and nothing rolls"
    )
    mass: float = number(25.0, 1.0, 1000.0, "kg", "reduced mass of both robots")
    play: float = number(0.0, 0.0, 0.02, "m", "play of the braked wheels, to either side")
    brakes: float = number(1000.0, 0.0, 10000.0, "N", "force at which the brakes slip; 0 = released")


@dataclass(frozen=True)
class TargetParameters(Bounded):
    """Pose of the target's electrodes in charger_base."""

    present: bool = flag(True, "false = no target to dock to")
    x: float = number(0.0, -0.2, 0.2, "m", "midpoint between the target's electrodes, along x of charger_base")
    y: float = number(0.0, -0.2, 0.2, "m", "midpoint between the target's electrodes, along y")
    z: float = number(DOCK_DISTANCE, 0.0, 1.0, "m", "contact faces of the target, along z")
    roll: float = number(0.0, -0.8, 0.8, "rad", "turn of the target about z, from +x to +y")
    tilt_x: float = number(0.0, -0.1, 0.1, "rad", "tilt of the contact faces about x, relative to the platform")
    tilt_y: float = number(0.0, -0.1, 0.1, "rad", "tilt of the contact faces about y, relative to the platform")


@dataclass(frozen=True)
class CircuitParameters(Bounded):
    """Charger's battery, contactor and contacts."""

    wired: bool = flag(False, "true = no power stage: the electrodes are wired to the battery (power: none)")
    battery_voltage: float = number(
        26.0, BATTERY_MIN, BATTERY_MAX, "V", "voltage of the charger's battery (paper: 22.7–29.8 V)"
    )
    battery_resistance: float = number(0.13, 0.001, 10.0, "Ω", "resistance of that battery and its wires")
    precharge_time: float = number(0.1, 0.0, 1.0, "s", "pre-charge until both sides match within 1 V")
    contact_resistance: float = number(
        0.01, 0.0, 10.0, "Ω", "resistance of both contacts in series, fully overlapped, at 80 N"
    )
    welded: bool = flag(False, "true = the contactor stays closed once it has closed")


@dataclass(frozen=True)
class WorldParameters(Bounded):
    """All parameters of the simulated world; contradictory ones are refused by key."""

    servo: ServoParameters = field(default_factory=ServoParameters)
    contact: ContactParameters = field(default_factory=ContactParameters)
    magnets: MagnetParameters = field(default_factory=MagnetParameters)
    terminal: TerminalParameters = field(default_factory=TerminalParameters)
    platform: PlatformParameters = field(default_factory=PlatformParameters)
    target: TargetParameters = field(default_factory=TargetParameters)
    cable: CableParameters = field(default_factory=CableParameters)
    stand: StandParameters = field(default_factory=StandParameters)
    circuit: CircuitParameters = field(default_factory=CircuitParameters)
    stage: StageParameters = field(default_factory=StageParameters)
    port: PortParameters = field(default_factory=PortParameters)
    gravity_x: float = number(GRAVITY[0], -20.0, 20.0, "m/s²", "gravity along x of charger_base")
    gravity_y: float = number(GRAVITY[1], -20.0, 20.0, "m/s²", "gravity along y of charger_base")
    gravity_z: float = number(GRAVITY[2], -20.0, 20.0, "m/s²", "gravity along z of charger_base")
    step: float = number(0.005, 0.0001, 0.1, "s", "integration step")

    def __post_init__(self) -> None:
        super().__post_init__()
        for key, problem in contradictions(self):
            raise ParameterError(key, operator.attrgetter(key)(self), problem)


def contradictions(world: WorldParameters) -> Iterator[tuple[str, str]]:
    """Yield (key, problem) of each contradiction in a world."""
    yield from _servo(world)
    yield from _contact(world)


def _servo(world: WorldParameters) -> Iterator[tuple[str, str]]:
    servo = world.servo
    if servo.friction >= servo.stall_torque:
        yield (
            "servo.friction",
            f"{servo.friction!r} N·m is not below servo.stall_torque ({servo.stall_torque!r} N·m): no servo could move",
        )
    drop = servo.supply_resistance * 3.0 * servo.stall_torque / servo.torque_constant
    if drop >= servo.supply_voltage:
        yield (
            "servo.supply_resistance",
            f"{servo.supply_resistance!r} Ω lets the supply fall by {drop:.1f} V when all servos stall, "
            f"more than servo.supply_voltage ({servo.supply_voltage!r} V): give a smaller one",
        )


def _contact(world: WorldParameters) -> Iterator[tuple[str, str]]:
    contact = world.contact
    if contact.stiffness < SOFT and contact.hard_stop > DEEPEST_SOFT_STOP:
        yield (
            "contact.hard_stop",
            f"{contact.hard_stop!r} m is too deep for contact.stiffness {contact.stiffness:g} N/m: below {SOFT:g} N/m "
            f"the magnets pull the electrodes in to their stop: give at most {DEEPEST_SOFT_STOP} m",
        )
    strongest = world.magnets.force + 3.0 * world.servo.stall_torque / LEVER
    bottoms = 2.0 * contact.stiffness * contact.hard_stop < strongest
    if bottoms and contact.hard_stop_stiffness < 2.0 * contact.stiffness:
        yield (
            "contact.hard_stop_stiffness",
            f"{contact.hard_stop_stiffness:g} N/m is softer than the springs that bottom on it "
            f"(contact.stiffness {contact.stiffness:g} N/m each): give at least {2.0 * contact.stiffness:g} N/m",
        )


class UnprovenWarning(UserWarning):
    """The simulation has not been verified for this step and these stiffnesses."""


def doubts(parameters: WorldParameters) -> tuple[str, ...]:
    """Return the doubts about a world's step and stiffnesses; empty if they are verified.

    Between points of the map, all neighbours must be verified. The map comes from `deltacharger report simulation`:
    nothing diverged, the settled force is within 0.5 % of a bisection, path and peak force are within 0.3 mm rms and
    15 % of the converged reference on the axis.
    """
    asked = parameters.servo.stiffness, parameters.contact.stiffness, parameters.step
    axes = (SERVO_STIFFNESSES, CONTACT_STIFFNESSES, STEPS)
    around = [_around(axis, value) for axis, value in zip(axes, asked, strict=True)]
    if all(around) and all(proven(i, j, k) for i in around[0] for j in around[1] for k in around[2]):
        return ()
    servo, contact, step = nearest(*asked)
    return (
        f"step {asked[2]:g} s with contact.stiffness {asked[1]:g} N/m and servo.stiffness {asked[0]:g} N·m/rad has "
        f"not been verified; the nearest verified point: step {step:g} s, contact.stiffness {contact:g} N/m, "
        f"servo.stiffness {servo:g} N·m/rad",
    )


def proven(servo: int, contact: int, step: int) -> bool:
    """Return whether the map's point with these indices is verified."""
    return CELLS[servo][contact][step] == PROVEN


def nearest(servo: float, contact: float, step: float) -> tuple[float, float, float]:
    """Return servo stiffness (N·m/rad), contact stiffness (N/m) and step (s) of the nearest verified point by ratio."""
    points = [
        (SERVO_STIFFNESSES[i], CONTACT_STIFFNESSES[j], STEPS[k])
        for i in range(len(SERVO_STIFFNESSES))
        for j in range(len(CONTACT_STIFFNESSES))
        for k in range(len(STEPS))
        if proven(i, j, k)
    ]
    asked = (servo, contact, step)
    return min(points, key=lambda point: sum(abs(math.log(a / b)) for a, b in zip(point, asked, strict=True)))


def _around(axis: Sequence[float], value: float) -> list[int]:
    """Return the indices of the one or two points of an axis around `value`; none outside."""
    same = [index for index, point in enumerate(axis) if math.isclose(point, value, rel_tol=1e-9)]
    if same:
        return same
    return [index for index in range(len(axis)) if _holds(axis, index, value) or _holds(axis, index - 1, value)]


def _holds(axis: Sequence[float], index: int, value: float) -> bool:
    return 0 <= index < len(axis) - 1 and axis[index] < value < axis[index + 1]
