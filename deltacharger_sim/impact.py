# SPDX-License-Identifier: Apache-2.0
"""The force with which electrodes strike, resolved inside the long steps of the light model: one number along z.

A step of milliseconds ends before or after an impact and never at its height, and backward Euler takes away what would
bounce. So, from shortly before touch, a second and finer course of z alone goes along with the steps, with Jacobian,
mass, goals and torque limits of the step: M v̇ = Σ θ′ clip(k (goal − θ) − d θ̇) + gears + weight + magnets − electrodes,
the lateral motion being that of the step. Its sub-steps follow the trapezoidal rule, which keeps the energy of a
bounce, are short beside the period of the contact, and are cut where the gap closes or opens and where the stop is met.
Its largest force is the step's, once the step itself has contact. The light model's own course does not know of it.

It begins where the magnets begin to pull, so that the speed of the strike is not the step's, and ends when it rests or
its sub-steps are spent: a bounce that nobody drives never strikes harder than the first. Electrodes are springs and a
stop without a damper of their own, so that stiff ones bounce; only servos and gears damp. Play is left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.tilt import tilts
from deltacharger_sim.touch import TargetTouch

_PHASE = 0.4  # rad of the contact's oscillation in a sub-step; the force at a turn is then within 2 %
_LONGEST = 0.002  # s of a sub-step, a third of the time in which servos of 0.91 N·m·s/rad brake the platform
_SHARE = 0.15  # of the way over which the magnets' pull changes, in a sub-step of flight
_MOST = 160  # sub-steps from touch on, those of contacts so soft that none need be short not counted
_MOST_IN_STEP = 80  # of flight in one step
_WAITS = 0.06  # s that one of the two courses may be in contact without the other
_SOONEST = 1e-5  # s of a sub-step of flight that ends at touch
_OFF = 0.1  # relative, and N: how far the force of a leaning contact may be from what its tangent promises
_CALM = 2e-4  # m/s, below which nothing strikes
_AHEAD = 2.0  # steps at the speed of the approach, in which the finer course begins at the latest
_STRIDE = 0.005  # m that a step of the light model moves the platform at most
_DECAYED = 0.9  # of the largest force, below which the next turn shows that the bounces die away
_OPEN, _PRESSED, _STOPPED = 0, 1, 2

Drive = tuple[float, float, float]
"""Of a powered servo: θ′ along z (rad/m), torque of its spring at the step's start, less what the lateral motion takes
of it in the mean (N·m), torque limit (N·m)."""


class StepForces(NamedTuple):
    """What a step of the light model holds for the finer course.

    Attributes:
        drives: of the powered servos.
        gears: stiffness of all gears' bristles along z, N/m.
        friction: of all gears along z, N.
        carried: weight along z, N.
        mass: that moves along z, kg.
        x: place of the target's centre in end_effector, m.
        y: likewise.
    """

    drives: list[Drive]
    gears: float
    friction: float
    carried: float
    mass: float
    x: float
    y: float


class Impact:
    """The finer course of one charger along z.

    Attributes:
        follows: whether a strike is being followed.
        reach: gap (m) from which on a step may matter.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        contact, servo = parameters.contact, parameters.servo
        self._springs = (0.0, 2.0 * contact.stiffness, 2.0 * contact.stiffness + contact.hard_stop_stiffness)
        self._depth = contact.hard_stop
        self._range = parameters.magnets.range
        self._near = self._range if parameters.magnets.force > 0.0 else 0.0
        self._stiffness, self._damping = servo.stiffness, servo.damping
        self._touch = TargetTouch(parameters)
        self._onset = 0.0  # m of gap at which the faces first touch
        self._pull_at, self._pull = (math.nan, math.nan), 0.0
        target, terminal = parameters.target, parameters.terminal
        # With a lean the electrodes meet before the middle of the faces does, by no more than this.
        self._early = terminal.length * abs(target.tilt_y) + (terminal.gap + terminal.height) * abs(target.tilt_x)
        self.reach = self._near + self._early + _AHEAD * _STRIDE
        self.follows = self._spent = self._touched = False
        self._gap = self._speed = self._gear = self._peak = self._largest = self._apart = 0.0
        self._left, self._branch = 0, _OPEN

    def concerns(self, gap: float, speed: float, dt: float, onset: float) -> bool:
        """Return whether a step of `dt` s that begins with a `gap` (m), closing at `speed` (m/s), may strike.

        The faces first touch at a gap of `onset` m.
        """
        if self.follows:
            return True
        way, first = _AHEAD * speed * dt, onset if onset > self._near else self._near
        soon = gap < first + way if gap > -self._early else 0.0 < gap + self._depth < way
        if self._spent:
            self._spent = soon
            return False
        return soon and speed > _CALM

    def step(self, dt: float, gap: float, speed: float, gear: float, forces: StepForces, pressed: bool) -> float:
        """Go on by a step and return the largest force in it (N); 0 while the light model is not in contact.

        Args:
            dt: s.
            gap: of the light model at the step's start, m; its `forces` hold there.
            speed: at which it closes, m/s.
            gear: friction of the gears along z, N.
            forces: of the step.
            pressed: whether the light model has contact at its end.
        """
        if (forces.x, forces.y) != self._pull_at:
            self._pull_at = (forces.x, forces.y)
            self._lie(*self._pull_at)
        if not self.follows:
            self.follows, self._touched = True, gap < self._onset
            self._gap, self._speed, self._gear, self._left = gap, speed, gear, _MOST
            self._branch = _OPEN if gap > self._onset else _PRESSED if gap > -self._depth else _STOPPED
            self._peak = self._largest = self._apart = 0.0
        self._advance(dt, gap, forces)
        self._apart = self._apart + dt if self._touched != pressed else 0.0
        if self._apart > _WAITS or (speed <= 0.0 and not (self._touched or pressed)):
            self.follows = False
            return 0.0
        if not pressed:
            return 0.0
        peak, self._peak = self._peak, 0.0
        return peak

    def _lie(self, x: float, y: float) -> None:
        """Put the target's centre to (x, y) in end_effector, m."""
        self._touch.lie(x, y)
        self._pull = self._touch.forces(0.0, 0.0, 0.0, (0.0, 0.0), 0.0)[0]

    def _advance(self, dt: float, at: float, forces: StepForces) -> None:
        """Go on by `dt` s in sub-steps, or until it rests or they are spent."""
        low, high, push, grip = _linear(forces.drives)
        k, d, mass, most = self._stiffness, self._damping, forces.mass, forces.friction
        pull = self._pull
        bristle, flights = forces.gears, _MOST_IN_STEP
        while dt > 0.0:
            gap, speed = self._gap, self._speed
            asked = k * (at - gap) + d * speed
            force, held = push - grip * asked, grip
            if not low <= asked <= high:
                force, held = _clipped(forces.drives, asked)
            magnet, softer = pull, 0.0
            if gap > 0.0:
                ratio = 1.0 + gap / self._range
                magnet = pull / (ratio * ratio)
                softer = 2.0 * magnet / (ratio * self._range)
            normal, stiff = self._normal(gap)
            longest = self._longest(gap, speed, mass)
            h = min(longest, dt)
            gear = min(max(self._gear - 0.5 * bristle * h * speed, -most), most)
            force += d * held * speed + gear + forces.carried + magnet - normal
            h, after = self._move(h, force, mass, 0.5 * d * held, 0.25 * (k * held + stiff - softer))
            self._gear = min(max(self._gear - bristle * (gap - self._gap), -most), most)
            dt, flights = dt - h, flights - 1
            self._left -= self._touched and longest < _LONGEST
            if flights < 0 or self._left < 0 or (stiff > 0.0 and _is_calm(h, speed, after, mass, normal, stiff)):
                self.follows, self._spent = False, True
                break
        if self._branch:
            self._peak = max(self._peak, self._normal(self._gap)[0])

    def _longest(self, gap: float, speed: float, mass: float) -> float:
        """Return how long a sub-step may be (s)."""
        if self._branch:
            return min(_LONGEST, _PHASE * math.sqrt(mass / self._springs[self._branch]))
        return min(_LONGEST, _SHARE * (gap + self._range) / max(abs(speed), _CALM))

    def _normal(self, gap: float) -> tuple[float, float]:
        """Return normal force (N) and stiffness (N/m)."""
        if self._branch == _OPEN:
            return 0.0, 0.0
        first, both = self._springs[_PRESSED], self._springs[self._branch]
        return -first * gap - (both - first) * (gap + self._depth), both

    def _move(self, h: float, force: float, mass: float, damping: float, tangent: float) -> tuple[float, float]:
        """Move by `h` s, or up to where the gap or the stop opens or closes; return the time (s) and speed (m/s) then.

        Args:
            h: s.
            force: along z at the sub-step's start without damping, N.
            mass: kg.
            damping: half of the servos', N·s/m.
            tangent: a quarter of the stiffness, N/m.
        """
        gap, speed = self._gap, self._speed
        after = _trapezoid(h, speed, force, mass, damping, tangent)
        to = gap - 0.5 * h * (speed + after)
        upper, lower = (math.inf, 0.0, -self._depth)[self._branch], (0.0, -self._depth, -math.inf)[self._branch]
        if to < lower or to > upper:
            edge = lower if to < lower else upper
            h *= (gap - edge) / (gap - to)
            after = _trapezoid(h, speed, force, mass, damping, tangent) if h > 0.0 else speed
            self._branch += 1 if to < lower else -1
            to = edge
        turned = speed > 0.0 >= after
        if self._branch:
            self._touched = True
        if turned and self._branch:  # the force grows with the depth: between turns there is no peak
            self._turn(self._normal(min(to, gap - 0.5 * h * speed * speed / (speed - after)))[0])
        self._gap, self._speed = to, after
        return h, after

    def _turn(self, force: float) -> None:
        """Take a force (N) at which the motion turned back for the peak if it is one; the last where they decline."""
        self._peak = max(self._peak, force)
        if force < _DECAYED * self._largest:
            self._left = -1
        self._largest = max(self._largest, force)


