# SPDX-License-Identifier: Apache-2.0
"""Straight lines of the platform in ``charger_base``, timed within the limits of platform and servos.

The path follows s = 10u³ − 15u⁴ + 6u⁵ of the time share u = t/T (minimum jerk): it starts and ends without speed and
acceleration and has the least mean square jerk for its duration. A trapezoid of the same peak speed is faster. At equal
duration, however, the arm on its soft servos settles sooner with this law and needs a fraction of the acceleration
(docs/kinematics.md).

With point p(s) and rod r = p − c(θ) of a limb, differentiating |r|² = L² twice gives the arm's motion along s::

    θ' = r·p' / r·c'        θ'' = (|p' − c' θ'|² − r·c'' θ'²) / r·c'        r / r·c' = a row of J⁻¹

and ṡ = s'(u)/T gives the rates in time. Speeds scale with 1/T and accelerations with 1/T², so one scaling of T meets
every limit without a search.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core import arrays, machine
from deltacharger_kinematics import geometry, solve
from deltacharger_kinematics.delta import Delta, as_vectors

REFUSED = (
    geometry.NO_ANSWER
    | geometry.Status.WRONG_ASSEMBLY
    | geometry.Status.NEAR_TYPE_2
    | geometry.Status.JOINT_LIMIT
    | geometry.Status.SWING_LIMIT
)
"""Statuses refused for points of a line. Points outside the workspace box and near the edge of reach
(NEAR_TYPE_1) are allowed, because the platform is still held firmly there."""

T = TypeVar("T", float, arrays.Array)

PEAK_SPEED = 1.875  # ds/du at u = 1/2, its maximum
_CHECKED = 512  # intervals at which limits are checked: at most 0.4 % of the line apart
_SLACK = 1.0002  # the fastest instant may lie between two checks
_INTERVAL, _FEWEST = 0.02, 2  # s, longest time between two points; least number of intervals
_STRETCHED = 1e-5  # margin (about 1 µm from the edge of reach) below which an arm's acceleration is unbounded


ARM_SPEED, ARM_ACCELERATION = machine.JOINT_SPEED, 25.0
"""Limits of the arms (rad/s, rad/s²); they fit this charger's MX-64 at 12 V.

speed: no-load speed 63 rpm = 6.60 rad/s, stall torque 6.0 N·m (vendor's e-manual). With 1.49 N·m (heaviest pose
0.47 N·m plus 0.7 A of push), 4.95 rad/s are left.

acceleration: 0.7 A · 1.463 N·m/A less gear friction (0.1 N·m and a fifth of the torque) accelerate at most 0.0285
kg·m² by 25.2 rad/s². This inertia is the largest row sum of m JᵀJ + I in the workspace, with m = 0.319 kg (platform
and half of the rods) and I = 0.0122 kg·m² (rotor through the gear, other halves of the rods). Rotor and friction
are BAM's fits of the MX-64.
"""


@dataclass(frozen=True, eq=False)
class Line:
    """A straight line, at rest at both ends; row k is at times[k].

    Attributes:
        times: (n,) s, from 0.
        positions: (n, 3) m in charger_base.
        angles: (n, 3) rad.
        velocities: (n, 3) rad/s.
        accelerations: (n, 3) rad/s².
    """

    times: arrays.Array
    positions: arrays.Array
    angles: arrays.Array
    velocities: arrays.Array
    accelerations: arrays.Array

    @property
    def duration(self) -> float:
        """Time from start to rest, s."""
        return float(self.times[-1])


class LineRefused(ValueError):
    """A line has points that the platform must not pass.

    Attributes:
        status: of the first refused point.
        position: this point, m, charger_base.
        share: share of the line before it, 0 to 1.
    """

    def __init__(self, status: geometry.Status, position: geometry.Vector, share: float) -> None:
        self.status, self.position, self.share = status, position, share
        place = ", ".join(f"{1000 * value:.5g}" for value in position)
        what = status.name or repr(status)
        super().__init__(f"({place}) mm, {100 * share:.0f} % along the line, is {what}; choose another goal or path")


def plan_line(delta: Delta, start: ArrayLike, goal: ArrayLike, speed: float) -> Line:
    """Return the fastest line of this time law within all limits, with points at most 0.02 s apart.

    The arms' limits also hold between the points, to 0.02 % in the workspace and 1 % at the edge of reach. With linear
    interpolation of joint angles, the platform deviates by at most 0.02 mm from a line in the workspace at 0.12 m/s,
    and by at most 0.2 mm at any speed within the limits.

    Args:
        delta: the arm.
        start: (3,) m, charger_base.
        goal: (3,) m, charger_base; may equal the start.
        speed: peak speed of the platform, m/s, above 0.

    Raises:
        LineRefused: a point of the line, or of 513 checked places along it, has a status of REFUSED, is at the very
            edge of reach, or lies where an angle would pass ±π.
        ValueError: names the argument that is not an array (3,) of numbers.
    """
    first, last = as_vectors(start, "start"), as_vectors(goal, "goal")
    survey = _Motion(delta, first, last, np.linspace(0.0, 1.0, _CHECKED + 1))
    duration = max(
        PEAK_SPEED * math.dist(first, last) / speed,
        _SLACK * float(np.abs(survey.velocities).max()) / ARM_SPEED,
        _SLACK * math.sqrt(float(np.abs(survey.accelerations).max()) / ARM_ACCELERATION),
        _FEWEST * _INTERVAL,
    )
    shares = np.linspace(0.0, 1.0, math.ceil(duration / _INTERVAL) + 1)
    motion = _Motion(delta, first, last, shares)
    return Line(
        shares * duration,
        motion.positions,
        motion.angles,
        motion.velocities / duration,
        motion.accelerations / duration**2,
    )


def way_done(share: T) -> T:
    """Return the share of the path covered at `share` of the line's time, both 0 to 1."""
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


