# SPDX-License-Identifier: Apache-2.0
"""Every parameter of docking and of a target's profile, with its bounds. docking_node declares its own from here."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from deltacharger_core import machine, parameters, servo_types
from deltacharger_core.machine import LONGEST_LEASE
from deltacharger_core.parameters import choice, number, numbers, tunable, words
from deltacharger_kinematics.geometry import Vector

POWERS = ("board", "none")
_ORDERED = (
    ("battery_voltage_min", "battery_voltage_start"),
    ("battery_voltage_start", "battery_voltage_max"),
)
"""Parameters of which the first must not lie above the second."""
_PUSH_ABOVE = 0.2  # A above the band at which a pushing servo's current is bounded: statics, then seeds 5 and 19
BAND_MARGIN = 0.015  # A, distance of an accepted reading from the band's lower end: statics, then seeds 5 and 19


@dataclass(frozen=True)
class DockingParameters(parameters.Bounded):
    """Parameters of the docking state machine; explained in docs/docking.md.

    Parameters of moving, pressing, aligning and waiting can be set between goals. Those that describe the machine or
    protect live electrodes are fixed while docking_node runs.

    Raises:
        ParameterError: a value lies outside its bounds, or two values contradict each other.
    """

    power: str = choice("board", POWERS, "board: contactor, limiter and probe; none: electrodes wired to the battery")
    servo_stiffness: float = number(
        machine.SERVO_STIFFNESS,
        servo_types.STIFFNESS_MIN,
        servo_types.STIFFNESS_MAX,
        "N·m/rad",
        "until it is estimated",
    )
    torque_constant: float = number(machine.TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current, as in servo_node")
    gravity: tuple[float, float, float] = numbers(
        machine.GRAVITY, -20.0, 20.0, "m/s²", "gravity in charger_base ({unit}), +z toward the target, +y up"
    )
    home_z: float = tunable(0.0, 0.0, 0.11, "m", "home position, z")
    # Chosen on seeds of the family 777001, then 5 and 19.
    travel_speed: float = tunable(0.12, 0.02, 0.5, "m/s", "peak speed in free air")
    search_speed: float = tunable(0.02, 0.003, 0.1, "m/s", "peak speed where contact is possible")
    press_speed: float = tunable(0.025, 0.001, 0.1, "m/s", "peak speed of steps, and near a known contact")
    standoff: float = tunable(0.018, 0.005, 0.05, "m", "distance before the expected contact where the force is tared")
    search_depth: float = tunable(0.025, 0.002, 0.05, "m", "distance beyond the expected contact where the search ends")
    # As in the paper.
    current_min: float = tunable(0.4, 0.15, 2.0, "A", "lower end of the contact current's band")
    current_max: float = tunable(0.5, 0.05, 2.0, "A", "upper end of the contact current's band")
    # The paper's critical angle, and below the electrodes that short at it.
    critical_angle: float = number(math.radians(12.0), 0.01, math.radians(12.05), "rad", "angle that would short")
    electrode_half_gap: float = number(0.5 * machine.BAR_GAP, 0.0005, 0.02, "m", "half the gap between the two bars")
    electrode_half_length: float = number(0.5 * machine.BAR_LENGTH, 0.005, 0.1, "m", "half the length of a bar")
    # From the formula of the clearance, and a rate of unsafe acts by the normal distribution and its tails.
    clearance_min: float = number(0.0003, 0.0, 0.005, "m", "clearance that must remain at 3 standard deviations")
    # Chosen on seeds 5 and 19.
    landing_limit: float = tunable(0.0025, 0.001, 0.02, "m", "largest offset of a contact across the bars")
    overlap_loss_max: float = tunable(0.004, 0.001, 0.03, "m", "largest offset along the bars: lost overlap")
    # Accuracy of a robot's place and of a goal's pose, and the middle of the campaigns' range; differ by site.
    place_stddev: float = number(0.005, 1e-4, 0.05, "m", "standard deviation of the pose in a goal")
    yaw_stddev: float = number(math.radians(1.2), 0.0, 0.2, "rad", "standard deviation of an unknown yaw; 0 = parallel")
    platform_compliance: float = number(0.02, 0.0, 0.1, "rad/(N·m)", "tilt of the platform per moment; 0 = rigid")
    magnet_force: float = number(machine.MAGNET_FORCE, 0.0, 300.0, "N", "pull of the magnets in contact without offset")
    charge_stable_time: float = tunable(1.0, 0.1, 10.0, "s", "time of charge current before docking succeeds")
    battery_voltage_min: float = number(machine.BATTERY_MIN, 1.0, 60.0, "V", "own battery that ends charging after 5 s")
    battery_voltage_start: float = number(23.7, 1.0, 60.0, "V", "lowest voltage of the own battery for closing")
    battery_voltage_max: float = number(machine.BATTERY_MAX, 1.0, 60.0, "V", "highest voltage of the own battery")
    hold_max: float = tunable(14400.0, 1.0, 604800.0, "s", "longest rest on a target since the last goal")
    age_max: float = number(0.5, 0.1, 2.0, "s", "age of servo_state, tactile_frame or charger_power that ends docking")
    live_servo_age_max: float = number(LONGEST_LEASE, 0.02, 0.5, "s", "age of servo_state that opens the contactor")
    goal_timeout: float = tunable(300.0, 12.0, 600.0, "s", "limit for a docking until it succeeds")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.current_min + 2 * BAND_MARGIN < self.current_max:
            problem = f"current_max must be more than {2 * BAND_MARGIN:g} A above it"
            raise parameters.ParameterError("current_min", self.current_min, problem)
        for lower, upper in _ORDERED:
            if (low := getattr(self, lower)) > (high := getattr(self, upper)):
                raise parameters.ParameterError(
                    lower, low, f"{low:g} is above {upper}, {high:g}: lower it, or raise {upper}"
                )

    @classmethod
    def of(cls, servo: servo_types.ServoType) -> DockingParameters:
        """Return the defaults for a type of servo: contact currents are the same forces on every type."""
        least, most = servo_types.contact_band(servo)
        return cls(torque_constant=servo.torque_constant, current_min=least, current_max=most)

    @property
    def always_live(self) -> bool:
        """Whether electrodes are live whenever they touch, and charge current is not measured."""
        return self.power == "none"

    @property
    def hard_current(self) -> float:
        """Contact current (A) that ends docking, except in RETRACT: twice the band's upper end."""
        return 2.0 * self.current_max

    @property
    def push_current(self) -> float:
        """Current bound (A) of each servo above its free-motion current, while it pushes."""
        return self.current_max + _PUSH_ABOVE

    @property
    def home(self) -> Vector:
        """Resting position in charger_base, m."""
        return 0.0, 0.0, self.home_z

    @property
    def current_target(self) -> float:
        """Middle of the contact current's band, A."""
        return 0.5 * (self.current_min + self.current_max)


