# SPDX-License-Identifier: Apache-2.0
"""The machine in numbers: what every package may assume of it, each with its source. SI units.

Axes are those of `charger_base`: +z points at the target, +y is up. What somebody may want to change is a declared
parameter; where its default is the machine's, it refers to here.
"""

from __future__ import annotations

import math

JOINTS = ("limb_0_arm_joint", "limb_1_arm_joint", "limb_2_arm_joint")
"""Names of the driven joints in the order of the limbs; those of the URDF and of every message."""
SERVO_IDS = (1, 2, 3)
"""On the bus, of limbs 0, 1, 2; DYNAMIXEL's own default is 1 for every servo."""
BEHIND_BOARD = "board"
"""In place of the port of the servos: they hang on the board."""
TICKS_PER_TURN, EXTENDED_TICKS = 4096, 1_048_575
"""Counts of a servo's encoder in a turn, and the largest goal in modes 4 and 5, ±256 turns."""
BAUD_RATE = 1_000_000
"""bit/s of the servos' bus and of a board on a UART."""

STALL_TORQUE, STALL_CURRENT, NOMINAL_VOLTAGE = 6.0, 4.1, 12.0
"""N·m and A of an MX-64 at that voltage, V (vendor's e-manual)."""
TORQUE_CONSTANT = STALL_TORQUE / STALL_CURRENT
"""N·m/A; ±5 %, and friction is extra."""
SERVO_STIFFNESS, SERVO_DAMPING = 15.0, 0.91
"""N·m/rad of a servo whose position P gain is `POSITION_P_GAIN`, and N·m·s/rad: stall torque over no-load speed, 63 rpm
(both by the vendor's figures; `deltacharger calibrate servos` measures the first)."""
STIFFNESS_PER_GAIN = STALL_TORQUE / 885 / 128 * TICKS_PER_TURN / (2.0 * math.pi)
"""N·m/rad per count of the position P gain at 12 V: the vendor's e-manual divides the register by 128 and by that turns
ticks of error into PWM, of which 885 is all of the supply and gives the stall torque. For mode 5 it gives no unit."""
POSITION_P_GAIN = round(SERVO_STIFFNESS / STIFFNESS_PER_GAIN)
"""Value of the position P gain that makes a servo as stiff as `SERVO_STIFFNESS`; the vendor's default is 850."""
GAIN_MAX = 16383
"""Largest value of a servo's gain registers (vendor's e-manual)."""
CURRENT_BOUND = 0.83
"""A of a servo where a trajectory sets no bound."""
ZERO_CURRENT = 0.5
"""A between charger and target below which none is said to flow."""
BATTERY_MIN, BATTERY_MAX = 22.7, 29.8
"""V of the charger's own battery, empty and full (paper)."""
GRAVITY_STRENGTH = 9.81
"""m/s²."""
GRAVITY = (0.0, -GRAVITY_STRENGTH, 0.0)
"""m/s² in `charger_base` where the robot stands level."""

PADS, ROWS, COLUMNS = 2, 10, 10
"""Tactile pads, and the taxels of each (paper)."""
FRAME_RATE = 120.0
"""Hz at which both pads are sampled (paper)."""
CONTACT_FORCE = 1.0
"""N; a taxel at or above it is in contact: the smallest force that the published sensor tells (1–9 N)."""

LONGEST_LEASE = 0.25
"""s for which the contactor is held closed unless its holder asks again."""
DOCK_DISTANCE = 0.080
"""m; z of the electrodes where the robot stands right (paper: (0, 0, 80) mm)."""
BAR_LENGTH, BAR_HEIGHT, BAR_GAP = 0.070, 0.010, 0.0074
"""m; an electrode's bar along x and y, and the gap to the other bar (assumed: they short at the paper's 12°)."""
MAGNET_FORCE, MAGNET_WIDTH, MAGNET_FLOOR = 60.0, 0.008, 0.2
"""All magnets together: N in contact at zero offset, m of lateral offset that halves it, least share (assumed)."""
PAD_DISTANCE = 0.048
"""m from the middle of the platform to each pad, along x."""
PAD_YAW_STIFFNESS = 690.0
"""N·m/rad, moment of both pads about y by the yaw that remains, at 78 N: slope of the tactile contact model."""
DOCKING_JITTER = 1.0e-3
"""m; standard deviation of where a docking lands, along x and along y (fitted; see docs/tactile.md)."""
