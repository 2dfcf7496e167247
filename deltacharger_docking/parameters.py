# SPDX-License-Identifier: Apache-2.0
"""Every parameter of docking, with its bounds. docking_node declares its ROS parameters from this table."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_core.machine import (
    BAR_GAP,
    BAR_LENGTH,
    BATTERY_MAX,
    BATTERY_MIN,
    DAMPING_PER_GAIN,
    DOCKING_JITTER,
    GAIN_MAX,
    GRAVITY,
    LONGEST_LEASE,
    MAGNET_FLOOR,
    MAGNET_FORCE,
    MAGNET_WIDTH,
    PAD_DISTANCE,
    PAD_YAW_STIFFNESS,
    SERVO_DAMPING,
    SERVO_STIFFNESS,
    STALL_CURRENT,
    TORQUE_CONSTANT,
    ZERO_CURRENT,
)
from deltacharger_core.parameters import Bounded, ParameterError, choice, flag, number, pose, tunable, words
from deltacharger_core.servos_file import STIFFNESS_MAX, STIFFNESS_MIN
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.line import PEAK_SPEED

POWERS = ("board", "none")
_ORDERED = (
    ("battery_voltage_min", "battery_voltage_start"),
    ("battery_voltage_start", "battery_voltage_max"),
    ("clearance_sigmas", "clearance_sigmas_sure"),
    ("free_current", "current_min"),
    ("contact_lost_current", "current_min"),
    ("current_max", "step_current_max"),
    ("current_max", "push_current"),
    ("current_max", "hard_current"),
)
"""Parameters of which the first must not lie above the second."""
_DEPTH = 0.11  # m, of the workspace: the longest way to the target and back
_REPORT = 0.2  # s until charger_power shows at the latest what the contactor has done


@dataclass(frozen=True)
class DockingParameters(Bounded):
    """Parameters of the docking state machine; explained in docs/docking.md.

    Parameters of moving, pressing, aligning and waiting can be set between goals. Those that describe the machine or
    protect live electrodes are fixed while docking_node runs.

    Raises:
        ParameterError: a value lies outside its bounds, or two values contradict each other.
    """

    power: str = choice(
        "board", POWERS, "board: contactor, limiter and probe; none: electrodes wired to the battery, always live"
    )
    servo_stiffness: float = number(
        SERVO_STIFFNESS, STIFFNESS_MIN, STIFFNESS_MAX, "N·m/rad", "servo stiffness until it is estimated"
    )
    servo_damping: float = number(SERVO_DAMPING, 0.0, GAIN_MAX * DAMPING_PER_GAIN, "N·m·s/rad", "servo damping")
    torque_constant: float = number(TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current, as in servo_node")
    gravity_x: float = number(GRAVITY[0], -20.0, 20.0, "m/s²", "gravity along x of charger_base")
    gravity_y: float = number(GRAVITY[1], -20.0, 20.0, "m/s²", "gravity along y of charger_base")
    gravity_z: float = number(GRAVITY[2], -20.0, 20.0, "m/s²", "gravity along z of charger_base")
    contact_window: float = number(0.12, 0.02, 0.5, "s", "window of the contact current's median")
    free_current: float = number(0.06, 0.005, 0.5, "A", "largest size of the contact current in free air")
    home_x: float = tunable(0.0, -0.06, 0.06, "m", "home position, x")
    home_y: float = tunable(0.0, -0.06, 0.06, "m", "home position, y")
    home_z: float = tunable(0.0, 0.0, 0.11, "m", "home position, z")
    travel_speed: float = tunable(0.12, 0.02, 0.5, "m/s", "peak speed in free air")
    approach_speed: float = tunable(
        0.18, 0.02, 0.5, "m/s", "peak speed toward the standoff, at which a target nearer than told is met"
    )
    run_up_speed: float = tunable(0.045, 0.01, 0.1, "m/s", "peak speed of the run-up before the tare")
    search_speed: float = tunable(0.02, 0.001, 0.1, "m/s", "peak speed where contact is possible")
    press_speed: float = tunable(0.025, 0.001, 0.1, "m/s", "peak speed of steps, and near a known contact")
    standoff: float = tunable(0.018, 0.005, 0.05, "m", "distance before the expected contact where the force is tared")
    run_up: float = tunable(
        0.004, 0.0, 0.02, "m", "travel along +z before the tare: gives friction the sign of pushing"
    )
    search_from: float = tunable(0.007, 0.0, 0.05, "m", "distance before the expected contact where the search begins")
    search_depth: float = tunable(0.025, 0.002, 0.05, "m", "distance beyond the expected contact where the search ends")
    near: float = tunable(0.004, 0.0, 0.02, "m", "distance before the known contact where press_speed begins")
    settle_touching: float = tunable(0.05, 0.0, 1.0, "s", "shortest settling time of electrodes in contact")
    drift_max: float = tunable(
        0.015, 0.001, 0.2, "A", "change of the contact current within its window that counts as rest"
    )
    coarse_step: float = tunable(0.0025, 0.0005, 0.01, "m", "largest step in free air")
    lift: float = tunable(0.008, 0.008, 0.04, "m", "distance that the platform lifts before it moves sideways")
    current_min: float = tunable(0.4, 0.05, 2.0, "A", "lower end of the contact current's band")
    current_max: float = tunable(0.5, 0.05, 2.0, "A", "upper end of the contact current's band")
    aim_below: float = tunable(0.02, 0.0, 0.1, "A", "how far below the band's middle a press on a known contact aims")
    band_margin: float = tunable(0.015, 0.0, 0.04, "A", "distance of an accepted reading from the band's lower end")
    step_share: float = tunable(0.7, 0.1, 1.0, "", "largest share of the way to the band in one step")
    step_near: float = tunable(0.75, 0.1, 1.0, "", "share of the band's lower end from which one step goes all the way")
    step_max: float = tunable(0.015, 0.001, 0.03, "m", "longest pressing step, however soft the contact seems")
    step_current_max: float = tunable(0.6, 0.1, 2.0, "A", "largest contact current of a step on a stiff contact")
    response_visible: float = tunable(0.02, 0.0, 0.2, "A", "least change between two readings that shows the response")
    response_min: float = tunable(0.4, 0.05, 1.0, "", "least multiple of the expected response that is accepted")
    response_max: float = tunable(2.5, 1.0, 20.0, "", "largest multiple of the expected response that is accepted")
    overshoots_max: int = tunable(3, 0, 20, "", "overshoots of the band after which contact fails")
    overshoot_back_off: float = tunable(0.35, 0.05, 1.0, "A", "contact current to release after an overshoot")
    push_current: float = tunable(0.7, 0.3, 2.0, "A", "current bound of each servo above its free-motion current")
    release_current: float = tunable(4.0, 0.5, STALL_CURRENT, "A", "current bound of each servo during release")
    release_time: float = tunable(1.0, 0.1, 2.0, "s", "longest pull against the magnets")
    ease_current_max: float = tunable(0.57, 0.05, 2.0, "A", "largest common current of the servos at ease")
    ease_spared_max: float = tunable(
        0.03, 0.0, 0.5, "A", "largest reduction of the current at ease by ease_current_max"
    )
    ease_tolerance: float = tunable(0.015, 0.001, 0.2, "A", "allowed error of a servo's current at ease")
    ease_time_min: float = tunable(0.25, 0.1, 10.0, "s", "shortest time of one easing round")
    ease_lags: float = tunable(4.0, 0.0, 50.0, "", "shortest time of a round in servo lags, damping / stiffness")
    ease_rounds: int = tunable(4, 1, 20, "", "most easing rounds; each corrects the stiffness")
    slip_max: float = tunable(0.0004, 0.00015, 0.01, "m", "sideways travel from which the platform slips")
    slip_undo_share: float = tunable(0.4, 0.0, 1.0, "", "share of the easing motion that is undone after a slip")
    slip_back_time: float = tunable(0.3, 0.05, 1.0, "", "duration of undoing as a share of the round's time")
    hard_current: float = number(1.0, 0.5, 4.0, "A", "contact current that ends docking, except in RETRACT")
    critical_angle: float = number(
        math.radians(12.0), 0.01, math.radians(12.05), "rad", "angle from which electrodes would short"
    )
    roll_sigmas: float = number(2.0, 0.0, 6.0, "", "standard deviations between a detected roll and critical_angle")
    yaw_max: float = number(
        math.radians(5.0), 0.0, math.radians(15.0), "rad", "yaw of the electrodes' faces above which docking refuses"
    )
    pitch_max: float = number(
        math.radians(5.0), 0.0, math.radians(15.0), "rad", "pitch of the electrodes' faces above which docking refuses"
    )
    lean_sigmas: float = number(2.0, 0.0, 6.0, "", "standard deviations by which a refused lean exceeds its limit")
    electrode_half_gap: float = number(0.5 * BAR_GAP, 0.0005, 0.02, "m", "half the gap between the two bars")
    electrode_half_length: float = number(0.5 * BAR_LENGTH, 0.005, 0.1, "m", "half the length of a bar")
    pitch_shift: float = number(0.0086, 0.0, 0.1, "m/rad", "error across the bars per pitch: 0.15 mm per degree")
    clearance_min: float = number(0.0003, 0.0, 0.005, "m", "clearance that must remain at clearance_sigmas")
    clearance_sigmas: float = number(3.0, 3.0, 12.0, "", "standard deviations required before current flows")
    clearance_sigmas_sure: float = number(6.0, 6.0, 24.0, "", "standard deviations at which one contact is enough")
    clearance_contacts: int = number(2, 2, 10, "", "successive contacts that must pass if one is not enough")
    alignment_tolerance: float = tunable(0.001, 0.0001, 0.01, "m", "offset from which a move counts as a correction")
    landing_limit: float = tunable(0.0025, 0.001, 0.02, "m", "largest offset of a contact across the bars")
    overlap_loss_max: float = tunable(0.004, 0.001, 0.03, "m", "largest offset along the bars: lost overlap")
    redocking_gain_min: float = tunable(
        0.004,
        0.0,
        1.0,
        "",
        "decrease of the risk of exceeding landing_limit or overlap_loss_max for which a contact is made; x1.5 a move",
    )
    contradiction_start: float = number(25.0, 1.0, 1000.0, "", "squared innovations that contradict the arm's moves")
    contradiction_each: float = number(4.0, 0.0, 100.0, "", "increase of contradiction_start per measured number")
    alignments_max: int = tunable(15, 1, 50, "", "most corrections and repeated contacts, as in the paper")
    docking_jitter: float = number(DOCKING_JITTER, 1e-4, 0.01, "m", "scatter of contacts about the commanded place")
    aligned_risk_max: float = tunable(
        0.02, 0.0, 1.0, "", "largest estimated risk of exceeding overlap_loss_max or landing_limit when aligned"
    )
    horizontal_scale: float = number(0.83, 0.1, 3.0, "", "true / reported standard deviation of horizontal estimates")
    horizontal_shared: float = number(0.00055, 0.0, 0.01, "m", "error of horizontal estimates that all contacts share")
    place_stddev: float = number(0.005, 1e-4, 0.05, "m", "standard deviation of the pose in a goal")
    yaw_stddev: float = number(
        math.radians(1.2), 0.0, 0.2, "rad", "standard deviation of an unknown yaw; 0 = parallel by construction"
    )
    platform_compliance: float = number(0.02, 0.0, 0.1, "rad/(N·m)", "tilt of the platform per moment; 0 = rigid")
    pad_yaw_stiffness: float = number(
        PAD_YAW_STIFFNESS, 1.0, 1e5, "N·m/rad", "moment of both pads about y per yaw that remains in contact"
    )
    load_per_yaw: float = number(5.73, 0.1, 100.0, "m/rad", "offset along the bars that loads the pads like a yaw")
    pad_force_min: float = number(3.0, 0.1, 50.0, "N", "force below which a pad does not hold its ridge")
    load_share_max: float = number(
        0.85, 0.1, 1.0, "", "largest share of the moment that empties a pad, for contacts made to probe"
    )
    pad_distance: float = number(PAD_DISTANCE, 0.02, 0.1, "m", "pad centre from the end effector's centre along x")
    probe_offset: float = tunable(0.006, 0.001, 0.02, "m", "offset from the target where the magnets' pull is probed")
    probe_gain_min: float = tunable(
        0.03, 0.0, 1.0, "", "decrease of that risk (redocking_gain_min) for which a contact only probes"
    )
    force_repeatability: float = number(0.045, 0.001, 0.4, "", "relative scatter of a pad's force between contacts")
    force_error: float = number(0.06, 0.0, 0.5, "", "relative error of the pads' force that all contacts share")
    magnet_force: float = number(MAGNET_FORCE, 0.0, 300.0, "N", "pull of the magnets in contact without offset")
    magnet_error: float = number(0.06, 0.0, 0.5, "", "relative error of magnet_force")
    magnet_width: float = number(MAGNET_WIDTH, 0.001, 0.1, "m", "offset at which the magnets' pull is halved")
    magnet_width_error: float = number(0.12, 0.0, 0.5, "", "relative error of magnet_width")
    magnet_floor: float = number(MAGNET_FLOOR, 0.0, 1.0, "", "share of the magnets' pull that remains at any offset")
    gain_error: float = number(0.15, 0.0, 1.0, "", "error of a misalignment estimate relative to its size")
    unsure_max: int = tunable(4, 1, 20, "", "unsure estimates after which alignment ends")
    unsure_here_max: int = tunable(2, 1, 20, "", "unsure estimates in one place after which alignment ends")
    unsure_move_min: float = tunable(0.002, 0.0, 0.02, "m", "offset from which an unsure estimate is followed")
    unsure_move_sigmas: float = tunable(3.0, 0.0, 10.0, "", "standard deviations at which an unsure offset is followed")
    charge_when_not_aligned: bool = flag(
        True, "start charging even if the last contact is not aligned, as published; other checks stay", tunable=True
    )
    restarts_max: int = tunable(0, 0, 10, "", "automatic restarts of a docking; 0 = none")
    estimate_frames: int = tunable(24, 1, 240, "", "tactile frames averaged in one estimate")
    charge_stable_time: float = tunable(
        1.0, 0.1, 10.0, "s", "how long charge current must flow before docking succeeds"
    )
    zero_current: float = number(
        ZERO_CURRENT, 0.05, 2.0, "A", "charge current below which the contactor counts as open"
    )
    open_timeout: float = number(1.0, _REPORT, 10.0, "s", "limit for current to stop after an order to open")
    opening_time: float = number(0.1, 0.0, 1.0, "s", "delay of an order to open")
    battery_voltage_min: float = number(
        BATTERY_MIN, 1.0, 60.0, "V", "voltage of the charger's own battery that ends charging after 5 s"
    )
    battery_voltage_start: float = number(
        23.7, 1.0, 60.0, "V", "lowest voltage of the charger's own battery for closing; load pulls it down"
    )
    battery_voltage_max: float = number(BATTERY_MAX, 1.0, 60.0, "V", "highest voltage of the charger's own battery")
    contact_lost_current: float = number(0.15, 0.0, 1.0, "A", "contact current below which contact is lost")
    contact_lost_retreat: float = number(0.0015, 0.0003, 0.01, "m", "retreat while live that means lost contact")
    clearance_period: float = number(2.0, 0.2, 60.0, "s", "period of clearance checks while charging")
    clearance_frames: int = number(12, 1, 240, "", "tactile frames averaged in one check while charging")
    unsafe_max: int = number(2, 1, 20, "", "successive checks without clearance that end charging")
    blind_max: int = number(3, 1, 20, "", "successive failed or unsure checks that end charging")
    hold_max: float = tunable(
        14400.0,
        1.0,
        604800.0,
        "s",
        "longest rest on a target since the last goal; then charging ends and the arm goes home",
    )
    fault_delay: float = number(0.15, 0.0, 1.0, "s", "longest delay of the fault report after a refused renewal")
    pause_max: float = number(1.0, 0.1, 5.0, "s", "longest pause of docking while the electrodes are live")
    thermal_reserve_min: float = number(5.0, 0.0, 600.0, "s", "thermal reserve of a servo at which charging ends")
    servo_age_max: float = number(0.5, 0.05, 2.0, "s", "age of servo_state that ends docking")
    live_servo_age_max: float = number(LONGEST_LEASE, 0.02, 0.5, "s", "age of servo_state that opens the contactor")
    press_age_max: float = number(0.1, 0.02, 1.0, "s", "age of servo_state and tactile frames that stops the arm")
    tactile_age_max: float = number(0.5, 0.05, 2.0, "s", "age of tactile frames that ends docking")
    power_age_max: float = number(0.5, 0.1, 2.0, "s", "age of charger_power that ends charging")
    detection_age_max: float = tunable(1.0, 0.1, 10.0, "s", "largest age of a camera detection")
    image_range_max: float = number(
        0.4, 0.0, 2.0, "m", "largest range of a camera detection without depth; 0 = depth is needed"
    )
    first_data_timeout: float = tunable(3.0, 0.0, 60.0, "s", "limit for the first data of nodes that have just started")
    service_timeout: float = tunable(3.0, 2.5, 60.0, "s", "limit for set_torque, tare and predict_misalignment")
    probe_timeout: float = tunable(2.0, 0.25, 60.0, "s", "limit for an answer of probe, longer than the board's own")
    locate_timeout: float = tunable(10.0, 1.0, 120.0, "s", "limit for LOCATE")
    approach_timeout: float = tunable(20.0, 5.0, 120.0, "s", "limit for APPROACH")
    contact_timeout: float = tunable(45.0, 5.0, 120.0, "s", "limit for CONTACT")
    measure_timeout: float = tunable(10.0, 2.5, 120.0, "s", "limit for MEASURE")
    align_timeout: float = tunable(45.0, 5.0, 120.0, "s", "limit for one ALIGN")
    duplicate_source_timeout: float = number(
        25.0, 0.0, 120.0, "s", "limit for second sources to disappear before the contactor closes"
    )
    retract_timeout: float = tunable(20.0, 3.0, 120.0, "s", "limit for RETRACT")
    goal_timeout: float = tunable(300.0, 12.0, 3600.0, "s", "limit for a docking until it succeeds")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.current_min + 2 * self.band_margin < self.current_max:
            problem = "current_min + 2 · band_margin must lie below current_max"
            raise ParameterError("current_min", self.current_min, problem)
        for lower, upper in _ORDERED:
            if (low := getattr(self, lower)) > (high := getattr(self, upper)):
                raise ParameterError(lower, low, f"{low:g} is above {upper}, {high:g}: lower it, or raise {upper}")
        if self.opening_time + _REPORT > self.open_timeout:
            problem = f"charger_power shows it up to {_REPORT:g} s later, which is after open_timeout: raise that"
            raise ParameterError("opening_time", self.opening_time, problem)
        for speed, way, limit in (
            ("approach_speed", _DEPTH, "approach_timeout"),
            ("run_up_speed", 2.0 * self.run_up, "approach_timeout"),
            ("search_speed", self.search_from + self.search_depth, "contact_timeout"),
            ("press_speed", self.near, "contact_timeout"),
            ("travel_speed", _DEPTH, "align_timeout"),
            ("travel_speed", _DEPTH, "retract_timeout"),
        ):
            peak, longest = getattr(self, speed), getattr(self, limit)
            if (takes := PEAK_SPEED * way / peak) > longest:
                problem = f"{1000 * way:g} mm at {peak:g} m/s take {takes:.1f} s, longer than {limit}, {longest:g} s"
                raise ParameterError(speed, peak, f"{problem}: raise one of them")

    @property
    def always_live(self) -> bool:
        """Whether electrodes are live whenever they touch, and charge current is not measured."""
        return self.power == "none"

    @property
    def gravity(self) -> Vector:
        """Gravity in charger_base, m/s²."""
        return self.gravity_x, self.gravity_y, self.gravity_z

    @property
    def home(self) -> Vector:
        """Resting position in charger_base, m."""
        return self.home_x, self.home_y, self.home_z

    @property
    def current_target(self) -> float:
        """Middle of the contact current's band, A."""
        return 0.5 * (self.current_min + self.current_max)

    @property
    def current_aim(self) -> float:
        """Contact current to aim at if the contact is known, A."""
        return self.current_target - self.aim_below


@dataclass(frozen=True)
class DockingNodeParameters(Bounded):
    """Where the charger is on its robot.

    Raises:
        ParameterError: a value lies outside its bounds, or base_pose has a quaternion of length zero.
    """

    base_frame: str = words("base_link", "the robot's frame for goals, in addition to charger_base")
    base_pose: tuple[float, ...] = pose((0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5), "charger_base in base_frame")
    lean_max: float = number(
        math.radians(30.0), 0.0, 0.5 * math.pi, "rad", "largest lean of a goal's electrodes from charger_base's z axis"
    )
    goal_lean_stddev: float = number(
        math.radians(1.0), 0.0, math.radians(10.0), "rad", "standard deviation of a goal's lean; goals do not give it"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not any(self.base_pose[3:]):
            problem = "its quaternion is zero: give x y z, then a quaternion x y z w of nonzero length"
            raise ParameterError("base_pose", self.base_pose, problem)