@dataclass(frozen=True)
class DockingNodeParameters(parameters.Bounded):
    """Its servos, and where the charger is on its robot.

    Raises:
        ParameterError: a value lies outside its bounds, or base_pose has a quaternion of length zero.
    """

    servo_type: str = choice(
        servo_types.MX_64.name,
        tuple(each.name for each in servo_types.TYPES.values()),
        "the arm's; contact currents that are not given follow it",
    )
    base_frame: str = words("base_link", "the robot's frame for goals, in addition to charger_base")
    base_pose: tuple[float, ...] = parameters.pose((0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5), "charger_base in base_frame")

    @property
    def servo(self) -> servo_types.ServoType:
        """The type of the arm's servos."""
        return next(each for each in servo_types.TYPES.values() if each.name == self.servo_type)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not any(self.base_pose[3:]):
            problem = "its quaternion is zero: give x y z, then a quaternion x y z w of nonzero length"
            raise parameters.ParameterError("base_pose", self.base_pose, problem)


PORTS = ("live", "dead")
_BELOW = (("empty_voltage", "full_voltage"), ("end_current", "current"), ("least_current", "current"))


@dataclass(frozen=True)
class TargetProfile(parameters.Bounded):
    """What one kind of target allows; docs/targets.md says how to find it with a multimeter.

    Raises:
        ParameterError: a value is missing or outside its bounds, or two contradict each other.
    """

    empty_voltage: float = number(0.0, 1.0, 60.0, "V", "voltage at the port below which the target must not be charged")
    full_voltage: float = number(0.0, 1.0, 60.0, "V", "voltage at the port when the target is full; never exceeded")
    current: float = number(0.0, 0.1, 18.0, "A", "largest current into the port")
    end_current: float = number(0.0, 0.05, 18.0, "A", "current at full voltage below which the target is full")
    least_current: float = number(0.5, 0.05, 0.5, "A", "current that counts as charging")
    port: str = choice("live", PORTS, "live: the battery's voltage lies at the port; dead: not before a charger's does")
    start_time: float = number(3.0, 1.0, 60.0, "s", "time from closing until the target takes current, at most")
    gap_time: float = number(0.2, 0.1, 120.0, "s", "time without current that is tolerated")
    standing_load: float = number(0.0, 0.0, 300.0, "W", "what the target itself uses while it is charged")

    def __post_init__(self) -> None:
        super().__post_init__()
        for lower, upper in _BELOW:
            if not getattr(self, lower) < getattr(self, upper):
                raise parameters.ParameterError(lower, getattr(self, lower), f"{lower} must lie below {upper}")

    @property
    def standing_current(self) -> float:
        """A of the standing load at full voltage."""
        return self.standing_load / self.full_voltage

    @property
    def rest_current(self) -> float:
        """A at full voltage below which the target is full."""
        return self.end_current + self.standing_current


@dataclass(frozen=True)
class ProfileNames(parameters.Bounded):
    """Which targets the installation knows; the parameters of each have its name as prefix.

    Raises:
        ParameterError: a name is given twice, or cannot be part of a parameter's name.
    """

    target_profiles: tuple[str, ...] = words((), "names of the targets' profiles, the first is the default")

    def __post_init__(self) -> None:
        super().__post_init__()
        for index, name in enumerate(self.target_profiles):
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
                raise parameters.ParameterError(
                    "target_profiles", name, f"'{name}': give letters, digits and _, a letter first"
                )
            if name in self.target_profiles[:index]:
                raise parameters.ParameterError("target_profiles", name, f"'{name}' is listed twice")
