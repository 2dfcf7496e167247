# SPDX-License-Identifier: Apache-2.0
"""Every number that docking decides by, with its bounds. docking_node declares its ROS parameters from this table."""

from __future__ import annotations

import math
from dataclasses import dataclass

from deltacharger_core.machine import (
    BAR_GAP,
    BAR_LENGTH,
    BATTERY_MAX,
    BATTERY_MIN,
    DOCKING_JITTER,
    GRAVITY,
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
from deltacharger_core.parameters import Bounded, ParameterError, choice, flag, number, numbers, tunable, words
from deltacharger_core.servos_file import STIFFNESS_MAX, STIFFNESS_MIN
from deltacharger_kinematics.geometry import Vector

APPROACHES = ("guarded", "paper", "published")
SIGNALS = ("contact", "max", "sum")
POWERS = ("board", "none")
_ORDERED = (
    ("battery_voltage_min", "battery_voltage_max"),
    ("target_voltage_min", "target_voltage_max"),
    ("clearance_sigmas", "clearance_sigmas_sure"),
    ("release_travel", "spring_travel"),
)


@dataclass(frozen=True)
class DockingParameters(Bounded):
    """Parameters of the docking state machine; sources in docs/docking.md.

    How it moves, presses, aligns and waits may be set between goals. What describes the machine, and what live
    electrodes depend on, is fixed while docking_node runs.

    Raises:
        ParameterError: a value lies outside its bounds, or two contradict each other.
    """

    approach: str = choice(
        "guarded", APPROACHES, "guarded; paper: the paper's constant steps; published: its whole algorithm as printed"
    )
    power: str = choice(
        "board", POWERS, "board: contactor, limiter and probe; none: the electrodes hang on the battery, always live"
    )
    published_clearance_rule: bool = flag(False, "whether published, too, needs clearance before current may flow")
    current_signal: str = choice("contact", SIGNALS, "what counts as current: contact, or the raw maximum or sum")
    servo_stiffness: float = number(
        SERVO_STIFFNESS, STIFFNESS_MIN, STIFFNESS_MAX, "N·m/rad", "servo stiffness, until it is felt"
    )
    servo_damping: float = number(SERVO_DAMPING, 0.0, 10.0, "N·m·s/rad", "servo damping")
    torque_constant: float = number(TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current, as servo_node's")
    gravity_x: float = number(GRAVITY[0], -20.0, 20.0, "m/s²", "gravity along x of charger_base")
    gravity_y: float = number(GRAVITY[1], -20.0, 20.0, "m/s²", "gravity along y of charger_base")
    gravity_z: float = number(GRAVITY[2], -20.0, 20.0, "m/s²", "gravity along z of charger_base")
    contact_window: float = number(0.12, 0.02, 0.5, "s", "time over which the contact current is the median")
    free_current: float = number(0.06, 0.005, 0.5, "A", "contact current, either way, that is not free air")
    weighing_timeout: float = tunable(0.5, 0.0, 10.0, "s", "limit for the arm to yield to its weight after torque on")
    home_x: float = tunable(0.0, -0.06, 0.06, "m", "where the arm rests, x")
    home_y: float = tunable(0.0, -0.06, 0.06, "m", "where the arm rests, y")
    home_z: float = tunable(0.0, 0.0, 0.11, "m", "where the arm rests, z")
    travel_speed: float = tunable(0.12, 0.005, 0.5, "m/s", "peak speed in free air")
    approach_speed: float = tunable(0.25, 0.005, 0.5, "m/s", "peak speed toward the standoff")
    run_up_speed: float = tunable(0.04, 0.001, 0.1, "m/s", "peak speed of the run-up before the tare")
    search_speed: float = tunable(0.02, 0.001, 0.1, "m/s", "peak speed where the target may be met")
    press_speed: float = tunable(0.025, 0.001, 0.1, "m/s", "peak speed where the target is known to be, and of steps")
    standoff: float = tunable(0.018, 0.005, 0.05, "m", "where the force is tared before the expected contact")
    run_up: float = tunable(
        0.004, 0.0, 0.02, "m", "way along +z before the tare: friction then has the sign of pushing"
    )
    search_from: float = tunable(0.007, 0.0, 0.05, "m", "how far before the expected contact to begin searching")
    search_depth: float = tunable(0.025, 0.0, 0.05, "m", "how far beyond the expected contact to search")
    near: float = tunable(0.004, 0.0, 0.02, "m", "how far before the known contact press_speed begins")
    felt_current: float = tunable(0.1, 0.005, 0.5, "A", "contact current that ends the search")
    settle_touching: float = tunable(0.05, 0.0, 1.0, "s", "least time in which electrodes that touch come to rest")
    drift_max: float = tunable(
        0.015, 0.001, 0.2, "A", "change of the contact current within its window that is at rest"
    )
    paper_step: float = tunable(0.005, 0.0005, 0.01, "m", "step of the paper's approach")
    coarse_step: float = tunable(0.0025, 0.0005, 0.01, "m", "largest step of the guarded approach in free air")
    back_off: float = tunable(0.030, 0.005, 0.06, "m", "how far to go back when the first push is too hard")
    lift: float = tunable(0.008, 0.008, 0.04, "m", "how far the platform lifts before it moves sideways")
    current_min: float = tunable(0.4, 0.05, 2.0, "A", "contact current from which the electrodes rest on the target")
    current_max: float = tunable(0.5, 0.05, 2.0, "A", "contact current that the servos hold for four hours")
    aim_below: float = tunable(0.02, 0.0, 0.1, "A", "how far below the band's middle a known contact is aimed at")
    band_margin: float = tunable(0.015, 0.0, 0.04, "A", "how far inside the band a reading must lie to be accepted")
    step_share: float = tunable(0.7, 0.1, 1.0, "", "share of the way to the band that one step may take")
    step_near: float = tunable(0.75, 0.1, 1.0, "", "share of the band's lower end from which a step goes all the way")
    step_max: float = tunable(0.015, 0.001, 0.03, "m", "longest step that presses, however soft the contact seems")
    step_current_max: float = tunable(0.6, 0.1, 2.0, "A", "contact current that a step on a stiff contact may reach")
    response_told: float = tunable(0.02, 0.0, 0.2, "A", "change between two readings that tells the contact's response")
    response_min: float = tunable(0.4, 0.05, 1.0, "", "least multiple of the expected response that is believed")
    response_max: float = tunable(2.5, 1.0, 20.0, "", "largest multiple of the expected response that is believed")
    overshoots_max: int = tunable(3, 0, 20, "", "overshoots of the band after which contact is given up")
    overshoot_back_off: float = tunable(0.35, 0.05, 1.0, "A", "contact current to give back after an overshoot")
    push_current: float = tunable(0.6, 0.1, 2.0, "A", "current bound of each servo above its free-motion current")
    release_current: float = tunable(2.8, 0.5, STALL_CURRENT, "A", "bound of each servo that pulls off the magnets")
    release_time: float = tunable(1.0, 0.1, 2.0, "s", "longest pull on the magnets")
    release_behind: float = tunable(0.001, 0.0, 0.005, "m", "how far behind it the goal is put; soft servos: farther")
    release_travel: float = tunable(
        0.001, 0.0002, 0.01, "m", "retreat that shows release, pads free; soft servos: more"
    )
    spring_travel: float = tunable(0.004, 0.0002, 0.02, "m", "retreat that electrodes on springs cannot follow")
    setting_back_time: float = tunable(0.05, 0.01, 0.5, "s", "time for the goal to get behind the platform")
    came_share: float = tunable(0.5, 0.1, 0.9, "", "share of the way back that shows that the platform came along")
    came_lack: float = tunable(0.001, 0.0002, 0.01, "m", "what the way back may lack in any case: some encoder counts")
    release_pulls_max: int = tunable(3, 1, 10, "", "pulls after which a platform that does not come is stuck")
    ease_current_max: float = tunable(0.57, 0.05, 2.0, "A", "common current to which the servos are led at most")
    ease_spared_max: float = tunable(0.03, 0.0, 0.5, "A", "how far below the band's middle ease_current_max may lead")
    ease_tolerance: float = tunable(0.015, 0.001, 0.2, "A", "how far off its share a servo's current may be at ease")
    ease_time_min: float = tunable(0.4, 0.1, 10.0, "s", "shortest time of one easing of the servos' currents")
    ease_lags: float = tunable(4.0, 0.0, 50.0, "", "shortest time of easing in lags of the servos, damping / stiffness")
    ease_rounds: int = tunable(4, 1, 20, "", "rounds of easing at most: each corrects the stiffness")
    slip_max: float = tunable(0.0004, 0.00015, 0.01, "m", "travel sideways from which the platform slips")
    slip_taken_back: float = tunable(0.4, 0.0, 1.0, "", "share of what was led that is taken back after a slip")
    slip_back_time: float = tunable(0.3, 0.05, 1.0, "", "share of the time of easing that taking back lasts")
    hard_current: float = number(1.0, 0.5, 4.0, "A", "contact current that ends any phase")
    critical_angle: float = number(
        math.radians(12.0), 0.01, math.radians(12.05), "rad", "angle from which electrodes would short"
    )
    roll_sigmas: float = number(2.0, 0.0, 6.0, "", "standard deviations that a given roll keeps from critical_angle")
    yaw_max: float = number(
        math.radians(5.0), 0.0, math.radians(15.0), "rad", "yaw of the electrodes' faces that is not docked to"
    )
    pitch_max: float = number(
        math.radians(5.0), 0.0, math.radians(15.0), "rad", "pitch of the electrodes' faces that is not docked to"
    )
    lean_sigmas: float = number(2.0, 0.0, 6.0, "", "standard deviations by which a given lean lies beyond its limit")
    electrode_half_gap: float = number(0.5 * BAR_GAP, 0.0005, 0.02, "m", "half the gap between the two bars")
    electrode_half_length: float = number(0.5 * BAR_LENGTH, 0.005, 0.1, "m", "half the length of a bar")
    pitch_shift: float = number(0.0086, 0.0, 0.1, "m/rad", "error across the bars by a pitch: 0.15 mm a degree")
    clearance_min: float = number(0.0003, 0.0, 0.005, "m", "clearance that must remain at clearance_sigmas")
    clearance_sigmas: float = number(3.0, 3.0, 12.0, "", "standard deviations without which no current flows")
    clearance_sigmas_sure: float = number(6.0, 6.0, 24.0, "", "standard deviations at which one contact is enough")
    clearance_contacts: int = number(2, 2, 10, "", "contacts in a row that must pass where one is not enough")
    alignment_tolerance: float = tunable(0.001, 0.0001, 0.01, "m", "offset from which a move counts as a correction")
    landing_limit: float = tunable(0.0025, 0.001, 0.02, "m", "offset across the bars within which a contact shall lie")
    overlap_loss_max: float = tunable(0.004, 0.001, 0.03, "m", "the same along the bars: overlap that may be lost")
    redocking_gain_min: float = tunable(
        0.004, 0.0, 1.0, "", "fall of the risk to lie beyond these limits that is worth a second contact; x1.5 a move"
    )
    contradiction_start: float = number(25.0, 1.0, 1000.0, "", "squared innovations that contradict the arm's moves")
    contradiction_each: float = number(4.0, 0.0, 100.0, "", "what each number felt adds to contradiction_start")
    alignments_max: int = tunable(15, 1, 50, "", "corrections and contacts made anew at most, as in the paper")
    docking_jitter: float = number(DOCKING_JITTER, 0.0, 0.01, "m", "scatter of one docking beside its commanded place")
    aligned_risk_max: float = tunable(
        0.02, 0.0, 1.0, "", "told risk to lie beyond overlap_loss_max or landing_limit at which it is called aligned"
    )
    horizontal_scale: float = number(0.83, 0.1, 3.0, "", "true standard deviation of a horizontal estimate in its told")
    horizontal_shared: float = number(0.00055, 0.0, 0.01, "m", "its part that all contacts of a docking share")
    place_stddev: float = number(0.005, 1e-4, 0.05, "m", "how far a target lies beside the pose that a goal gives")
    yaw_stddev: float = number(
        math.radians(1.2), 0.0, 0.2, "rad", "yaw of targets' faces where nobody tells it; 0 = parallel by construction"
    )
    platform_compliance: float = number(0.02, 0.0, 0.1, "rad/(N·m)", "tilt of the platform per moment; 0 = rigid")
    pad_yaw_stiffness: float = number(
        PAD_YAW_STIFFNESS, 1.0, 1e5, "N·m/rad", "moment about y of both pads by the yaw that remains in contact"
    )
    load_per_yaw: float = number(5.73, 0.1, 100.0, "m/rad", "offset along the bars that loads the pads as a yaw does")
    pad_force_min: float = number(3.0, 0.1, 50.0, "N", "force of a pad below which it does not hold its ridge")
    load_share_max: float = number(
        0.85, 0.1, 1.0, "", "share of the moment that empties a pad, beyond which a contact is not made for probing"
    )
    pad_distance: float = number(PAD_DISTANCE, 0.02, 0.1, "m", "pad centre from the end effector's centre along x")
    probe_offset: float = tunable(0.006, 0.001, 0.02, "m", "how far beside the target the magnets' force is probed")
    probe_gain_min: float = tunable(0.03, 0.0, 1.0, "", "fall of that risk that is worth a contact for probing alone")
    force_repeatability: float = number(0.045, 0.001, 0.5, "", "scatter of a pad's force from one contact to the next")
    force_error: float = number(0.06, 0.0, 0.5, "", "relative error of the pads' force that all contacts share")
    magnet_force: float = number(MAGNET_FORCE, 0.0, 300.0, "N", "pull of the magnets in contact without offset")
    magnet_error: float = number(0.06, 0.0, 0.5, "", "relative error of magnet_force")
    magnet_width: float = number(MAGNET_WIDTH, 0.001, 0.1, "m", "offset at which the magnets' pull is halved")
    magnet_width_error: float = number(0.12, 0.0, 0.5, "", "relative error of magnet_width")
    magnet_floor: float = number(MAGNET_FLOOR, 0.0, 1.0, "", "share of the magnets' pull that remains far off")
    gain_error: float = number(0.15, 0.0, 1.0, "", "relative error of a misalignment estimate that grows with its size")
    unsure_max: int = tunable(4, 1, 20, "", "unsure estimates after which alignment ends")
    unsure_here_max: int = tunable(2, 1, 20, "", "unsure estimates in one place after which alignment ends")
    unsure_move_min: float = tunable(0.002, 0.0, 0.02, "m", "offset from which an unsure estimate is followed")
    unsure_move_sigmas: float = tunable(3.0, 0.0, 10.0, "", "standard deviations at which an unsure offset is followed")
    charge_when_not_aligned: bool = flag(
        True, "start charging after the last alignment as published; what else current needs stays", live=True
    )
    restarts_max: int = tunable(0, 0, 10, "", "how often docking begins again by itself; 0 = never")
    estimate_frames: int = tunable(24, 1, 240, "", "tactile frames averaged in one estimate")
    charge_current_min: float = tunable(ZERO_CURRENT, 0.05, 18.0, "A", "charge current that counts as charging")
    charge_stable_time: float = tunable(
        1.0, 0.1, 10.0, "s", "how long charge current must stay before docking succeeds"
    )
    charge_current_max: float = number(18.5, 1.0, 30.0, "A", "charge current that opens the contactor")
    zero_current: float = number(
        ZERO_CURRENT, 0.05, 2.0, "A", "charge current below which the contactor counts as open"
    )
    open_timeout: float = number(1.0, 0.1, 10.0, "s", "limit for current to be gone after an opening")
    opening_time: float = number(0.1, 0.0, 1.0, "s", "time that an order to open is under way")
    battery_voltage_min: float = number(
        BATTERY_MIN, 1.0, 60.0, "V", "lowest voltage of the charger's own battery that is let onto the electrodes"
    )
    battery_voltage_max: float = number(BATTERY_MAX, 1.0, 60.0, "V", "highest voltage of the charger's own battery")
    target_voltage_min: float = number(10.0, 0.0, 60.0, "V", "lowest voltage of a target that may be charged")
    target_voltage_max: float = number(30.0, 1.0, 60.0, "V", "highest voltage of a target that may be charged")
    probe_resistance_min: float = number(1.0, 0.1, 100.0, "Ω", "probed resistance below which it is a short")
    contact_lost_current: float = number(0.15, 0.0, 1.0, "A", "contact current below which contact is lost")
    contact_lost_retreat: float = number(0.0015, 0.0003, 0.01, "m", "retreat that means lost contact while live")
    clearance_period: float = number(2.0, 0.2, 60.0, "s", "how often clearance is measured again while charging")
    clearance_frames: int = number(12, 1, 240, "", "tactile frames averaged in one look while charging")
    unsafe_max: int = number(2, 1, 20, "", "successive looks that find no clearance, after which charging ends")
    blind_max: int = number(3, 1, 20, "", "successive looks that fail or stay unsure, after which charging ends")
    taper_time: float = tunable(2.0, 0.1, 600.0, "s", "time constant of the charge current's own mean")
    taper_share: float = tunable(0.5, 0.0, 1.0, "", "share of its mean below which charge current was cut off")
    full_time: float = tunable(1.0, 0.0, 600.0, "s", "how long tapered current must stay below charge_current_min")
    fault_delay: float = number(0.15, 0.0, 1.0, "s", "how much later than a refused renewal its fault is told")
    slept_max: float = number(1.0, 0.1, 5.0, "s", "how long docking may stand still beside live electrodes")
    energy_gap_max: float = number(0.2, 0.02, 2.0, "s", "pause between ticks beyond which energy is not counted")
    thermal_reserve_min: float = number(5.0, 0.0, 600.0, "s", "thermal reserve of a servo at which charging ends")
    servo_age_max: float = number(0.5, 0.05, 2.0, "s", "age of servo_state that ends docking")
    live_servo_age_max: float = number(0.2, 0.02, 0.5, "s", "age of servo_state that opens a closed contactor")
    press_age_max: float = number(0.1, 0.02, 1.0, "s", "age of servo_state and tactile frames that holds the arm")
    tactile_age_max: float = number(0.5, 0.05, 2.0, "s", "age of tactile frames that ends docking")
    power_age_max: float = number(0.5, 0.1, 2.0, "s", "age of charger_power that ends charging")
    detection_age_max: float = tunable(1.0, 0.1, 10.0, "s", "age of a camera detection that may be used")
    first_data_timeout: float = tunable(3.0, 0.0, 60.0, "s", "limit for nodes that have just started to be heard")
    service_timeout: float = tunable(3.0, 0.1, 60.0, "s", "limit for set_torque, tare and a predict_misalignment")
    probe_timeout: float = tunable(2.0, 0.25, 60.0, "s", "limit for an answer of probe, above the board's own")
    locate_timeout: float = tunable(10.0, 1.0, 120.0, "s", "limit for LOCATE")
    approach_timeout: float = tunable(20.0, 1.0, 120.0, "s", "limit for APPROACH")
    contact_timeout: float = tunable(45.0, 1.0, 120.0, "s", "limit for CONTACT and BACK_OFF")
    measure_timeout: float = tunable(10.0, 1.0, 120.0, "s", "limit for MEASURE")
    align_timeout: float = tunable(45.0, 1.0, 120.0, "s", "limit for one ALIGN")
    energise_timeout: float = tunable(10.0, 1.0, 120.0, "s", "limit for ENERGISE until current flows stably")
    duplicate_source_timeout: float = number(
        25.0, 0.0, 120.0, "s", "limit for second sources to go before the contactor closes"
    )
    retract_timeout: float = tunable(20.0, 1.0, 120.0, "s", "limit for RETRACT")
    goal_timeout: float = tunable(300.0, 5.0, 3600.0, "s", "limit for a whole docking until it succeeds")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.current_min + 2 * self.band_margin < self.current_max:
            problem = "current_min + 2 · band_margin must lie below current_max"
            raise ParameterError("current_min", self.current_min, problem)
        if self.always_live and self.approach != "guarded":
            problem = (
                "with power none every touch is live, so only approach guarded may dock: it looks before it presses"
            )
            raise ParameterError("approach", self.approach, problem)
        for lower, upper in _ORDERED:
            if getattr(self, lower) > getattr(self, upper):
                raise ParameterError(lower, getattr(self, lower), f"{lower} must not lie above {upper}")

    @property
    def classes_of(self) -> str:
        """The packaged model whose classes an estimate shall tell besides; '' = none."""
        return "cnn" if self.approach == "published" else ""

    @property
    def always_live(self) -> bool:
        """Whether the electrodes are live whenever they touch, and nothing tells what flows."""
        return self.power == "none"

    @property
    def keeps_clearance(self) -> bool:
        """Whether current may flow only with clearance; the algorithm as printed does not know it."""
        return self.approach != "published" or self.published_clearance_rule

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
        """Contact current that is aimed at where the contact is known, A."""
        return self.current_target - self.aim_below


@dataclass(frozen=True)
class DockingNodeParameters(Bounded):
    """Where the charger is on its robot.

    Raises:
        ParameterError: a value lies outside its bounds, or base_pose has a quaternion of length zero.
    """

    base_frame: str = words("base_link", "the robot's frame in which goals may be given besides charger_base")
    base_pose: tuple[float, ...] = numbers(
        (0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5),
        -math.inf,
        math.inf,
        "",
        "charger_base in base_frame: x, y, z in m, then the quaternion x, y, z, w",
    )
    lean_max: float = number(
        math.radians(30.0), 0.0, 0.5 * math.pi, "rad", "largest lean of a goal's electrodes from charger_base's z axis"
    )
    goal_lean_stddev: float = number(
        math.radians(1.0), 0.0, math.radians(10.0), "rad", "standard deviation of a goal's lean, which tells none"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not any(self.base_pose[3:]):
            problem = "its quaternion is zero: give x y z, then a quaternion x y z w of any length but zero"
            raise ParameterError("base_pose", self.base_pose, problem)
