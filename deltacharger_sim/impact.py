# SPDX-License-Identifier: Apache-2.0
"""Peak contact force of an impact, from sub-steps of the motion along z within a long step of the light model.

A step of milliseconds ends before or after an impact, never at its peak, and backward Euler damps the rebound.
Therefore, from shortly before contact, the motion along z is integrated again in sub-steps, with Jacobian, mass, goals
and torque limits of the step: M v̇ = Σ θ′ clip(k (goal − θ) − d θ̇) + gears + weight + magnets − contact force. The
target stands, though one that yields is struck less. The lateral motion is the step's. The trapezoidal rule conserves
the energy of a rebound. Sub-steps are short against the contact's oscillation period. They end where contact begins or
is lost, and at the hard stop. Their largest force is the step's, once the step itself has contact. The light model's
own motion does not use it.

Sub-stepping begins where the magnets begin to pull, so that the impact speed is not the step's. It ends when the
contact has settled or the sub-steps are used up: a rebound that nothing drives never exceeds the first impact.
Electrodes and stop are undamped springs, so that stiff ones rebound; only servos and gears damp. Play is ignored.
"""

import math
from typing import NamedTuple

from deltacharger_core.machine import BAR_GAP, BAR_HEIGHT, BAR_LENGTH
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.touch import TargetTouch, tilts

_PHASE = 0.4  # rad of the contact's oscillation in a sub-step; the force at a turning point is then within 2 %
_LONGEST = 0.002  # s of a sub-step, a tenth of the time in which the servos brake the platform
_FLIGHT_SHARE = 0.15  # of the distance over which the magnets' pull changes, travelled in a sub-step of flight
_MOST = 160  # sub-steps after first contact; full-length ones (soft contacts) do not count
_MOST_IN_STEP = 80  # sub-steps in one step
_LONGEST_MISMATCH = 0.06  # s that only one of the two motions may be in contact
_SHORTEST_FLIGHT = 1e-5  # s of a sub-step of flight that ends at first contact
_MISFIT = 0.1  # relative, and N: allowed difference of a leaning contact's force from its linear prediction
_AT_REST = 2e-4  # m/s, below which there is no impact
_LEAD_STEPS = 2.0  # steps at the approach speed before contact, at which sub-stepping begins at the latest
_LONGEST_MOVE = 0.005  # m, largest move of the platform in a step of the light model
_SEPARATED, _ON_SPRINGS, _ON_STOP = 0, 1, 2

Drive = tuple[float, float, float, float]
"""Of a powered servo: θ′ along z (rad/m), torque of its spring at the step's start, less the mean effect of the
lateral motion (N·m), torque limit (N·m), its stiffness as a share of the parameter."""


class StepForces(NamedTuple):
    """Inputs of the sub-steps from a step of the light model.

    Attributes:
        drives: of the powered servos.
        gears: stiffness of all gears' bristles along z, N/m.
        friction: of all gears along z, N.
        drag: viscosity of all gears along z, N·s/m.
        carried: weight along z, N.
        mass: effective, along z, kg.
        x: position of the target's centre in end_effector, m.
        y: along y, m.
    """

    drives: list[Drive]
    gears: float
    friction: float
    drag: float
    carried: float
    mass: float
    x: float
    y: float


