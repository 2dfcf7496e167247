# SPDX-License-Identifier: Apache-2.0
"""The parameters of the mock nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_core.machine import CURRENT_BOUND, DOCK_DISTANCE, FRAME_RATE, STALL_CURRENT
from deltacharger_core.parameters import Bounded, choice, number, words
from deltacharger_core.texts import ON_MAP

SERVO_FAULTS = ("none", "silence", "nan_current", "missing", "hardware_error", "jam")
POWER_FAULTS = (
    "short",
    "open_circuit",
    "reverse_polarity",
    "contactor_refusal",
    "no_charge_current",
    "contactor_welded",
)
TACTILE_FAULTS = ("none", "silence", "zero_frames", "unsure", "power_silence", "tare_refusal", *POWER_FAULTS)
DETECTOR_FAULTS = ("none", "nothing", "stale", "beyond_reach", "unsure_roll", "leaning", "no_normal")
NAVIGATOR_FAULTS = ("none", "refuse", "abort", "lost", "never_answers", "slow", "mute")
_FAULT = "fault to produce"


@dataclass(frozen=True)
class MockFaultParameters(Bounded):
    """Delay of a mock's faults."""

    fault_delay: float = number(0.0, 0.0, 1e6, "s", "delay from setting the fault (or the start) until it acts")


@dataclass(frozen=True)
class MockPlaneParameters(Bounded):
    """Plane of a mock's target; mock_servo_node and mock_tactile_node need equal values."""

    target_z: float = number(DOCK_DISTANCE, 0.0, 0.2, "m", "plane in which contact begins")


@dataclass(frozen=True)
class MockServoNodeParameters(MockPlaneParameters, MockFaultParameters):
    """How the mock servos move."""

    rate: float = number(100.0, 1.0, 500.0, "Hz", "cycles per second")
    current_bound: float = number(CURRENT_BOUND, 0.0, STALL_CURRENT, "A", "bound without effort")
    fault: str = choice("none", SERVO_FAULTS, _FAULT, tunable=True)


@dataclass(frozen=True)
class MockTactileNodeParameters(MockPlaneParameters, MockFaultParameters):
    """Readings of the mock pads."""

    target_x: float = number(0.0, -0.1, 0.1, "m", "midpoint of the target's electrodes along x")
    target_y: float = number(0.0, -0.1, 0.1, "m", "midpoint of the target's electrodes along y")
    target_angle: float = number(0.0, -math.pi / 2, math.pi / 2, "rad", "of the target about +z")
    rate: float = number(FRAME_RATE, 1.0, 200.0, "Hz", "tactile frames per second")
    fault: str = choice("none", TACTILE_FAULTS, _FAULT, tunable=True)


@dataclass(frozen=True)
class MockDetectorNodeParameters(MockFaultParameters):
    """Reported pose of the electrodes."""

    x: float = number(0.0, -1.0, 1.0, "m", "electrodes along x of charger_base")
    y: float = number(0.0, -1.0, 1.0, "m", "electrodes along y of charger_base")
    z: float = number(DOCK_DISTANCE, -1.0, 1.0, "m", "electrodes along z of charger_base")
    roll: float = number(0.0, -math.pi / 2, math.pi / 2, "rad", "of the electrodes about z")
    position_stddev: float = number(0.001, 0.0, 0.1, "m", "standard deviation of each coordinate")
    roll_stddev: float = number(0.004, 0.0, 1.0, "rad", "standard deviation of the roll")
    yaw: float = number(0.0, -0.7, 0.7, "rad", "lean of the electrodes about y")
    pitch: float = number(0.0, -0.7, 0.7, "rad", "lean of the electrodes about x")
    lean_stddev: float = number(0.009, 0.0, 1.0, "rad", "standard deviation of the rotations about x and y")
    fault: str = choice("none", DETECTOR_FAULTS, _FAULT, tunable=True)


@dataclass(frozen=True)
class MockNavigatorNodeParameters(MockFaultParameters):
    """Initial pose and driving of the mock base."""

    x: float = number(0.0, -ON_MAP, ON_MAP, "m", "initial x of the base")
    y: float = number(0.0, -ON_MAP, ON_MAP, "m", "initial y of the base")
    yaw: float = number(0.0, -math.pi, math.pi, "rad", "initial yaw of the base")
    frame: str = words("map", "of its poses; goals in another one are aborted")
    speed: float = number(0.5, 0.01, 1000.0, "m/s", "of the base")
    turn_speed: float = number(1.0, 0.01, 1000.0, "rad/s", "of the base")
    fault: str = choice("none", NAVIGATOR_FAULTS, _FAULT, tunable=True)
