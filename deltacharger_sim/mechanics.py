# SPDX-License-Identifier: Apache-2.0
"""Platform, servos, electrodes and magnets as one implicit step in plain Python floats.

The unknown of a step is the platform's displacement δ (3). Servos are springs and dampers behind a torque limit, τ =
clip(k (reference − θ) − d θ̇, ±limit), with θ = θ₀ + (dθ/dp) δ. Friction of gears and electrodes uses radial return:
an elastic bristle whose force is cut back to the friction limit. It has no smoothing speed and so stays right at any
step. Electrodes are springs with a hard stop; magnets pull across the gap. A damped Newton iteration solves backward
Euler of their balance, m δ̈ = Σ forces, with a tangent from each part. The magnets' negative stiffness counts in the
tangent only while it is less than half of the rest, so that the iteration moves on to the stable side of a snap
instead of diverging.

Within a step the kinematics are linear. A step that would move the platform by more than 5 mm, or that finds no
balance, is halved. At rest nothing is computed: if a step moved nothing and its inputs stay, the next one moves
nothing either.
"""

from __future__ import annotations

import math

from deltacharger_core.machine import NOMINAL_VOLTAGE
from deltacharger_kinematics.geometry import LIMB_DIRECTIONS, DeltaGeometry, Vector
from deltacharger_sim.impact import StepForces, make_impact
from deltacharger_sim.linkage import Linkage
from deltacharger_sim.motion import Motion
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.touch import TargetTouch

GEAR_BRISTLE = 400.0  # N·m/rad; a gear yields 0.15 mrad before it slips
END_STOP = 2000.0  # N·m/rad behind a joint limit
_ITERATIONS = 60
_FULL_STEPS = 20  # later ones are halved: piecewise-linear parts can make full Newton steps oscillate
_SHORTEST = 1e-12**2  # m² of a Newton step, below which the result no longer changes
_LONGEST = 0.004**2  # m², largest move of the platform in one Newton step
_ENOUGH = 1e-5**2  # N² of imbalance that ends the iteration
_ENOUGH_IN_MOTION = 3.0**2  # (N/m)² of imbalance per displacement in a step: 3e-4 of it, as the servos have 1e4 N/m
_FARTHEST = 0.005**2  # m², largest move of the platform in a step; a larger one is halved
_UNSOLVED = 0.01  # N of imbalance above which a step is halved
_FINEST = 0.001  # s, step that is not halved further
_ASIDE = 1e-6  # m, lateral move with no effect on the magnets' pull and the overlap
_REST = 1e-10  # m in a step, below which rest is tried
_REST_ENOUGH = 1e-6**2  # N² of imbalance that permits rest

# Of one joint in a step: the row dθ/dp, spring torque at the start, stiffness of spring and damper, torque limit,
# gear bristle's torque, its friction, angles to the lower and upper joint limit, and torque of weight and inertia.
_Joint = tuple[float, float, float, float, float, float, float, float, float, float, float]
# Imbalance (N) and the positive-definite tangent (N/m): xx, xy, xz, yy, yz, zz.
_Balance = tuple[float, float, float, float, float, float, float, float, float]


