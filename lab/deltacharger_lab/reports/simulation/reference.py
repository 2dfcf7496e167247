# SPDX-License-Identifier: Apache-2.0
"""The charger on its axis as one degree of freedom, integrated to convergence: the reference of impacts and the map.

At x = y = 0 and without weight all limbs move equally, so the platform's z is the only coordinate: M(z) z̈ + ½ M′ ż² =
3 θ′ (τ + f − b θ′ ż) + magnets − electrodes, with M = m + 3 I θ′² (m platform and rods, I rotor), the servos' torque τ
= clip(k (goal − θ) − d θ′ ż, ±limit), the gear's viscosity b, and its friction f, a bristle, as a state; it slips at a
torque that grows with |τ|. θ(z) is a polynomial through the answers
of `ScalarDelta`, good to 1e-12 rad, whose derivatives are exact. Nothing here uses the light model's equations or
step.

Everything is smooth between touch, stop, saturation, slip and commands; each of these ends a piece of the integration
(scipy's DOP853, order 8, with root finding), so that no step ever crosses a kink and the error control resolves the
contact's period. The report has the change by a tolerance a thousand times tighter.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.mechanics import GEAR_BRISTLE
from deltacharger_sim.parameters import WorldParameters

TOLERANCE = 1e-8  # relative, of a step
_LOW, _MIDDLE, _HIGH = -0.005, 0.02, 0.105  # m of z; two polynomials cover it
_DEGREE, _GOOD = 20, 1e-12  # their degree; rad, their largest error
_ABSOLUTE = (1e-4, 1e-2, 1.0)  # of z (m), speed (m/s) and bristle torque (N·m), each times the tolerance
_STRIDE, _PHASE = 0.02, 5.0  # s, and rad of the contact's oscillation, of a step at most: longer ones only fail
_MOST_PIECES = 100_000
# A piece starts this far (m, N·m) beyond the kink that ended the last one, so that its events find the next crossing.
_BEYOND, _BEYOND_TORQUE = 1e-13, 1e-10

Order = tuple[float, float, float]
"""Start time (s), the servos' common goal (rad) and current bound (A)."""
Event = Callable[[float, Any], float]


@dataclass
class AxisCourse:
    """Motion of the charger on its axis.

    Attributes:
        trace: z at the sampled times, m.
        peak: largest normal force, N.
        speed: at the first touch, m/s; NaN = none.
        left: speed at the end, m/s.
        force: normal force at the end, N.
    """

    trace: list[float] = field(default_factory=list)
    peak: float = 0.0
    speed: float = math.nan
    left: float = math.nan
    force: float = 0.0


def on_axis(
    parameters: WorldParameters,
    start: float,
    orders: Sequence[Order],
    duration: float,
    sample: float = math.inf,
    tolerance: float = TOLERANCE,
) -> AxisCourse:
    """Return the motion of a charger that rests at z = `start` (m) and follows `orders` for `duration` s.

    It excludes weight, tilt, play, latency and sag of the supply.

    Raises:
        ValueError: it left the covered range of z.
        ArithmeticError: the integration failed, or did not end.
    """
    return _Axis(parameters, tolerance).run(start, orders, duration, sample)


@cache
def _fit(low: float, high: float) -> tuple[tuple[float, ...], ...]:
    """Return coefficients, highest first, of θ (rad) and two derivatives by u, −1 at `low` and 1 at `high`."""
    delta = ScalarDelta(DeltaGeometry())

    def exactly(u: float) -> float:
        return delta.inverse(0.0, 0.0, low + 0.5 * (u + 1.0) * (high - low))[0]

    fit = np.polynomial.Chebyshev.interpolate(lambda points: np.array([exactly(u) for u in points]), _DEGREE)
    off = max(abs(fit(u) - exactly(u)) for u in np.linspace(-1.0, 1.0, 101))
    if not off < _GOOD:
        raise ValueError(f"the polynomial from z = {low} to {high} m is {off:.1e} rad off; give a higher degree")
    plain = fit.convert(kind=np.polynomial.Polynomial)
    return tuple(tuple(each.coef[::-1].tolist()) for each in (plain, plain.deriv(), plain.deriv(2)))