class Impact:
    """Motion of one platform along z in sub-steps.

    Attributes:
        follows: whether an impact is being sub-stepped.
        reach: largest gap (m) at which a step may need sub-steps.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        contact, servo = parameters.contact, parameters.servo
        self._stiffnesses = (0.0, 2.0 * contact.stiffness, 2.0 * contact.stiffness + contact.hard_stop_stiffness)
        self._stop = contact.hard_stop  # m of compression
        self._range = parameters.magnets.range
        self._near = self._range if parameters.magnets.force > 0.0 else 0.0
        self._stiffness, self._damping = servo.stiffness, servo.damping
        self._touch = TargetTouch(parameters)
        self._onset = 0.0  # m of gap at which the faces first touch
        self._placed_at, self._pull = (math.nan, math.nan), 0.0
        target = parameters.target
        # Leaning faces touch first away from their centres, at this gap at most.
        self._onset_bound = BAR_LENGTH * abs(target.tilt_y) + (BAR_GAP + BAR_HEIGHT) * abs(target.tilt_x)
        self.reach = self._near + self._onset_bound + _LEAD_STEPS * _LONGEST_MOVE
        self.follows = self._spent = self._touched = False
        self._gap = self._speed = self._gear = self._peak = self._mismatch = 0.0
        self._left, self._regime = 0, _SEPARATED  # remaining sub-steps

    def concerns(self, gap: float, speed: float, dt: float, onset: float) -> bool:
        """Return whether a step of `dt` s from a `gap` (m), closing at `speed` (m/s), may have an impact.

        The faces first touch at a gap of `onset` m.
        """
        if self.follows:
            return True
        way, first = _LEAD_STEPS * speed * dt, onset if onset > self._near else self._near
        soon = gap < first + way if gap > -self._onset_bound else 0.0 < gap + self._stop < way
        if self._spent:
            self._spent = soon
            return False
        return soon and speed > _AT_REST

    def step(self, dt: float, gap: float, speed: float, gear: float, forces: StepForces, pressed: bool) -> float:
        """Advance by a step and return its largest contact force (N); 0 while the light model is not in contact.

        Args:
            dt: s.
            gap: of the light model at the step's start, m; its `forces` hold there.
            speed: of closing, m/s.
            gear: friction of the gears along z, N.
            forces: of the step.
            pressed: whether the light model has contact at its end.
        """
        if (forces.x, forces.y) != self._placed_at:
            self._placed_at = (forces.x, forces.y)
            self._place_target(*self._placed_at)
        if not self.follows:
            self.follows, self._touched = True, gap < self._onset
            self._gap, self._speed, self._gear, self._left = gap, speed, gear, _MOST
            self._regime = _SEPARATED if gap > self._onset else _ON_SPRINGS if gap > -self._stop else _ON_STOP
            self._peak = self._mismatch = 0.0
        self._advance(dt, gap, forces)
        self._mismatch = self._mismatch + dt if self._touched != pressed else 0.0
        if self._mismatch > _LONGEST_MISMATCH or (speed <= 0.0 and not (self._touched or pressed)):
            self.follows = False
            return 0.0
        if not pressed:
            return 0.0
        peak, self._peak = self._peak, 0.0
        return peak

    def _place_target(self, x: float, y: float) -> None:
        """Place the target's centre at (x, y) in end_effector, m."""
        self._touch.lie(x, y)
        self._pull = self._touch.forces(0.0, 0.0, 0.0, (0.0, 0.0), 0.0)[0]

    def _advance(self, dt: float, at: float, forces: StepForces) -> None:
        """Advance by `dt` s in sub-steps, until the contact has settled or they are used up."""
        low, high, push, gain = _linear(forces.drives)
        k, d, mass, most = self._stiffness, self._damping, forces.mass, forces.friction
        pull, uneven = self._pull, any(drive[3] != 1.0 for drive in forces.drives)
        bristle, remaining = forces.gears, _MOST_IN_STEP
        while dt > 0.0:
            gap, speed = self._gap, self._speed
            demand = k * (at - gap) + d * speed
            force, held, sprung = push - gain * demand, gain, gain
            if uneven:
                force, held, sprung = _each(forces.drives, k * (at - gap), d * speed)
            elif not low <= demand <= high:
                force, held = _saturated(forces.drives, demand)
                sprung = held
            magnet, softer = pull, 0.0
            if gap > 0.0:
                ratio = 1.0 + gap / self._range
                magnet = pull / (ratio * ratio)
                softer = 2.0 * magnet / (ratio * self._range)
            normal, stiff = self._normal(gap)
            longest = self._longest_sub_step(gap, speed, mass)
            h = min(longest, dt)
            gear = min(max(self._gear - 0.5 * bristle * h * speed, -most), most)
            force += d * held * speed + gear + forces.carried + magnet - normal
            h, end_speed = self._move(
                h, force, mass, 0.5 * (d * held + forces.drag), 0.25 * (k * sprung + stiff - softer)
            )
            self._gear = min(max(self._gear - bristle * (gap - self._gap), -most), most)
            dt, remaining = dt - h, remaining - 1
            self._left -= self._touched and longest < _LONGEST
            if remaining < 0 or self._left < 0 or (stiff > 0.0 and _settled(h, speed, end_speed, mass, normal, stiff)):
                self.follows, self._spent = False, True
                break
        if self._regime:
            self._peak = max(self._peak, self._normal(self._gap)[0])

    def _longest_sub_step(self, gap: float, speed: float, mass: float) -> float:
        """Return the longest permitted sub-step (s)."""
        if self._regime:
            return min(_LONGEST, _PHASE * math.sqrt(mass / self._stiffnesses[self._regime]))
        return min(_LONGEST, _FLIGHT_SHARE * (gap + self._range) / max(abs(speed), _AT_REST))

    def _normal(self, gap: float) -> tuple[float, float]:
        """Return normal force (N) and contact stiffness (N/m)."""
        if self._regime == _SEPARATED:
            return 0.0, 0.0
        first, both = self._stiffnesses[_ON_SPRINGS], self._stiffnesses[self._regime]
        return -first * gap - (both - first) * (gap + self._stop), both

    def _move(self, h: float, force: float, mass: float, damping: float, tangent: float) -> tuple[float, float]:
        """Move by `h` s, or until contact or stop is reached or lost; return time taken (s) and speed (m/s) then.

        Args:
            h: s.
            force: along z at the sub-step's start without damping, N.
            mass: kg.
            damping: half of the servos', N·s/m.
            tangent: a quarter of the stiffness, N/m.
        """
        gap, speed = self._gap, self._speed
        end_speed = _trapezoid(h, speed, force, mass, damping, tangent)
        end_gap = gap - 0.5 * h * (speed + end_speed)
        upper, lower = (
            (math.inf, 0.0, -self._stop)[self._regime],
            (0.0, -self._stop, -math.inf)[self._regime],
        )
        if end_gap < lower or end_gap > upper:
            edge = lower if end_gap < lower else upper
            h *= (gap - edge) / (gap - end_gap)
            end_speed = _trapezoid(h, speed, force, mass, damping, tangent) if h > 0.0 else speed
            self._regime += 1 if end_gap < lower else -1
            end_gap = edge
        if self._regime:
            self._touched = True
        if speed > 0.0 >= end_speed and self._regime:  # force grows with compression: it peaks at a turning point
            turning = gap - 0.5 * h * speed * speed / (speed - end_speed)
            self._peak = max(self._peak, self._normal(min(end_gap, turning))[0])
        self._gap, self._speed = end_gap, end_speed
        return h, end_speed