class Mechanics(Motion):
    """Three degrees of freedom of the charger against a target.

    Attributes:
        gear: torque of each gear's friction on its arm, N·m.
        rub: lateral friction of the electrodes on the platform, N.
    """

    def __init__(self, parameters: WorldParameters, geometry: DeltaGeometry, start: Vector) -> None:
        super().__init__(parameters, start)
        self._linkage = Linkage(geometry)
        self._geometry = geometry
        self._mass = geometry.platform_mass + 1.5 * geometry.rod_mass
        self._gravity = (parameters.gravity_x, parameters.gravity_y, parameters.gravity_z)
        # Torque of an elbow's weight = first · cos θ − second · sin θ.
        self._elbows = tuple(
            (half * parameters.gravity_z, half * (parameters.gravity_x * cosine + parameters.gravity_y * sine))
            for half, (cosine, sine) in (
                (0.5 * geometry.rod_mass * geometry.limb(index).arm, LIMB_DIRECTIONS[index]) for index in range(3)
            )
        )
        self._touch = TargetTouch(parameters)
        self._impact = make_impact(parameters)
        self._play = 0.5 * parameters.servo.backlash
        here = self._linkage.linearise(*start)
        if here is None:
            raise ValueError(f"start {start!r} is out of the arm's reach: give a point in its workspace (m)")
        self.angles, self._rows, self._turns = here
        self.gear: Vector = (0.0, 0.0, 0.0)
        self.rub: tuple[float, float] = (0.0, 0.0)
        # Rates by the rows at the step's start; the next step's use its own rows. The difference of both contains all
        # of d²θ/dt² = (dθ/dp) a + (d/dt dθ/dp) v; exact rates would lose half of the second term.
        self._spin: Vector = (0.0, 0.0, 0.0)
        self._velocity_before: Vector = (0.0, 0.0, 0.0)
        self._aside = (math.inf, math.inf)
        self._servos: tuple[tuple[float, float, float, float, float], ...] = ()
        self._found: tuple[list[float], list[float], float, float, float, float] = ([], [], 0.0, 0.0, 0.0, 0.0)

    def step(
        self, dt: float, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector, x: float, y: float
    ) -> None:
        """Advance by `dt` s; arguments as of `Motion.step`."""
        inputs = (dt, enabled, reference, limit, x, y)
        if inputs == self._inputs:
            if self.still:
                self.peak_force = self.contact_force
                return
        else:
            self._set_inputs(inputs, dt, enabled, reference, limit, x, y)
        joints = self._joints(dt)
        dx, dy, dz = self._solve(joints, dt)
        if dt > _FINEST and (dx * dx + dy * dy + dz * dz > _FARTHEST or self.imbalance > _UNSOLVED):
            self.step(0.5 * dt, enabled, reference, limit, x, y)
            peak = self.peak_force
            self.step(0.5 * dt, enabled, reference, limit, x, y)
            self.peak_force = max(peak, self.peak_force)
            return
        gap, struck = self._target_z - self.position[2], 0.0
        impact, speed = self._impact, self.velocity[2]
        if (gap < impact.reach or impact.follows) and impact.concerns(gap, speed, dt, self._touch.onset):
            struck = self._strike(joints, gap, dx, dy, dt)
        self._accept(dx, dy, dz, dt)
        self.peak_force = struck if struck > self.contact_force else self.contact_force

    def _strike(self, joints: list[_Joint], gap: float, dx: float, dy: float, dt: float) -> float:
        """Return the largest force (N) of a strike within a step from `gap` (m), with a lateral move dx, dy (m)."""
        damper, momentum = self._parameters.servo.damping / dt, self._inertia * dt
        drives, squares, friction, gear, carried = [], 0.0, 0.0, 0.0, self._mass * self._gravity[2]
        for joint, spin, share, servo in zip(joints, self._spin, self.gains, self._servos, strict=True):
            gx, gy, gz, lead, slope, limit, bristle, rubs, _, _, weight = joint
            squares += gz * gz
            friction += abs(gz) * rubs
            gear += gz * bristle
            carried += gz * (weight - momentum * spin)
            if slope > 0.0:
                yields = 0.5 * servo[0] + damper
                drives.append((gz, lead - yields * (gx * dx + gy * dy), limit, share))
        mass = self._mass + self._parameters.servo.inertia * squares
        x, y = self._aside
        forces = StepForces(drives, GEAR_BRISTLE * squares, friction, carried, mass, x, y)
        return self._impact.step(dt, gap, self.velocity[2], gear, forces, self._found[3] > 0.0)

    @property
    def onset(self) -> float:
        """Gap at which the faces first touch, m."""
        return self._touch.onset

    def servo_push(self) -> float:
        """Return the force (N), Rᵀ τ, of motors and gears on the platform along z, without the arm's weight."""
        push = self._mass * self._gravity[2]
        for row, motor, gear, (cosine, sine), (up, out) in zip(
            self._rows, self.torques, self.gear, self._turns, self._elbows, strict=True
        ):
            push += row[2] * (motor + gear + up * cosine - out * sine)
        return push

    def carry(self, dx: float, dy: float) -> None:
        """Stretch the electrodes' bristle by the target's move (m); the platform's own moves relax it."""
        if self.contact_force > 0.0:
            self.rub = self.rub[0] + self._touch.side * dx, self.rub[1] + self._touch.side * dy

    def _set_inputs(
        self,
        inputs: tuple[object, ...],
        dt: float,
        enabled: tuple[bool, bool, bool],
        reference: Vector,
        limit: Vector,
        x: float,
        y: float,
    ) -> None:
        """Store what stays constant through the iterations and through steps with equal inputs."""
        servo = self._parameters.servo
        known = self._inputs[:4]
        self._inputs = inputs
        aside_x, aside_y = self._aside
        if not (-_ASIDE < x - aside_x < _ASIDE and -_ASIDE < y - aside_y < _ASIDE):
            self._touch.lie(x, y)
            self._aside = (x, y)
        if inputs[:4] == known:
            return
        self._inertia = servo.inertia / (dt * dt)
        self._mass_rate = self._mass / (dt * dt)
        damper, constant, k = servo.damping / dt, servo.torque_constant, servo.stiffness
        self._servos = tuple(
            (k * gain, k * gain + damper, bound * constant, servo.friction, goal)
            if on
            else (0.0, 0.0, 0.0, servo.unpowered_friction, 0.0)
            for on, goal, bound, gain in zip(enabled, reference, limit, self.gains, strict=True)
        )

    def _joints(self, dt: float) -> list[_Joint]:
        servo, geometry = self._parameters.servo, self._geometry
        most = servo.stall_torque
        if servo.stall_sag > 0.0:
            most *= 1.0 - servo.stall_sag * (1.0 - self.voltage / NOMINAL_VOLTAGE)
        momentum, low, high = self._inertia * dt, geometry.joint_min, geometry.joint_max
        joints = []
        parts = (self._rows, self.angles, self._spin, self._turns, self.gear, self._servos, self._elbows)
        for row, angle, spin, (cosine, sine), gear, servo_now, (up, out) in zip(*parts):  # noqa: B905 strict costs
            stiffness, slope, limit, friction, goal = servo_now
            carried = up * cosine - out * sine + momentum * spin
            lead = stiffness * (goal - angle)
            most_now = limit if limit < most else most
            joints.append((*row, lead, slope, most_now, gear, friction, low - angle, high - angle, carried))
        return joints

    def _solve(self, joints: list[_Joint], dt: float) -> Vector:
        """Return the displacement (m) of balanced forces, or the best approximation found."""
        (vx, vy, vz), (before_x, before_y, before_z) = self.velocity, self._velocity_before
        way, square = dt, before_x * before_x + before_y * before_y + before_z * before_z
        if square > 0.0:
            # Servos brake like a first-order lag: each step's displacement is a constant share of the previous one.
            share = (vx * before_x + vy * before_y + vz * before_z) / square
            if 0.0 < share < 1.0:
                way *= share
        dx, dy, dz = vx * way, vy * way, vz * way
        enough = _ENOUGH
        if -_REST < dx < _REST and -_REST < dy < _REST and -_REST < dz < _REST:
            dx = dy = dz = 0.0
            enough = _REST_ENOUGH
        best, least = (dx, dy, dz), math.inf
        for iteration in range(_ITERATIONS):
            fx, fy, fz, xx, xy, xz, yy, yz, zz = self._evaluate(joints, dx, dy, dz, dt)
            size = fx * fx + fy * fy + fz * fz
            if size < least:
                best, least = (dx, dy, dz), size
            if size < enough or size < _ENOUGH_IN_MOTION * (dx * dx + dy * dy + dz * dz):
                break
            enough = _ENOUGH
            # Cholesky's factors of the tangent.
            l21, l31 = xy / xx, xz / xx
            d2 = yy - l21 * xy
            l32 = (yz - l31 * xy) / d2
            y1 = fy - l21 * fx
            cz = (fz - l31 * fx - l32 * y1) / (zz - l31 * xz - l32 * l32 * d2)
            cy = y1 / d2 - l32 * cz
            cx = fx / xx - l21 * cy - l31 * cz
            square = cx * cx + cy * cy + cz * cz
            if not square >= _SHORTEST:
                break
            if iteration >= _FULL_STEPS or square > _LONGEST:
                share = min(0.5 if iteration >= _FULL_STEPS else 1.0, math.sqrt(_LONGEST / square))
                cx, cy, cz = share * cx, share * cy, share * cz
            dx, dy, dz = dx + cx, dy + cy, dz + cz
        if (dx, dy, dz) != best:
            self._evaluate(joints, *best, dt)
        self.imbalance = math.sqrt(least)
        return best

    def _evaluate(self, joints: list[_Joint], dx: float, dy: float, dz: float, dt: float) -> _Balance:
        """Return imbalance (N) and tangent (N/m) at a displacement (m), and store the parts' forces in `_found`."""
        mass, inertia, play = self._mass_rate, self._inertia, self._play
        vx, vy, vz = self.velocity
        gravity_x, gravity_y, gravity_z = self._gravity
        fx = mass * (vx * dt - dx) + self._mass * gravity_x
        fy = mass * (vy * dt - dy) + self._mass * gravity_y
        fz = mass * (vz * dt - dz) + self._mass * gravity_z
        xx = yy = zz = mass
        xy = xz = yz = 0.0
        motors: list[float] = []
        gears: list[float] = []
        for gx, gy, gz, lead, slope, limit, gear, friction, low, high, carried in joints:
            turn = gx * dx + gy * dy + gz * dz
            if play:
                lead, slope = self._through_play(lead, slope, turn, self._servos[len(motors)][0])
            drive = lead - slope * turn
            stiffness = inertia
            if drive > limit:
                drive = limit
            elif drive < -limit:
                drive = -limit
            else:
                stiffness += slope
            gear -= GEAR_BRISTLE * turn
            if gear > friction:
                gear = friction
            elif gear < -friction:
                gear = -friction
            else:
                stiffness += GEAR_BRISTLE
            torque = drive + gear + carried - inertia * turn
            if turn < low:
                torque += END_STOP * (low - turn)
                stiffness += END_STOP
            elif turn > high:
                torque += END_STOP * (high - turn)
                stiffness += END_STOP
            motors.append(drive)
            gears.append(gear)
            fx += gx * torque
            fy += gy * torque
            fz += gz * torque
            sx, sy = stiffness * gx, stiffness * gy
            xx += sx * gx
            xy += sx * gy
            xz += sx * gz
            yy += sy * gy
            yz += sy * gz
            zz += stiffness * gz * gz
        magnet = normal = rx = ry = side = 0.0
        gap = self._target_z - self.position[2] - dz
        if gap < math.inf:
            magnet, normal, rx, ry, side, along = self._touch.forces(gap, dx, dy, self.rub, zz)
            fx, fy, fz = fx + rx, fy + ry, fz + magnet - normal
            zz += along
        self._found = motors, gears, magnet, normal, rx, ry
        return fx, fy, fz, xx + side, xy, xz, yy + side, yz, zz

    def _through_play(self, lead: float, slope: float, turn: float, stiffness: float) -> tuple[float, float]:
        """Return spring torque and slope with play: within it only the damper acts on the arm."""
        if slope == 0.0:
            return lead, slope
        error, play = lead - stiffness * turn, stiffness * self._play
        if abs(error) < play:
            return 0.0, slope - stiffness
        return lead - math.copysign(play, error), slope

    def _accept(self, dx: float, dy: float, dz: float, dt: float) -> None:
        """Apply the displacement (m), or as much of it as the arm reaches."""
        before, angles, (first, second, third) = self.position, self.angles, self._rows
        at_rest = self.velocity == self.rates == (0.0, 0.0, 0.0)
        share = 1.0
        while True:
            moved = (share * dx, share * dy, share * dz)
            self.position = (before[0] + moved[0], before[1] + moved[1], before[2] + moved[2])
            here = self._linkage.linearise(*self.position)
            if here is not None:
                self.angles, self._rows, self._turns = here
                break
            share = 0.5 * share if share > 1e-6 else 0.0
        self._velocity_before = self.velocity
        self.velocity = (moved[0] / dt, moved[1] / dt, moved[2] / dt)
        vx, vy, vz = self.velocity
        self._spin = (
            first[0] * vx + first[1] * vy + first[2] * vz,
            second[0] * vx + second[1] * vy + second[2] * vz,
            third[0] * vx + third[1] * vy + third[2] * vz,
        )
        now = self.angles
        self.rates = ((now[0] - angles[0]) / dt, (now[1] - angles[1]) / dt, (now[2] - angles[2]) / dt)
        self.still = at_rest and moved == (0.0, 0.0, 0.0)
        motors, gears, self.magnet_force, self.contact_force, rx, ry = self._found
        self.torques = (motors[0], motors[1], motors[2])
        self.gear = (gears[0], gears[1], gears[2])
        self.rub = (rx, ry)
        if self._play:
            self._take_up_play()
        if (tilt := self._touch.tilt) is not None:
            self.tilt, self._bars = tilt.keep()

    def _take_up_play(self) -> None:
        """Let each powered encoder run ahead of its arm toward its goal, within the play."""
        play, ahead = self._play, list(self.slack)
        for index, (drive, angle) in enumerate(zip(self._servos, self.angles, strict=True)):
            if drive[0] > 0.0:
                ahead[index] = max(-play, min(play, drive[4] - angle))
        self.slack = (ahead[0], ahead[1], ahead[2])
