# SPDX-License-Identifier: Apache-2.0
"""Docking's model of the arm: how its servos yield, how its platform tilts, and the lines that it can follow."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from deltacharger_core.machine import PAD_YAW_STIFFNESS, SERVO_DAMPING, SERVO_INERTIA, SERVO_STIFFNESS
from deltacharger_docking.codes import Unreachable
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics import Delta, DeltaGeometry, Status, swing, trajectory_feed
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.line import Line, LineRefused, plan_line

LOAD_SHARES = 0.15, 0.3
"""Of a motor's torque, least and most that its gear takes: BAM's fits of the MX-64, without the worst."""
_LEAST_LOAD, _LEAST_YIELD = 0.3, 0.003  # A and rad of all servos, root of the sum of squares: above noise and counts
_REMEMBERED = 1.0  # A² of readings after which older ones fade: about two readings in the band
_UNEXPLAINED = 0.5  # share of the lags that one compliance of all servos may leave: play and encoder resolution
_SOFTEST, _STIFFEST = 1.5, 60.0  # N·m/rad that are accepted: the tested range, 2 to 40, and a margin
_HELD_BACK, _HELD_ON = 0.5, 0.8  # of the friction in free air that may come on top; chosen on seed 43
_CONSTANT_MAX = 1.66 / 1.463  # BAM's torque constant over the one by stall
_LONGEST_SETTLE = 1.5  # s, of servos that hardly brake, or creep
_FITS = 1.5  # ratio of two readings of one compliance


class Springs:
    """Yield of the servos under load.

    While its goal is fixed a servo's torque is k (goal − angle) − d ω = Kt I, independent of friction. So each such
    reading gives the compliance Kt/k, by least squares through zero over recent readings. Play counts as compliance.
    The estimate is kept between dockings, since the arm is the same.

    Attributes:
        compliance: yield of a servo per ampere, rad/A.
        damping: of a servo, N·m·s/rad: as configured, then the mean of those measured.
        dampings: of each, as measured last; NaN = not.
        play: between encoder and arm, rad: the mean of those measured.
        friction: of each gear with its share of the cable, measured in free air, N·m.
        beyond_weight: torque of free motion beyond the arm's weight, N·m: friction, and a cable that pulls.
        friction_force: of all along z, N.
        is_estimated: whether it was estimated, not only configured.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self._constant = parameters.torque_constant
        self.damping = SERVO_DAMPING
        self.dampings: Vector = (math.nan, math.nan, math.nan)
        self.play = 0.0
        self.friction: Vector = (0.0, 0.0, 0.0)
        self.beyond_weight: Vector = (0.0, 0.0, 0.0)
        self.friction_force = 0.0
        self._yields = self._squares = 0.0  # rad·A and A²
        self.compliance = self._constant / parameters.servo_stiffness
        self.is_estimated = False

    @property
    def stiffness(self) -> float:
        """Of a servo, N·m/rad."""
        return self._constant / self.compliance

    @property
    def lag(self) -> float:
        """Delay with which a servo follows its goal, s."""
        return self.damping / self.stiffness

    @property
    def softness(self) -> float:
        """Ratio of the usual stiffness to this one."""
        return SERVO_STIFFNESS / self.stiffness

    @property
    def frequency(self) -> float:
        """Of the servo's undamped oscillation, rad/s."""
        return math.sqrt(self.stiffness / SERVO_INERTIA)

    @property
    def settle_time(self) -> float:
        """Time for the arm in free air to come to rest after a step: four time constants of its slower mode, s."""
        half = 0.5 * self.damping / SERVO_INERTIA
        slower = half - math.sqrt(max(half * half - self.frequency**2, 0.0))
        return min(max(4.0 / slower, 0.1), _LONGEST_SETTLE) if slower > 0.0 else _LONGEST_SETTLE

    def true_force(self, told: float) -> tuple[float, float]:
        """Return the least and the largest push (N) that currents of `told` N may mean.

        The tare takes out friction without load while pressing on. What it leaves: friction by load and by the cable,
        which may hold back or, after the push fell, hold on; and the torque constant.
        """
        least, most = LOAD_SHARES
        low = max((1.0 - most) * told - _HELD_BACK * self.friction_force, min(told, 0.0))
        high = (1.0 - least) * _CONSTANT_MAX * told + _HELD_ON * self.friction_force
        return min(low, high), max(low, high)  # a pull turns the factors' order

    def learn_swing(self, servos: Sequence[swing.Swung]) -> None:
        """Take over what the servos showed of their springs and dampers; NaN = not shown."""
        a, b, c = (each.damping for each in servos)
        self.dampings = a, b, c
        known = [each for each in servos if math.isfinite(each.damping)]
        if not known:
            return
        self.damping = max(sum(each.damping for each in known) / len(known), 0.0)
        stiffness = sum(each.stiffness for each in known) / len(known)
        self.play = sum(each.play for each in known) / len(known)
        if _SOFTEST <= stiffness <= _STIFFEST:
            self.compliance, self.is_estimated = self._constant / stiffness, True
            self._yields, self._squares = self.compliance * _REMEMBERED, _REMEMBERED

    def add_reading(self, goals: Vector, angles: Vector, rates: Vector, currents: Vector) -> None:
        """Use a reading with fixed goals (rad): arm angles (rad) and rates (rad/s), and currents (A).

        Readings under a light load are ignored, and so are those that no common spring in the tested range explains,
        such as those of blocked servos. A reading that contradicts earlier ones replaces them: gains changed, or the
        earlier were wrong.
        """
        lags = tuple(goal - angle for goal, angle in zip(goals, angles, strict=True))
        braked = self.damping / self._constant
        loads = tuple(current + braked * rate for current, rate in zip(currents, rates, strict=True))
        size, squares = math.hypot(*lags), sum(load * load for load in loads)
        if not (squares >= _LEAST_LOAD * _LEAST_LOAD and size >= _LEAST_YIELD):
            return
        yields = sum(lag * load for lag, load in zip(lags, loads, strict=True))
        here = yields / squares
        left = math.hypot(*(lag - here * load for lag, load in zip(lags, loads, strict=True)))
        if not (_SOFTEST * here <= self._constant <= _STIFFEST * here and left <= _UNEXPLAINED * size):
            return
        if not self.compliance / _FITS <= here <= self.compliance * _FITS:
            self._yields = self._squares = 0.0
        share = min(_REMEMBERED / squares, 1.0)
        kept = min((_REMEMBERED - share * squares) / self._squares, 1.0) if self._squares else 0.0
        self._yields = kept * self._yields + share * yields
        self._squares = kept * self._squares + share * squares
        self.compliance, self.is_estimated = self._yields / self._squares, True


