# SPDX-License-Identifier: Apache-2.0
"""Types of servos, each one row of data, and the content of a file of measured servos.

Whoever adds a type adds its row here and its test, and nothing else.
Every type speaks Protocol 2.0, has the control table of the vendor's X series, counts 4096 per turn and knows mode 5
(current-based position). All figures are from the vendor's e-manuals for 12 V, except where a row says otherwise.
"""

import math
from dataclasses import dataclass

from deltacharger_core import machine, parameters
from deltacharger_core.parameters import number, words

SPEEDS = {0: 9600, 1: 57600, 2: 115200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000}
"""Value of the baud register → bit/s; 7 (4.5 M) is not a standard speed of Linux."""
PAPER_BAND = (0.4, 0.5)
"""A of contact current in touch, least and most, on the paper's MX-64."""


@dataclass(frozen=True)
class ServoType:
    """A type of servo.

    Attributes:
        name: the vendor's.
        model: model number, as a ping tells it.
        current_unit: A per count.
        current_limit: counts, default and largest value of the current registers.
        velocity_limit: counts, default of this register.
        position_p_gain: default of this register.
        stall_torque: N·m.
        stall_current: A.
        joint_speed: rad/s that an arm turns at most, loaded.
        heat_current: A with which the winding, cold, reaches its limit in `heat_time`.
        heat_time: s.
        heat_constant: s, time constant of its cooling.
        lacks: registers of the MX-64 that it does not have.
        model_protocol_1: model number with the older Protocol 1.0; 0 = there is none.
        velocity_unit, voltage_unit: rad/s and V per count.
        pwm_limit: counts, the full supply.
        temperature_limit: °C, its rating.
        voltage_min, voltage_max: counts, range of the supply.
    """

    name: str
    model: int
    current_unit: float
    current_limit: int
    velocity_limit: int
    position_p_gain: int
    stall_torque: float
    stall_current: float
    joint_speed: float
    heat_current: float
    heat_time: float = 120.0
    heat_constant: float = 4000.0
    lacks: frozenset[str] = frozenset()
    model_protocol_1: int = 0
    velocity_unit: float = 0.229 * 2.0 * math.pi / 60.0
    voltage_unit: float = 0.1
    pwm_limit: int = 885
    temperature_limit: int = 80
    voltage_min: int = 95
    voltage_max: int = 160

    def __str__(self) -> str:
        return f"{self.name} ({self.model})"

    @property
    def torque_constant(self) -> float:
        """N·m/A, without friction."""
        return self.stall_torque / self.stall_current

    @property
    def largest_current(self) -> float:
        """A, the largest that its registers accept."""
        return self.current_limit * self.current_unit

    @property
    def stiffness_per_gain(self) -> float:
        """N·m/rad per count of the position P gain, as `machine.STIFFNESS_PER_GAIN`."""
        return self.stall_torque / self.pwm_limit / 128 * machine.TICKS_PER_TURN / (2.0 * math.pi)

    @property
    def damping_per_gain(self) -> float:
        """N·m·s/rad per count of the position D gain, as `machine.DAMPING_PER_GAIN`."""
        return self.stall_torque / self.pwm_limit / 16 * machine.TICKS_PER_TURN / (2.0 * math.pi) * 0.001

    @property
    def gains(self) -> tuple[int, int]:
        """Position P and D gain with which it is as stiff and as damped as every other type."""
        return round(machine.SERVO_STIFFNESS / self.stiffness_per_gain), round(
            machine.SERVO_DAMPING / self.damping_per_gain
        )

    @property
    def current_bound(self) -> float:
        """A with the torque of `machine.CURRENT_BOUND` on an MX-64."""
        return machine.CURRENT_BOUND * (MX_64.torque_constant / self.torque_constant)

    @property
    def heat_limit(self) -> float:
        """A²s above rest at which its winding reaches its limit."""
        grown = -math.expm1(-self.heat_time / self.heat_constant)
        return self.heat_current * self.heat_current * self.heat_constant * grown


MX_64 = ServoType(
    name="MX-64",
    model=311,
    model_protocol_1=310,
    current_unit=3.36e-3,
    current_limit=1941,
    velocity_limit=285,
    position_p_gain=850,
    stall_torque=machine.STALL_TORQUE,
    stall_current=machine.STALL_CURRENT,
    joint_speed=machine.JOINT_SPEED,
    heat_current=3.0,  # servos/report.py has the statements on which it rests
)
"""The paper's, with firmware for Protocol 2.0."""
XM430_W350 = ServoType(
    name="XM430-W350",
    model=1020,
    current_unit=2.69e-3,
    current_limit=1193,
    velocity_limit=200,
    position_p_gain=800,
    stall_torque=4.1,
    stall_current=2.3,
    joint_speed=3.5,  # 46 rpm without load, where the MX-64 has 63: the same share of it
    # Nobody measured it. As much heat per gram as in an MX-64: 3 A · √(2.3 A / 4.1 A · 82 g / 126 g) = 1.81 A.
    heat_current=1.8,
    lacks=frozenset({"acceleration_limit"}),  # older e-manuals list it; without a profile it limits nothing
)
TYPES = {each.model: each for each in (MX_64, XM430_W350)}
"""Every type by its model number."""
NAMES = " or ".join(map(str, TYPES.values()))
"""All of them, for messages."""


def model_name(model: int) -> str:
    """Return the name of a type by its model number, also of one with Protocol 1.0; "model N" of an unknown one."""
    older = {each.model_protocol_1: f"{each.name} for Protocol 1.0" for each in TYPES.values() if each.model_protocol_1}
    return TYPES[model].name if model in TYPES else older.get(model, f"model {model}")


def contact_band(servo: ServoType) -> tuple[float, float]:
    """Return the least and the most contact current (A) in touch: on every type the force of `PAPER_BAND`.

    A force on the platform takes the same torque of every type, so the current goes with 1 / torque constant.
    """
    least, most = (current * (MX_64.torque_constant / servo.torque_constant) for current in PAPER_BAND)
    return least, most


STIFFNESS_MIN, STIFFNESS_MAX = 0.5, 160.0
"""N·m/rad, range that docking accepts."""


@dataclass(frozen=True)
class ServosFileParameters(parameters.Bounded):
    """Path of the file of measured servos."""

    servos_file: str = words("", "YAML file of `deltacharger calibrate servos`; the only source of the values in it")


@dataclass(frozen=True)
class MeasuredServos(parameters.Bounded):
    """What nodes use of an arm's measured servos: means of the three, and the gains of the measurement."""

    stiffness: float = number(machine.SERVO_STIFFNESS, STIFFNESS_MIN, STIFFNESS_MAX, "N·m/rad", "of the position loop")
    torque_constant: float = number(machine.TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current")
    position_p_gain: int = number(machine.POSITION_P_GAIN, 1, machine.GAIN_MAX, "", "P gain during the measurement")
    position_d_gain: int = number(machine.POSITION_D_GAIN, 0, machine.GAIN_MAX, "", "D gain during the measurement")
