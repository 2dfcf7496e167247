# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulated world, each with bounds and unit.

The light model is verified for every stiffness within the bounds (docs/reports/simulation.md).
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar

from deltacharger_core import machine, parameters
from deltacharger_core.parameters import flag, number
from deltacharger_sim.emulators.power import PortParameters, StageParameters

LITHIUM_7S: dict[str, Any] = {"empty_voltage": 19.0, "full_voltage": 29.4, "current": 10.0, "end_current": 0.5}
"""Values of docking's profile of the simulated target."""
STEP = 0.005  # s, integration step; verified for every stiffness up to 0.01 s


@dataclass(frozen=True)
class ServoParameters(parameters.Bounded):
    """MX-64 at 12 V in current-based position mode (5), at its horn; docs/simulation.md has the sources."""

    stall_torque: ClassVar[float] = machine.STALL_TORQUE  # N·m, whatever the current bound

    stiffness: float = number(
        machine.SERVO_STIFFNESS, 2.0, 40.0, "N·m/rad", "spring of the position loop, by the P gain"
    )
    damping: float = number(machine.SERVO_DAMPING, 0.0, 5.0, "N·m·s/rad", "damper of the position loop, by the D gain")
    viscosity: float = number(0.02, 0.0, 1.0, "N·m·s/rad", "drag of the gear, whatever the current bound")
    torque_constant: float = number(machine.TORQUE_CONSTANT, 0.5, 3.0, "N·m/A", "torque per current")
    friction: float = number(0.1, 0.0, 1.0, "N·m", "Coulomb friction of the powered gear without load")
    friction_share: float = number(0.2, 0.0, 0.9, "", "further friction as a share of the motor's torque")
    unpowered_friction: float = number(0.6, 0.0, 3.0, "N·m", "torque that turns the unpowered gear")
    backlash: float = number(0.0, 0.0, 0.05, "rad", "play between encoder and arm, from stop to stop")
    inertia: float = number(machine.SERVO_INERTIA, 0.0001, 0.05, "kg·m²", "rotor, reflected through the gear")
    current_noise: float = number(0.008, 0.0, 0.2, "A", "standard deviation of one current reading without load")
    current_noise_share: float = number(0.02, 0.0, 0.5, "", "further deviation as a share of the current")


@dataclass(frozen=True)
class ContactParameters(parameters.Bounded):
    """The two spring-mounted electrodes against the target's."""

    hard_stop: ClassVar[float] = 0.002  # m, travel at which an electrode reaches its stop
    hard_stop_stiffness: ClassVar[float] = 1e6  # N/m behind the stop
    stiffness: float = number(1e5, 1e3, 1e9, "N/m", "normal stiffness of each electrode")
    friction: float = number(0.3, 0.0, 10.0, "", "coefficient of Coulomb friction")


@dataclass(frozen=True)
class MagnetParameters(parameters.Bounded):
    """Six magnets together: F = force/(1 + g/range)² · max(floor, 1/(1 + (r/width)²)), gap g, lateral offset r."""

    range: ClassVar[float] = 0.002  # m of gap at which the pull has fallen to a quarter
    width: ClassVar[float] = machine.MAGNET_WIDTH
    floor: ClassVar[float] = machine.MAGNET_FLOOR
    force: float = number(
        machine.MAGNET_FORCE, 0.0, 300.0, "N", "pull of all magnets at contact, without lateral offset"
    )


@dataclass(frozen=True)
class PlatformParameters(parameters.Bounded):
    """Tilting of the platform under an off-centre or tilted contact; rigid by default."""

    compliance: float = number(0.0, 0.0, 0.1, "rad/(N·m)", "tilt about x and y per moment; 0 = rigid")
    lever: float = number(0.02, 0.0, 0.1, "m", "distance from the point it tilts about to its contact faces")