class LeaningImpact(Impact):
    """Impact with a leaning target or platform: stiffness grows with the length of the bars in contact.

    Sub-steps are short enough for the tangent at the start to predict the force at the end.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        super().__init__(parameters)
        self._solved = (math.nan, 0.0, 0.0)  # gap (m), normal force (N) and stiffness (N/m) there

    def _place_target(self, x: float, y: float) -> None:
        super()._place_target(x, y)
        assert self._touch.tilt is not None
        self._onset, self._solved = self._touch.tilt.onset, (math.nan, 0.0, 0.0)

    def _longest_sub_step(self, gap: float, speed: float, mass: float) -> float:
        ahead = gap - self._onset
        if ahead > 0.0:
            longest = super()._longest_sub_step(gap, speed, mass)
            return min(longest, max(ahead / speed, _SHORTEST_FLIGHT)) if speed > _AT_REST else longest
        _, stiff = self._normal(gap)
        return min(_LONGEST, _PHASE * math.sqrt(mass / stiff)) if stiff > 0.0 else _LONGEST

    def _normal(self, gap: float) -> tuple[float, float]:
        if gap >= self._onset:
            return 0.0, 0.0
        if gap != self._solved[0]:
            assert self._touch.tilt is not None
            self._solved = (gap, *self._touch.tilt.press(-gap))
        return self._solved[1:]

    def _move(self, h: float, force: float, mass: float, damping: float, tangent: float) -> tuple[float, float]:
        gap, speed = self._gap, self._speed
        before, stiff = self._normal(gap)
        least = _PHASE * math.sqrt(mass / self._stiffnesses[_ON_STOP])
        while True:
            end_speed = _trapezoid(h, speed, force, mass, damping, tangent)
            end_gap = gap - 0.5 * h * (speed + end_speed)
            normal, stiffer = self._normal(end_gap)
            if h <= least or abs(normal - before - stiff * (gap - end_gap)) <= _MISFIT * max(normal, before) + _MISFIT:
                break
            h *= 0.5
        if normal > 0.0 or before > 0.0:
            self._touched = True
            self._peak = max(self._peak, before, normal)
            if speed > 0.0 >= end_speed:
                turning = gap - 0.5 * h * speed * speed / (speed - end_speed)
                self._peak = max(self._peak, normal + stiffer * max(end_gap - turning, 0.0))
        self._regime = _ON_SPRINGS if normal > 0.0 else _SEPARATED
        self._gap, self._speed = end_gap, end_speed
        return h, end_speed


def _settled(h: float, speed: float, end_speed: float, mass: float, normal: float, stiff: float) -> bool:
    """Return whether neither acceleration nor speed, which can add v √(K M), can change the force noticeably."""
    little = 0.01 * normal + 0.1  # N
    slow = -_AT_REST < end_speed < _AT_REST or end_speed * end_speed * mass * stiff < little * little
    return slow and abs(end_speed - speed) * mass < h * little


def make_impact(parameters: WorldParameters) -> Impact:
    """Return the sub-stepped motion of a world's platform."""
    return LeaningImpact(parameters) if tilts(parameters) else Impact(parameters)