class _Motion:
    """The line at time shares u (n,): positions, angles, and their first two derivatives by u."""

    def __init__(self, delta: Delta, start: arrays.Array, goal: arrays.Array, u: arrays.Array) -> None:
        done = way_done(u)[:, None]
        self.positions = (1.0 - done) * start + done * goal
        solved = delta.inverse(self.positions)
        self.angles = solved.angles
        status = np.asarray(solved.status)
        self._refuse(status, (status & np.uint32(REFUSED)) != 0, done)
        turned = np.zeros(len(u), dtype=bool)  # past ±π the angle wraps to the other side, and the arm would turn back
        turned[1:] = (np.abs(np.diff(self.angles, axis=0)) > math.pi).any(axis=1)
        self._refuse(status | np.uint32(geometry.Status.JOINT_LIMIT), turned, done)
        self._refuse(status | np.uint32(geometry.Status.NEAR_TYPE_1), np.asarray(solved.margin) < _STRETCHED, done)
        slope, bend = _derivatives(delta, self.positions, self.angles, goal - start)
        speed = (30.0 * u**2 * (1.0 - u) ** 2)[:, None]
        self.velocities = slope * speed
        self.accelerations = bend * speed**2 + slope * (60.0 * u * (1.0 - u) * (1.0 - 2.0 * u))[:, None]

    def _refuse(self, status: NDArray[np.uint32], bad: arrays.Mask, done: arrays.Array) -> None:
        indices = np.flatnonzero(bad)
        if len(indices):
            x, y, z = self.positions[indices[0]].tolist()
            raise LineRefused(geometry.Status(int(status[indices[0]])), (x, y, z), float(done[indices[0], 0]))


def _derivatives(
    delta: Delta, positions: arrays.Array, angles: arrays.Array, direction: arrays.Array
) -> tuple[arrays.Array, arrays.Array]:
    """Return dθ/ds and d²θ/ds² (n, 3) along p' = `direction` (3,) at `positions` (n, 3) with arm `angles` (n, 3).

    In each limb's axes (outward, across, ahead) c' = a (−sin θ, 0, cos θ) and c'' = −a (cos θ, 0, sin θ).
    """
    limbs = solve.LimbArrays(delta.geometry)
    cosine, sine, arm = limbs.cosine, limbs.sine, limbs.arm
    (x, y, z), (dx, dy, dz) = positions.T, direction
    outward, across = cosine * dx + sine * dy, cosine * dy - sine * dx
    angle = angles.T + limbs.angle_offset
    arm_u, arm_w = arm * np.cos(angle), arm * np.sin(angle)
    rod_u = cosine * x + sine * y - limbs.difference - arm_u
    rod_v = cosine * y - sine * x - limbs.tangential
    rod_w = z + limbs.motor_height - arm_w
    lever = rod_w * arm_u - rod_u * arm_w
    slope = (rod_u * outward + rod_v * across + rod_w * dz) / lever
    yielding = (outward + arm_w * slope) ** 2 + across**2 + (dz - arm_u * slope) ** 2
    bend = (yielding + (rod_u * arm_u + rod_w * arm_w) * slope**2) / lever
    return slope.T, bend.T
