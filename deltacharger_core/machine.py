# SPDX-License-Identifier: Apache-2.0
"""Constants of the machine, each with its source. SI units.

Axes are those of `charger_base`: +z points at the target, +y is up. Values that users may change are declared
parameters; their defaults refer to these constants.
"""

import math
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

JOINTS = ("limb_0_arm_joint", "limb_1_arm_joint", "limb_2_arm_joint")
"""Driven joints in the order of the limbs, as named in the URDF and in every message."""
SERVO_IDS = (1, 2, 3)
"""Bus ids of limbs 0, 1, 2. DYNAMIXEL's default is 1 for every servo."""
BEHIND_BOARD = "board"
"""Value of the servo port if the servos are connected to the board."""
TICKS_PER_TURN, EXTENDED_TICKS = 4096, 1_048_575
"""Encoder counts per turn, and the largest goal in modes 4 and 5 (±256 turns)."""
BAUD_RATE = 1_000_000
"""bit/s of the servo bus and of a board on a UART."""

STALL_TORQUE, STALL_CURRENT, NOMINAL_VOLTAGE = 6.0, 4.1, 12.0
"""N·m, A and V: MX-64 stall torque and current at 12 V (vendor's e-manual)."""
TORQUE_CONSTANT = STALL_TORQUE / STALL_CURRENT
"""N·m/A, ±5 %, without friction."""
SERVO_STIFFNESS, SERVO_DAMPING = 15.0, 0.75
"""N·m/rad at P gain `POSITION_P_GAIN`, N·m·s/rad at D gain `POSITION_D_GAIN`. Both follow the vendor's formulas
of modes 3 and 4; `deltacharger calibrate servos` measures them. In mode 5 nothing but the D gain brakes."""
SERVO_INERTIA = 0.012
"""kg·m², rotor reflected through the gear (BAM's fit of the MX-64: 0.011 to 0.012)."""
STIFFNESS_PER_GAIN = STALL_TORQUE / 885 / 128 * TICKS_PER_TURN / (2.0 * math.pi)
"""N·m/rad per count of the position P gain at 12 V. By the vendor's e-manual, register / 128 converts ticks of error to
PWM, and PWM 885 is the full supply (stall torque). It states no unit for mode 5."""
DAMPING_PER_GAIN = STALL_TORQUE / 885 / 16 * TICKS_PER_TURN / (2.0 * math.pi) * 0.001
"""N·m·s/rad per count of the position D gain: register / 16 converts ticks a sample to PWM (e-manual); samples of 1 ms
are assumed."""
POSITION_P_GAIN = round(SERVO_STIFFNESS / STIFFNESS_PER_GAIN)
"""Position P gain that gives `SERVO_STIFFNESS`; the vendor's default is 850."""
POSITION_D_GAIN = round(SERVO_DAMPING / DAMPING_PER_GAIN)
"""Position D gain that gives `SERVO_DAMPING`, 0.9 of what is critical; half and twice as much still settle."""
JOINT_MIN, JOINT_MAX = math.radians(-65.0), math.radians(70.0)
"""rad, range of an arm's angle."""
STRAY_BEHIND, STRAY_OUTSIDE = 1, 2
STRAYS = {
    STRAY_BEHIND: "is farther from its goal than its current explains: look for what blocks it, and at its horn, gear "
    "and cable",
    STRAY_OUTSIDE: "is outside its range: look at its horn, its rod and zero_ticks",
}
"""Why servo_node stops the arm, as in ServoState."""


def in_words(stray: Iterable[int]) -> str:
    """Return which servos stray and why, from ServoState.stray; '' = none."""
    named = ((number, why) for number, why in enumerate(stray, 1) if why)
    return "; ".join(f"servo {number} {STRAYS.get(why, f'strays, for reason {why}')}" for number, why in named)


JOINT_SPEED = 4.9
"""rad/s that an arm turns at most: what the heaviest pose and 0.7 A of push leave of the 6.60 without load (63 rpm, by
the vendor's e-manual)."""
GAIN_MAX = 16383
"""Largest value of a gain register (vendor's e-manual)."""
CURRENT_BOUND = 0.83
"""A per servo, default if a trajectory sets no bound."""
ZERO_CURRENT = 0.5
"""A between charger and target; smaller currents count as zero."""
BATTERY_MIN, BATTERY_MAX = 22.7, 29.8
"""V of the charger's battery, empty and full (paper)."""
GRAVITY_STRENGTH = 9.81
"""m/s²."""
GRAVITY = (0.0, -GRAVITY_STRENGTH, 0.0)
"""m/s² in `charger_base` of a level robot."""

PADS, ROWS, COLUMNS = 2, 10, 10
"""Number of tactile pads; rows and columns of taxels per pad (paper)."""
FRAME_RATE = 120.0
"""Hz, sampling of both pads (paper)."""
CONTACT_FORCE = 1.0
"""N; a taxel at or above it is in contact. Smallest force of the published sensor's range (1–9 N)."""

LONGEST_LEASE = 0.25
"""s that the contactor stays closed unless the lease is renewed."""
PROBE_LIFETIME = 2.0
"""s; a close needs a probe younger than this."""
ORDER_AGE_MAX = 2.0
"""s after which an order about torque, tare, probe or contactor is refused: docking waits no longer for a probe."""
DOCK_DISTANCE = 0.080
"""m, z of the target's electrodes if the robot stands correctly (paper: (0, 0, 80) mm)."""
BAR_LENGTH, BAR_HEIGHT, BAR_GAP = 0.070, 0.010, 0.0074
"""m, a bar's size along x and y, and the gap between bars (assumed: they short at the paper's 12°)."""
MAGNET_FORCE, MAGNET_WIDTH, MAGNET_FLOOR = 60.0, 0.008, 0.2
"""All magnets: N in contact at zero offset, m of lateral offset that halves the force, minimum share (assumed)."""
PAD_DISTANCE = 0.048
"""m from the platform's centre to each pad, along x."""
PAD_YAW_STIFFNESS = 690.0
"""N·m/rad, moment of both pads about y per remaining yaw at 78 N: slope of the tactile contact model."""
DOCKING_JITTER = 1.0e-3
"""m, standard deviation of the docked position along x and y (fitted; see docs/tactile.md)."""


LIVE_VOLTAGE = 1.0
"""V that electrodes have without being driven if a battery is connected to them."""
SHORT_RESISTANCE = 1.0
"""Ω, below it the electrodes are shorted."""


class Port(IntEnum):
    """What lies at the electrodes; the numbers are those of the constants in Probe.srv."""

    UNKNOWN = 0
    OPEN = 1
    DEAD = 2
    LIVE = 3
    SHORT = 4
    REVERSED = 5


class ChargeLimits(NamedTuple):
    """Limits of one closing: A and V at most, a dead port or a live one, s until current flows, s without current."""

    current: float
    voltage: float
    dead: bool = False
    start_time: float = 3.0
    gap_time: float = 0.2


def port_of(resistance: float, voltage: float) -> Port:
    """Return what a probe found.

    Args:
        resistance: Ω at the end of the driven look; inf = no current flows, NaN = not driven, or not measured.
        voltage: V before driving if that is at least `LIVE_VOLTAGE` either way, else at the end.
    """
    if math.isnan(resistance):
        if not abs(voltage) >= LIVE_VOLTAGE:
            return Port.UNKNOWN
        return Port.LIVE if voltage > 0.0 else Port.REVERSED
    if math.isinf(resistance):
        return Port.OPEN
    if math.isnan(voltage):
        return Port.UNKNOWN
    return Port.SHORT if resistance < SHORT_RESISTANCE else Port.DEAD