_DOUBT = 0.4  # relative error of the share by the parameters: compliance and stiffness differ between robots


class RemainingShare:
    """Share of a yaw that remains in contact: 1/(1 + compliance · stiffness) by the parameters, then as learnt.

    It learns from targets with a detected yaw: their contacts measure the remaining yaw as a load bias.

    Attributes:
        value: dimensionless.
        stddev: of it.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self.value = 1.0 / (1.0 + parameters.platform_compliance * PAD_YAW_STIFFNESS)
        self.stddev = _DOUBT * self.value

    def learn(self, seen: float, seen_stddev: float, left: float, left_stddev: float) -> None:
        """Add one target: its yaw along the ridges as detected (rad), and the measured rest of it (rad)."""
        known = all(map(math.isfinite, (seen, seen_stddev, left, left_stddev)))
        if not known or self.stddev == 0.0 or seen == 0.0:
            return
        # Error of the quotient by errors of yaw and bias.
        spread = math.hypot(left_stddev, self.value * seen_stddev) / abs(seen)
        weight = self.stddev**2 / (self.stddev**2 + spread**2)
        self.value += weight * (left / seen - self.value)
        self.value = min(max(self.value, 1e-3), 1.0)
        self.stddev *= math.sqrt(1.0 - weight)


class Planner:
    """Plans lines in ``charger_base`` (m) under speed limits, with the weight of the arm fed forward.

    Attributes:
        parameters: may be replaced if those of the machine stay equal.
        springs: the servos' yielding.
    """

    def __init__(self, parameters: DockingParameters, geometry: DeltaGeometry) -> None:
        self.parameters = parameters
        self._delta = Delta(geometry)
        self.springs = Springs(parameters)

    def line(self, start: Vector, goal: Vector, speed: float) -> tuple[trajectory_feed.Waypoint, ...]:
        """Return the waypoints from `start` to `goal`, without the start itself.

        The commanded angles lead the desired ones by the servos' yield under the arm's weight. The goal may be outside
        the workspace box, since pressing puts it beyond the target. It must be within reach, joint limits and rod
        swing.

        Args:
            start: present commanded position.
            goal: wanted position.
            speed: peak speed, m/s; the servos' own limits may make the line slower.

        Raises:
            Unreachable: a point of the line has no good solution; nothing was moved.
        """
        try:
            line = plan_line(self._delta, start, goal, speed)
        except LineRefused as error:
            if error.share == 0.0:
                raise Unreachable(
                    f"the arm cannot move from its present position: {error}; push it back by hand, with its torque off"
                ) from error
            raise Unreachable(f"the arm cannot go that way: {error}; move the robot closer to the target") from error
        held = self._delta.holding_torque(line.positions, self.parameters.gravity)
        angles, velocities = self._command(line, held / self.springs.stiffness)
        bound = np.abs(held) + self._beyond_weight()
        return tuple(
            trajectory_feed.Waypoint(time, _vector(row), _vector(torque), _vector(rate))
            for time, row, torque, rate in list(zip(line.times.tolist(), angles, bound, velocities, strict=True))[1:]
        )

    def bound(self, held: Vector) -> Vector:
        """Return the torque bound (N·m) of each servo that holds `held`: its free-motion torque and the push."""
        a, b, c = (abs(torque) + more for torque, more in zip(held, self._beyond_weight(), strict=True))
        return a, b, c

    def _beyond_weight(self) -> Vector:
        push = self.parameters.push_current * self.parameters.torque_constant
        a, b, c = self.springs.beyond_weight
        return a + push, b + push, c + push

    def check_way(self, speed: float, *places: Vector) -> None:
        """Check every leg of a way through `places` before the arm moves.

        Raises:
            Unreachable: as for `line`.
        """
        for start, goal in pairwise(places):
            self.line(start, goal, speed)

    def reach_problem(self, *points: Vector) -> str:
        """Return '' if every point is in the workspace with good angles, else the problem of the first bad one."""
        solved = self._delta.inverse(np.array(points))
        for point, status in zip(points, np.atleast_1d(np.asarray(solved.status)), strict=True):
            if status:
                place = ", ".join(f"{1000 * value:.1f}" for value in point)
                return f"({place}) mm: {Status(int(status)).name}"
        return ""

    def _command(self, line: Line, lead: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the commanded angles and velocities: the line's with the lead, inside the joint limits."""
        geometry = self._delta.geometry
        wanted = line.angles + lead
        angles = np.clip(wanted, geometry.joint_min, geometry.joint_max)
        velocities = line.velocities + np.gradient(lead, line.times, axis=0)
        velocities[[0, -1]] = 0.0
        return angles, np.where(angles == wanted, velocities, 0.0)


def _vector(row: np.ndarray) -> Vector:
    return float(row[0]), float(row[1]), float(row[2])
