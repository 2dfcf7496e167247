# SPDX-License-Identifier: Apache-2.0
"""Every number that docking decides by, with its bounds. docking_node declares its ROS parameters from this table."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from deltacharger_core.machine import BAR_GAP, BAR_LENGTH, GRAVITY, SERVO_DAMPING, SERVO_STIFFNESS, STALL_CURRENT
from deltacharger_kinematics.geometry import Vector

APPROACHES = ("guarded", "paper")
SIGNALS = ("contact", "max", "sum")


def _number(default: float, low: float, high: float, description: str) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "description": description})


def _choice(default: str, choices: tuple[str, ...], description: str) -> Any:
    return field(default=default, metadata={"choices": choices, "description": description})


@dataclass(frozen=True)
class DockingParameters:
    """Parameters of the docking state machine; units in the descriptions, sources in docs/docking.md.

    Raises:
        ValueError: a value lies outside its bounds; the message names it.
    """

    approach: str = _choice("guarded", APPROACHES, "step rule: guarded, or the paper's constant steps")
    current_signal: str = _choice("contact", SIGNALS, "what counts as current: contact, or the raw maximum or sum")
    servo_stiffness: float = _number(SERVO_STIFFNESS, 1.0, 50.0, "servo stiffness in position mode, N·m/rad")
    servo_damping: float = _number(SERVO_DAMPING, 0.0, 10.0, "servo damping, N·m·s/rad")
    gravity_x: float = _number(GRAVITY[0], -20.0, 20.0, "gravity along x of charger_base, m/s²")
    gravity_y: float = _number(GRAVITY[1], -20.0, 20.0, "gravity along y of charger_base, m/s²")
    gravity_z: float = _number(GRAVITY[2], -20.0, 20.0, "gravity along z of charger_base, m/s²")
    home_x: float = _number(0.0, -0.06, 0.06, "where the arm rests, x, m")
    home_y: float = _number(0.0, -0.06, 0.06, "where the arm rests, y, m")
    home_z: float = _number(0.0, 0.0, 0.11, "where the arm rests, z, m")
    travel_speed: float = _number(0.12, 0.005, 0.5, "peak speed in free air, m/s")
    contact_speed: float = _number(0.02, 0.001, 0.1, "peak speed of a step toward contact, m/s")
    standoff: float = _number(0.018, 0.005, 0.05, "distance before the expected contact at which the force is tared, m")
    search_depth: float = _number(0.025, 0.0, 0.05, "how far beyond the expected contact to search, m")
    paper_step: float = _number(0.005, 0.0005, 0.01, "step of the paper's approach, m")
    coarse_step: float = _number(0.0025, 0.0005, 0.01, "largest step of the guarded approach in free air, m")
    back_off: float = _number(0.030, 0.005, 0.06, "how far to go back when the first push is too hard, m")
    lift: float = _number(0.012, 0.008, 0.04, "how far the platform lifts before it moves sideways, m")
    current_min: float = _number(0.4, 0.05, 2.0, "contact current from which the electrodes rest on the target, A")
    current_max: float = _number(0.5, 0.05, 2.0, "contact current that the servos hold for four hours, A")
    band_margin: float = _number(0.015, 0.0, 0.04, "how far inside the band a reading must lie to be accepted, A")
    overshoot_back_off: float = _number(0.35, 0.05, 1.0, "contact current to give back after an overshoot, A")
    push_current: float = _number(0.6, 0.1, 2.0, "current bound of each servo above its free-motion current, A")
    release_current: float = _number(
        2.8, 0.5, STALL_CURRENT, "current bound of each servo while it pulls off the magnets, A"
    )
    release_time: float = _number(1.0, 0.1, 2.0, "longest pull on the magnets, s")
    hard_current: float = _number(1.0, 0.5, 4.0, "contact current that ends any phase, A")
    critical_angle: float = _number(
        math.radians(12.0), 0.01, math.radians(12.05), "angle from which the electrodes would short, rad"
    )
    electrode_half_gap: float = _number(0.5 * BAR_GAP, 0.0005, 0.02, "half the gap between the two bars, m")
    electrode_half_length: float = _number(0.5 * BAR_LENGTH, 0.005, 0.1, "half the length of a bar, m")
    clearance_min: float = _number(0.0003, 0.0, 0.005, "clearance that must remain at three standard deviations, m")
    alignment_tolerance: float = _number(0.001, 0.0001, 0.01, "filtered misalignment that counts as aligned, m")
    landing_limit: float = _number(
        0.0025, 0.001, 0.02, "misalignment within which this very contact must lie, at 2.15 standard deviations, m"
    )
    alignments_max: int = _number(15, 1, 50, "lateral corrections before alignment ends, as in the paper")
    docking_jitter: float = _number(0.00095, 0.0, 0.01, "scatter of one docking beside its commanded place, m")
    gain_error: float = _number(0.15, 0.0, 1.0, "relative error of a misalignment estimate that grows with its size")
    charge_when_not_aligned: bool = field(
        default=True,
        metadata={"description": "start charging after the last alignment as published; clearance is always required"},
    )
    redockings_max: int = _number(
        0, 0, 10, "how often docking begins again by itself after what a new docking may mend; 0 = never"
    )
    estimate_frames: int = _number(24, 1, 240, "tactile frames averaged in one estimate")
    charge_current_min: float = _number(0.5, 0.05, 18.0, "charge current that counts as charging, A")
    charge_stable_time: float = _number(1.0, 0.1, 10.0, "how long charge current must stay before docking succeeds, s")
    charge_current_max: float = _number(18.5, 1.0, 30.0, "charge current that opens the contactor, A")
    target_voltage_min: float = _number(10.0, 0.0, 60.0, "lowest voltage of a target that may be charged, V")
    target_voltage_max: float = _number(30.0, 1.0, 60.0, "highest voltage of a target that may be charged, V")
    probe_resistance_min: float = _number(1.0, 0.1, 100.0, "probed resistance below which it is a short, Ω")
    clearance_period: float = _number(2.0, 0.2, 60.0, "how often clearance is measured again while charging, s")
    thermal_reserve_min: float = _number(5.0, 0.0, 600.0, "thermal reserve of a servo at which charging ends, s")
    servo_age_max: float = _number(0.5, 0.05, 2.0, "age of servo_state that ends docking, s")
    press_age_max: float = _number(
        0.1,
        0.02,
        1.0,
        "age of servo_state, and of tactile frames on the way to the target, above which the arm is held, s",
    )
    tactile_age_max: float = _number(0.5, 0.05, 2.0, "age of tactile frames that ends docking, s")
    power_age_max: float = _number(0.5, 0.1, 2.0, "age of charger_power that ends charging, s")
    detection_age_max: float = _number(1.0, 0.1, 10.0, "age of a camera detection that may be used, s")
    locate_timeout: float = _number(10.0, 1.0, 120.0, "limit for LOCATE, s")
    approach_timeout: float = _number(20.0, 1.0, 120.0, "limit for APPROACH, s")
    contact_timeout: float = _number(45.0, 1.0, 120.0, "limit for CONTACT and BACK_OFF, s")
    measure_timeout: float = _number(10.0, 1.0, 120.0, "limit for MEASURE, s")
    align_timeout: float = _number(45.0, 1.0, 120.0, "limit for one ALIGN, s")
    energise_timeout: float = _number(10.0, 1.0, 120.0, "limit for ENERGISE until current flows stably, s")
    retract_timeout: float = _number(20.0, 1.0, 120.0, "limit for RETRACT, s")
    goal_timeout: float = _number(300.0, 5.0, 3600.0, "limit for a whole docking until it succeeds, s")

    def __post_init__(self) -> None:
        for item in fields(self):
            value, bounds = getattr(self, item.name), item.metadata
            if "choices" in bounds and value not in bounds["choices"]:
                raise ValueError(f"{item.name} is {value!r}: choose one of {', '.join(bounds['choices'])}")
            if "low" in bounds and not bounds["low"] <= value <= bounds["high"]:
                raise ValueError(f"{item.name} is {value!r}: allowed are {bounds['low']} to {bounds['high']}")
        if not self.current_min + 2 * self.band_margin < self.current_max:
            raise ValueError("current_min + 2 · band_margin must lie below current_max")
        if not self.target_voltage_min < self.target_voltage_max:
            raise ValueError("target_voltage_min must lie below target_voltage_max")

    @property
    def gravity(self) -> Vector:
        """Gravity in charger_base, m/s²."""
        return self.gravity_x, self.gravity_y, self.gravity_z

    @property
    def home(self) -> Vector:
        """Resting position in charger_base, m."""
        return self.home_x, self.home_y, self.home_z

    @property
    def settle_time(self) -> float:
        """How long the arm needs to come to rest after a step: four time constants of the servo, s."""
        return max(4.0 * self.servo_damping / self.servo_stiffness, 0.1)

    @property
    def current_target(self) -> float:
        """Middle of the contact current's band, A."""
        return 0.5 * (self.current_min + self.current_max)