def _trapezoid(h: float, speed: float, force: float, mass: float, damping: float, tangent: float) -> float:
    """Return the speed after `h` s: M (v₁ − v₀)/h = F − (K h/4 + C/2) (v₀ + v₁), `tangent` K/4, `damping` C/2."""
    rate, held = mass / h, damping + tangent * h
    return (speed * (rate - held) + force) / (rate + held)


def _linear(drives: list[Drive]) -> tuple[float, float, float, float]:
    """Return the range of k Δz + d v (N·m/m) without saturated servos, and there Σ θ′ torque (N) and Σ θ′² (1/m²)."""
    low, high, push, gain = -math.inf, math.inf, 0.0, 0.0
    for slope, lead, limit, _ in drives:
        push += slope * lead
        gain += slope * slope
        if slope != 0.0:
            first, last = (lead - limit) / slope, (lead + limit) / slope
            low, high = max(low, min(first, last)), min(high, max(first, last))
    return low, high, push, gain


def _saturated(drives: list[Drive], demand: float) -> tuple[float, float]:
    """Return the servos' force (N) along z, and Σ θ′² (1/m²) of those that do not saturate."""
    force = held = 0.0
    for slope, lead, limit, _ in drives:
        drive = lead - slope * demand
        if -limit <= drive <= limit:
            held += slope * slope
        force += slope * min(max(drive, -limit), limit)
    return force, held


def _each(drives: list[Drive], spring: float, damper: float) -> tuple[float, float, float]:
    """Return force (N), Σ θ′² (1/m²) and Σ share · θ′² of those that do not saturate, k Δz and d v given (N·m/m)."""
    force = held = sprung = 0.0
    for slope, lead, limit, share in drives:
        drive = lead - slope * (share * spring + damper)
        if -limit <= drive <= limit:
            held += slope * slope
            sprung += share * slope * slope
        force += slope * min(max(drive, -limit), limit)
    return force, held, sprung