@dataclass(frozen=True)
class CableParameters(parameters.Bounded):
    """The charging cable at the platform; none by default."""

    stiffness: float = number(0.0, 0.0, 1000.0, "N/m", "pull of the cable per way from home")
    drag: float = number(0.0, 0.0, 20.0, "N", "friction of the cable in itself and its guides")

    @property
    def acts(self) -> bool:
        """Whether there is a cable that can be felt."""
        return self.stiffness > 0.0 or self.drag > 0.0


@dataclass(frozen=True)
class StandParameters(parameters.Bounded):
    """How far charger and target together yield on their wheels; rigid by default."""

    stiffness: float = number(
        0.0, 0.0, 1e6, "N/m", "of both robots' tyres and suspensions at the electrodes; 0 = rigid, and nothing rolls"
    )
    mass: float = number(25.0, 1.0, 1000.0, "kg", "reduced mass of both robots")
    play: float = number(0.0, 0.0, 0.02, "m", "play of the braked wheels, to either side")
    brakes: float = number(1000.0, 0.0, 10000.0, "N", "force at which the brakes slip; 0 = released")


@dataclass(frozen=True)
class TargetParameters(parameters.Bounded):
    """Pose of the target's electrodes in charger_base."""

    present: bool = flag(True, "false = no target to dock to")
    x: float = number(0.0, -0.2, 0.2, "m", "midpoint between the target's electrodes, along x of charger_base")
    y: float = number(0.0, -0.2, 0.2, "m", "midpoint between the target's electrodes, along y")
    z: float = number(machine.DOCK_DISTANCE, 0.0, 1.0, "m", "contact faces of the target, along z")
    roll: float = number(0.0, -0.8, 0.8, "rad", "turn of the target about z, from +x to +y")
    tilt_x: float = number(0.0, -0.1, 0.1, "rad", "tilt of the contact faces about x, relative to the platform")
    tilt_y: float = number(0.0, -0.1, 0.1, "rad", "tilt of the contact faces about y, relative to the platform")


@dataclass(frozen=True)
class CircuitParameters(parameters.Bounded):
    """Charger's battery, contactor and contacts."""

    battery_resistance: ClassVar[float] = 0.13  # Ω of that battery and its wires
    precharge_time: ClassVar[float] = 0.1  # s until both sides match within 1 V
    contact_resistance: ClassVar[float] = 0.01  # Ω of both contacts in series, fully overlapped, at 80 N
    wired: bool = flag(False, "true = no power stage: the electrodes are wired to the battery (power: none)")
    battery_voltage: float = number(
        26.0, machine.BATTERY_MIN, machine.BATTERY_MAX, "V", "voltage of the charger's battery (paper: 22.7–29.8 V)"
    )
    welded: bool = flag(False, "true = the contactor stays closed once it has closed")


@dataclass(frozen=True)
class WorldParameters(parameters.Bounded):
    """All parameters of the simulated world."""

    servo: ServoParameters = field(default_factory=ServoParameters)
    contact: ContactParameters = field(default_factory=ContactParameters)
    magnets: MagnetParameters = field(default_factory=MagnetParameters)
    platform: PlatformParameters = field(default_factory=PlatformParameters)
    target: TargetParameters = field(default_factory=TargetParameters)
    cable: CableParameters = field(default_factory=CableParameters)
    stand: StandParameters = field(default_factory=StandParameters)
    circuit: CircuitParameters = field(default_factory=CircuitParameters)
    stage: StageParameters = field(default_factory=StageParameters)
    port: PortParameters = field(default_factory=PortParameters)
    gravity_x: float = number(machine.GRAVITY[0], -20.0, 20.0, "m/s²", "gravity along x of charger_base")
    gravity_y: float = number(machine.GRAVITY[1], -20.0, 20.0, "m/s²", "gravity along y of charger_base")
    gravity_z: float = number(machine.GRAVITY[2], -20.0, 20.0, "m/s²", "gravity along z of charger_base")