def angle(z: float) -> tuple[float, float, float]:
    """Return θ (rad), θ′ (rad/m) and θ″ (rad/m²) of every limb at z (m) on the axis."""
    low, high = (_MIDDLE, _HIGH) if z > _MIDDLE else (_LOW, _MIDDLE)
    scale = 2.0 / (high - low)
    # Trial points of a step may lie far outside the range of the polynomial.
    u, values = min(max((z - low) * scale - 1.0, -1.0), 1.0), []
    for row in _fit(low, high):
        value = 0.0
        for each in row:
            value = value * u + each
        values.append(value)
    return values[0], values[1] * scale, values[2] * scale * scale


class _Axis:
    """One charger; `_contact`, `_clipped` and `_slip` name its present smooth piece (−1, 0, 1; 0, 1, 2)."""

    def __init__(self, parameters: WorldParameters, tolerance: float) -> None:
        geometry = DeltaGeometry()
        self._mass = geometry.platform_mass + 1.5 * geometry.rod_mass
        self._servo, self._electrodes, self._magnets = parameters.servo, parameters.contact, parameters.magnets
        self._wall = parameters.target.z
        self._tolerance = tolerance
        self._goal = self._most = 0.0
        self._contact = self._clipped = self._slip = 0
        self._rubs = parameters.servo.friction > 0.0 or parameters.servo.friction_share > 0.0
        self.course = AxisCourse()

    def run(self, start: float, orders: Sequence[Order], duration: float, sample: float) -> AxisCourse:
        count = round(duration / sample) if sample < math.inf else 0
        times = [sample * (index + 1) for index in range(count)]
        state, now = np.array([start, 0.0, 0.0]), 0.0
        self._contact = self._contact_at(start)
        ends = [*(order[0] for order in orders[1:]), duration]
        for (_, self._goal, bound), end in zip(orders, ends, strict=True):
            self._most = min(bound * self._servo.torque_constant, self._servo.stall_torque)
            raw = self._raw(float(state[0]), float(state[1]))
            self._clipped = (raw > self._most) - (raw < -self._most)
            for _ in range(_MOST_PIECES):
                if not now < end:
                    break
                now, state = self._piece(now, state, end, times)
            else:
                raise ArithmeticError(f"{_MOST_PIECES} pieces end at {now} s, before {end} s, at z = {state[0]:.4g} m")
        self.course.left = abs(float(state[1]))
        self.course.force = self._normal(float(state[0]))
        return self.course

    def _piece(self, now: float, state: Any, end: float, times: list[float]) -> tuple[float, Any]:
        """Integrate up to `end` or the next kink, and record samples and the peak."""
        from scipy.integrate import solve_ivp

        events, turn = self._events()
        wanted = [time for time in times if now < time <= end + 1e-12]
        found = solve_ivp(
            self._rates, (now, end), state, "DOP853", dense_output=bool(wanted), events=[turn, *events],
            rtol=self._tolerance, atol=self._tolerance * np.array(_ABSOLUTE), max_step=self._stride(float(state[0])),
        )  # fmt: skip
        if not found.success:
            raise ArithmeticError(f"no step from {found.t[-1]} s, z = {found.y[0, -1]:.4g} m: {found.message}")
        after, state = float(found.t[-1]), found.y[:, -1]
        if not _LOW < state[0] < _HIGH:
            raise ValueError(f"z = {state[0]:.4g} m on the axis is not within {_LOW} to {_HIGH} m")
        while times and times[0] <= after + 1e-12:
            self.course.trace.append(float(found.sol(times.pop(0))[0]))
        deepest = max(float(found.y[0].max()), *(float(each[0]) for each in found.y_events[0]), -math.inf)
        self.course.peak = max(self.course.peak, self._normal(deepest))
        self._go_on(state, [index for index, each in enumerate(found.t_events[1:]) if len(each)])
        return after, state

    def _events(self) -> tuple[list[Event], Event]:
        """Return the events that end the smooth piece, in the order of `_go_on`, and the reversal of the motion."""
        wall, stop = self._wall, self._wall + self._electrodes.hard_stop
        high = self._most - _BEYOND_TORQUE * (self._clipped == 1)
        low = -self._most + _BEYOND_TORQUE * (self._clipped == -1)
        rubs = self._rubs
        turn = _event(lambda _, y: y[1], 0, terminal=False)
        return [
            _event(lambda _, y: y[0] - (wall, wall, stop)[self._contact], -1 if self._contact else 1),
            _event(lambda _, y: y[0] - stop, 1 if self._contact == 1 else 2),
            _event(lambda _, y: self._raw(y[0], y[1]) - high, -1 if self._clipped == 1 else 1),
            _event(lambda _, y: self._raw(y[0], y[1]) - low, 1 if self._clipped == -1 else -1),
            _event(lambda _, y: y[1] if self._slip else y[2] - self._friction(y), self._slip or (1 if rubs else 2)),
            _event(lambda _, y: y[2] + self._friction(y), -1 if rubs and not self._slip else 2),
        ], turn

    def _go_on(self, state: Any, ended: list[int]) -> None:
        """Name the next smooth piece; `ended` flags the events that ended the last one."""
        for which in ended:
            if which == 0:
                if not self._contact and math.isnan(self.course.speed):
                    self.course.speed = float(state[1])
                back = self._contact > 0
                wall = self._wall + (self._electrodes.hard_stop if self._contact == 2 else 0.0)
                self._contact = self._contact - 1 if back else 1
                state[0] = wall - _BEYOND if back else wall + _BEYOND
            elif which == 1:
                self._contact, state[0] = 2, self._wall + self._electrodes.hard_stop + _BEYOND
            elif which in (2, 3):
                side = 1 if which == 2 else -1
                self._clipped = 0 if self._clipped == side else side
            elif which == 4 and self._slip:
                state[2] = self._slip * self._friction(state) * (1.0 - _BEYOND_TORQUE)
                self._slip = 0
            else:
                # A bristle at its upper limit slips while the arm turns back, until it reverses again.
                self._slip = 1 if which == 4 else -1

    def _contact_at(self, z: float) -> int:
        return 0 if z < self._wall else 1 if z < self._wall + self._electrodes.hard_stop else 2

    def _stride(self, z: float) -> float:
        contact = self._electrodes
        stiff = (0.0, 2.0 * contact.stiffness, 2.0 * contact.stiffness + contact.hard_stop_stiffness)[self._contact]
        mass = self._mass + 3.0 * self._servo.inertia * angle(z)[1] ** 2
        return min(_STRIDE, _PHASE * math.sqrt(mass / stiff)) if stiff else _STRIDE

    def _raw(self, z: float, speed: float) -> float:
        """Return the torque of a servo's spring and damper (N·m), before any bound."""
        theta, first, _ = angle(z)
        return self._servo.stiffness * (self._goal - theta) - self._servo.damping * first * speed

    def _motor(self, z: float, speed: float) -> float:
        """Return the torque of a servo (N·m)."""
        return self._clipped * self._most if self._clipped else self._raw(z, speed)

    def _friction(self, state: Any) -> float:
        """Return the torque at which a gear slips (N·m)."""
        return self._servo.friction + self._servo.friction_share * abs(self._motor(state[0], state[1]))

    def _normal(self, z: float) -> float:
        depth, contact = z - self._wall, self._electrodes
        if depth <= 0.0:
            return 0.0
        return 2.0 * contact.stiffness * depth + contact.hard_stop_stiffness * max(depth - contact.hard_stop, 0.0)

    def _rates(self, _: float, state: Any) -> list[float]:
        z, speed, bristle = state.tolist()
        theta, first, second = angle(z)
        servo, contact = self._servo, self._electrodes
        if self._clipped:
            torque = self._clipped * self._most
        else:
            torque = servo.stiffness * (self._goal - theta) - servo.damping * first * speed
        if self._slip:
            bristle = self._slip * (servo.friction + servo.friction_share * abs(torque))
        torque -= servo.viscosity * first * speed
        depth = z - self._wall
        if self._contact:
            force = self._magnets.force - 2.0 * contact.stiffness * depth
            if self._contact == 2:
                force -= contact.hard_stop_stiffness * (depth - contact.hard_stop)
        else:
            ratio = max(1.0 - depth / self._magnets.range, 0.5)  # trial points of a step may lie beyond the wall
            force = self._magnets.force / (ratio * ratio)
        mass = self._mass + 3.0 * servo.inertia * first * first
        force += 3.0 * first * (torque + bristle) - 3.0 * servo.inertia * first * second * speed * speed
        return [speed, force / mass, 0.0 if self._slip or not self._rubs else -GEAR_BRISTLE * first * speed]


def _event(value: Event, direction: int, terminal: bool = True) -> Event:
    """Return an event for scipy that ends the integration if it crosses 0 in a direction; 2 = never."""
    call: Any = value if direction != 2 else lambda _, __: 1.0
    call.direction, call.terminal = (direction if direction != 2 else 0), terminal
    return call  # type: ignore[no-any-return]