class LeaningImpact(Impact):
    """The finer course where target or platform may lean: the force hangs on the depth by what presses of the bars.

    A sub-step is short enough for its tangent to foretell the force at its end, also where a bar comes to lie flat.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        super().__init__(parameters)
        self._felt = (math.nan, 0.0, 0.0)  # gap (m), normal force (N) and stiffness (N/m) there

    def _lie(self, x: float, y: float) -> None:
        super()._lie(x, y)
        assert self._touch.tilt is not None
        self._onset, self._felt = self._touch.tilt.onset, (math.nan, 0.0, 0.0)

    def _longest(self, gap: float, speed: float, mass: float) -> float:
        ahead = gap - self._onset
        if ahead > 0.0:
            longest = super()._longest(gap, speed, mass)
            return min(longest, max(ahead / speed, _SOONEST)) if speed > _CALM else longest
        _, stiff = self._normal(gap)
        return min(_LONGEST, _PHASE * math.sqrt(mass / stiff)) if stiff > 0.0 else _LONGEST

    def _normal(self, gap: float) -> tuple[float, float]:
        if gap >= self._onset:
            return 0.0, 0.0
        if gap != self._felt[0]:
            assert self._touch.tilt is not None
            self._felt = (gap, *self._touch.tilt.press(-gap))
        return self._felt[1:]

    def _move(self, h: float, force: float, mass: float, damping: float, tangent: float) -> tuple[float, float]:
        gap, speed = self._gap, self._speed
        before, stiff = self._normal(gap)
        least = _PHASE * math.sqrt(mass / self._springs[_STOPPED])
        while True:
            after = _trapezoid(h, speed, force, mass, damping, tangent)
            to = gap - 0.5 * h * (speed + after)
            normal, stiffer = self._normal(to)
            if h <= least or abs(normal - before - stiff * (gap - to)) <= _OFF * max(normal, before) + _OFF:
                break
            h *= 0.5
        if normal > 0.0 or before > 0.0:
            self._touched = True
            self._peak = max(self._peak, before, normal)
            if speed > 0.0 >= after:
                turned = gap - 0.5 * h * speed * speed / (speed - after)
                self._turn(normal + stiffer * max(to - turned, 0.0))
        self._branch = _PRESSED if normal > 0.0 else _OPEN
        self._gap, self._speed = to, after
        return h, after


def _is_calm(h: float, speed: float, after: float, mass: float, normal: float, stiff: float) -> bool:
    """Return whether neither acceleration nor speed, which can add v √(K M), changes the force by much."""
    little = 0.01 * normal + 0.1  # N
    slow = -_CALM < after < _CALM or after * after * mass * stiff < little * little
    return slow and abs(after - speed) * mass < h * little


def make_impact(parameters: WorldParameters) -> Impact:
    """Return the finer course of a world."""
    return LeaningImpact(parameters) if tilts(parameters) else Impact(parameters)


def _trapezoid(h: float, speed: float, force: float, mass: float, damping: float, tangent: float) -> float:
    """Return the speed after `h` s: M (v₁ − v₀)/h = F − (K h/4 + C/2) (v₀ + v₁), `tangent` K/4, `damping` C/2."""
    rate, held = mass / h, damping + tangent * h
    return (speed * (rate - held) + force) / (rate + held)


def _linear(drives: list[Drive]) -> tuple[float, float, float, float]:
    """Return between which k Δz + d v (N·m/m) no servo is at its limit, and there Σ θ′ torque (N) and Σ θ′² (1/m²)."""
    low, high, push, grip = -math.inf, math.inf, 0.0, 0.0
    for slope, lead, limit in drives:
        push += slope * lead
        grip += slope * slope
        if slope != 0.0:
            first, last = (lead - limit) / slope, (lead + limit) / slope
            low, high = max(low, min(first, last)), min(high, max(first, last))
    return low, high, push, grip


def _clipped(drives: list[Drive], asked: float) -> tuple[float, float]:
    """Return the servos' force (N) along z, and Σ θ′² (1/m²) of those that are not at their limit."""
    force = held = 0.0
    for slope, lead, limit in drives:
        drive = lead - slope * asked
        if -limit <= drive <= limit:
            held += slope * slope
        force += slope * min(max(drive, -limit), limit)
    return force, held
