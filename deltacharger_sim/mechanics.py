# SPDX-License-Identifier: Apache-2.0
"""Platform, servos, electrodes and magnets as one implicit step in plain Python floats.

The unknown of a step is the platform's displacement δ (3). A servo in mode 5 gives a current, so its torque is Kt I =
clip(k (reference − θ) − d θ̇, ±limit), with θ = θ₀ + (dθ/dp) δ: k by its P gain, d by its D gain, and no back-EMF. Its
gear adds viscosity and a friction that grows with the torque. Friction of gears, cable and electrodes uses radial
return: an elastic bristle whose force is cut back to the friction limit. It has no smoothing speed and so stays right
at any step. Electrodes are springs with a hard stop; magnets pull across the gap and toward the target's centre. A
damped Newton iteration solves the balance m δ̈ = Σ forces with a tangent from each part. The magnets' negative
stiffness counts in the tangent only while it is less than half of the rest, so that the iteration moves on to the
stable side of a snap instead of diverging.

In free air the step is the midpoint rule, which neither brakes nor drives an arm that swings. In contact it is backward
Euler, which takes up a blow. Within a step the kinematics are linear. A step that would move the platform by more than
5 mm, or that finds no balance, is halved. At rest nothing is computed: if a step moved nothing and its inputs stay, the
next one moves nothing either.

Inverse kinematics and its gradient from one pass over the limbs, for a step of mechanics.
With u, v, w the elbow-free coordinates of a limb (see `deltacharger_kinematics.delta`), a its arm, K = u² + v² + w² +
a² − L² and Q = 4a²(u² + w²) − K², one arc tangent gives the angle, and its gradient is dθ = −2 [(u − a
cos θ) du + v dv + (w − a sin θ) dw] / (σ√Q). No matrix is inverted, so it stays finite if the rods lie in one
plane. Near the edge of a limb's reach, where √Q loses its digits, `ScalarDelta` is used.

What gives way around the arm: the cable at the platform, and the two robots on their wheels.
Both use radial return, as the gears' friction does: a spring whose force is cut back to what its friction holds.
"""

import math
from math import atan2, cos, sin, sqrt

from deltacharger_core.machine import GRAVITY_STRENGTH
from deltacharger_kinematics.geometry import LIMB_COUNT, LIMB_DIRECTIONS, DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim import motion, touch
from deltacharger_sim.impact import StepForces, make_impact
from deltacharger_sim.parameters import CableParameters, StandParameters, WorldParameters

Rows = tuple[Vector, Vector, Vector]
Turns = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

_PLAIN = 1e-4  # √Q relative to its largest value; below it, an angle from plain doubles is worse than 1e-11 rad
_STEEPEST = 1e-3  # as above; bounds the gradient, so that a step at the edge of reach stays finite


class Linkage:
    """Inverse kinematics with its gradient, in ``charger_base`` (m, rad)."""

    def __init__(self, geometry: DeltaGeometry) -> None:
        self._edge = ScalarDelta(geometry)
        numbers = []
        for index in range(LIMB_COUNT):
            limb = geometry.limb(index)
            numbers.append(
                (
                    *(limb.cosine, limb.sine, limb.difference, limb.tangential_offset, limb.motor_height),
                    *(4.0 * limb.arm**2, limb.arm**2 - limb.rod**2, 2.0 * limb.arm * limb.rod),
                    *(limb.angle_offset, 1.0 / limb.arm),
                )
            )
        self._limbs = tuple(numbers)

    def linearise(self, x: float, y: float, z: float) -> tuple[Vector, Rows, Turns] | None:
        """Return angles and gradient for a position of the platform (m).

        Returns:
            The commanded angles (rad), the rows dθ/dp (rad/m), and cosine and sine of each arm's true angle; None if
            a limb does not reach it.
        """
        angles, rows, turns = [], [], []
        for cosine, sine, difference, tangential, height, four, constant, size, zero, per_arm in self._limbs:
            u = x * cosine + y * sine - difference
            v = y * cosine - x * sine - tangential
            w = z + height
            reach = u * u + w * w
            k = reach + v * v + constant
            q = four * reach - k * k
            root = sqrt(q) if q > 0.0 else 0.0
            if not root > _PLAIN * size:
                return self._at_the_edge(x, y, z)
            root = -root
            sine_part = k * w + root * u
            cosine_part = k * u - root * w
            angles.append(atan2(sine_part, cosine_part) - zero)
            half, scale = 0.5 / reach, -2.0 / root
            elbow_u, elbow_w = cosine_part * half, sine_part * half
            gu = scale * (u - elbow_u)
            gv = scale * v
            rows.append((gu * cosine - gv * sine, gu * sine + gv * cosine, scale * (w - elbow_w)))
            turns.append((elbow_u * per_arm, elbow_w * per_arm))
        return (angles[0], angles[1], angles[2]), (rows[0], rows[1], rows[2]), (turns[0], turns[1], turns[2])

    def _at_the_edge(self, x: float, y: float, z: float) -> tuple[Vector, Rows, Turns] | None:
        """As `linearise`, near the edge of reach: exact angles and a bounded gradient."""
        angles = self._edge.inverse(x, y, z)
        if angles[0] != angles[0]:
            return None
        rows, turns = [], []
        for angle, limb in zip(angles, self._limbs, strict=True):
            cosine, sine, difference, tangential, height, four, constant, size, zero, _ = limb
            u = x * cosine + y * sine - difference
            v = y * cosine - x * sine - tangential
            w = z + height
            reach = u * u + w * w
            if reach == 0.0:
                return None
            k = reach + v * v + constant
            root = -max(sqrt(max(four * reach - k * k, 0.0)), _STEEPEST * size)
            half, scale = 0.5 / reach, -2.0 / root
            gu, gv = scale * (u - (k * u - root * w) * half), scale * v
            gz = scale * (w - (k * w + root * u) * half)
            rows.append((gu * cosine - gv * sine, gu * sine + gv * cosine, gz))
            turns.append((cos(angle + zero), sin(angle + zero)))
        return angles, (rows[0], rows[1], rows[2]), (turns[0], turns[1], turns[2])


_SETTLES = 0.002  # m of the platform over which a cable's friction builds up (assumed)
_ROLLING = 0.012  # rolling resistance over weight of rubber wheels on a hard floor: 0.008 to 0.015
_TYRES = 0.1  # damping ratio of a braked robot on its tyres (assumed)
_REST = 1e-10  # m in a step, below which rest is tried


class Cable:
    """A cable that pulls the platform back to where it started, and drags.

    Args:
        parameters: of the cable.
        start: of the platform, m, charger_base.
    """

    def __init__(self, parameters: CableParameters, start: Vector) -> None:
        self._stiffness, self._drag, self._start = parameters.stiffness, parameters.drag, start
        self._bristle = self._drag / _SETTLES  # N/m
        self._force: Vector = (0.0, 0.0, 0.0)  # N of its friction
        self._found = self._force

    def forces(self, position: Vector, dx: float, dy: float, dz: float) -> tuple[Vector, float]:
        """Return the force (N) on a platform that moves from `position` by (dx, dy, dz) m, and its stiffness (N/m)."""
        bristle, k = self._bristle, self._stiffness
        fx, fy, fz = self._force
        rx, ry, rz = fx - bristle * dx, fy - bristle * dy, fz - bristle * dz
        size, stiff = math.sqrt(rx * rx + ry * ry + rz * rz), bristle
        if size > self._drag:
            share = self._drag / size
            rx, ry, rz, stiff = share * rx, share * ry, share * rz, share * bristle
        self._found = rx, ry, rz
        (x, y, z), (x0, y0, z0) = position, self._start
        return (rx - k * (x + dx - x0), ry - k * (y + dy - y0), rz - k * (z + dz - z0)), k + stiff

    def keep(self) -> None:
        """End the step with the last forces."""
        self._force = self._found


class Stand:
    """How far both robots together yield: their reduced mass on tyres, with play, on brakes that may slip.

    Along z they move and roll; sideways only the tyres yield, at once.

    Attributes:
        move: displacement of the target in this step along z, m.
    """

    def __init__(self, parameters: StandParameters) -> None:
        self._stiffness, self._mass, self._play = parameters.stiffness, parameters.mass, parameters.play
        self._rolling = _ROLLING * parameters.mass * GRAVITY_STRENGTH
        self._damping = 2.0 * _TYRES * math.sqrt(parameters.stiffness * parameters.mass)
        self.set_brakes(parameters.brakes)
        self._place = self._speed = self._stretch = self._roll = self.move = 0.0
        self._dt = 1.0

    def set_brakes(self, force: float) -> None:
        """Let the brakes slip from this force on, N."""
        self._brakes = force
        self._farthest = self._play + force / self._stiffness  # m of the body from its braked wheels

    def begin_step(self, dt: float) -> float:
        """Begin a step of `dt` s and return its first guess of `move`."""
        way = self._speed * dt
        self._dt, self.move = dt, way if not -_REST < way < _REST else 0.0
        return self.move

    def forces(self, push: float) -> tuple[float, float]:
        """Return the imbalance (N) at `move` under a push (N) along +z, and its tangent (N/m)."""
        dt, move, k = self._dt, self.move, self._stiffness
        rate = self._mass / (dt * dt)
        stretch, tangent = self._stretch + move, rate
        beyond = stretch - min(max(stretch, -self._play), self._play)
        held, rolls = k * beyond, self._roll + k * move
        if held > self._brakes or held < -self._brakes:
            held = math.copysign(self._brakes, held)
        elif beyond:
            held, tangent = held + self._damping / dt * move, tangent + k + self._damping / dt
        if rolls > self._rolling or rolls < -self._rolling:
            rolls = math.copysign(self._rolling, rolls)
        else:
            tangent += k
        return push + rate * (self._speed * dt - move) - held - rolls, tangent

    def keep(self, dt: float) -> bool:
        """End a step of `dt` s; return whether nothing moved."""
        still = self._speed == self.move == 0.0
        self._speed = self.move / dt
        self._place += self.move
        self._stretch = min(max(self._stretch + self.move, -self._farthest), self._farthest)
        self._roll = min(max(self._roll + self._stiffness * self.move, -self._rolling), self._rolling)
        self.move = 0.0
        return still

    def shift(self, rub: tuple[float, float]) -> Vector:
        """Return the target's displacement (m) along x, y and z; `rub` (N) is its friction on the platform."""
        return -rub[0] / self._stiffness, -rub[1] / self._stiffness, self._place


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
_REST_ENOUGH = 1e-6**2  # N² of imbalance that permits rest
_MIDPOINT, _END = 0.5, 1.0  # share of a step at which its forces hold: midpoint rule, backward Euler

# Of one joint in a step: the row dθ/dp, spring torque at the start, stiffness of spring and damper, torque limit,
# gear bristle's torque, its friction without load, angles to the lower and upper joint limit, and torque of weight and
# inertia.
_Joint = tuple[float, float, float, float, float, float, float, float, float, float, float]
# Imbalance (N) and the positive-definite tangent (N/m): xx, xy, xz, yy, yz, zz.
_Balance = tuple[float, float, float, float, float, float, float, float, float]


class Mechanics(motion.Motion):
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
        self._touch = touch.TargetTouch(parameters)
        self._impact = make_impact(parameters)
        self._play = 0.5 * parameters.servo.backlash
        self._cable = Cable(parameters.cable, start) if parameters.cable.acts else None
        self._stand = Stand(parameters.stand) if parameters.stand.stiffness > 0.0 else None
        here = self._linkage.linearise(*start)
        if here is None:
            raise ValueError(f"start {start!r} is out of the arm's reach: give a point in its workspace (m)")
        self.angles, self._rows, self._turns = here
        self.gear: Vector = (0.0, 0.0, 0.0)
        self.rub: tuple[float, float] = (0.0, 0.0)
        # Rates at the step's end by the rows at its start; the next step's use its own rows. The difference of both
        # contains all of d²θ/dt² = (dθ/dp) a + (d/dt dθ/dp) v; exact rates would lose a part of the second term.
        self._spin: Vector = (0.0, 0.0, 0.0)
        self._velocity_before: Vector = (0.0, 0.0, 0.0)
        self._aside = (math.inf, math.inf)
        self._servos: tuple[tuple[float, float, float, float, float], ...] = ()
        self._at = _MIDPOINT  # share of the step at which its forces hold
        self._yields = (0.0, 0.0, 1.0)  # N of the target's imbalance, N/m of the contact's tangent and of both together
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
        self._at = _END if self.contact_force > 0.0 else _MIDPOINT
        joints = self._joints(dt)
        dx, dy, dz = self._solve(joints, dt)
        if self._at < _END and self._found[3] > 0.0:
            self._at = _END
            joints = self._joints(dt)
            dx, dy, dz = self._solve(joints, dt)
        if dt > _FINEST and (dx * dx + dy * dy + dz * dz > _FARTHEST or self.imbalance > _UNSOLVED):
            self.step(0.5 * dt, enabled, reference, limit, x, y)
            peak = self.peak_force
            self.step(0.5 * dt, enabled, reference, limit, x, y)
            self.peak_force = max(peak, self.peak_force)
            return
        gap, struck = self.gap, 0.0
        impact, speed = self._impact, self.velocity[2]
        if (gap < impact.reach or impact.follows) and impact.concerns(gap, speed, dt, self._touch.onset):
            struck = self._strike(joints, gap, dx, dy, dt)
        self._accept(joints, dx, dy, dz, dt)
        self.peak_force = struck if struck > self.contact_force else self.contact_force

    def _strike(self, joints: list[_Joint], gap: float, dx: float, dy: float, dt: float) -> float:
        """Return the largest force (N) of a strike within a step from `gap` (m), with a lateral move dx, dy (m)."""
        servo, momentum = self._parameters.servo, self._inertia * dt
        drives, squares, friction, gear, carried = [], 0.0, 0.0, 0.0, self._mass * self._gravity[2]
        for joint, spin, share, (spring, damper, _, _, _) in zip(
            joints, self._spin, self.gains, self._servos, strict=True
        ):
            gx, gy, gz, lead, slope, limit, bristle, rubs, _, _, weight = joint
            squares += gz * gz
            friction += abs(gz) * (rubs + servo.friction_share * min(abs(lead), limit))
            gear += gz * bristle
            carried += gz * (weight - momentum * spin)
            if slope > 0.0:
                yields = 0.5 * spring + damper
                drives.append((gz, lead - yields * (gx * dx + gy * dy), limit, share))
        mass = self._mass + servo.inertia * squares
        x, y = self._aside
        drag = servo.viscosity * squares
        forces = StepForces(drives, GEAR_BRISTLE * squares, friction, drag, carried, mass, x, y)
        return self._impact.step(dt, gap, self.velocity[2], gear, forces, self._found[3] > 0.0)

    def set_brakes(self, force: float) -> None:
        """Set the force (N) at which the brakes of a target on wheels slip; others stand."""
        if self._stand is not None:
            self._stand.set_brakes(force)
            self._inputs, self.still = (), False

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

    def push_of(self, torque: float) -> float:
        """Return the force (N) on the platform along z of `torque` N·m in each servo."""
        (_, _, a), (_, _, b), (_, _, c) = self._rows
        return torque * (a + b + c)

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
        damper, constant, k = servo.damping / dt, servo.torque_constant, servo.stiffness
        self._servos = tuple(
            (k * gain, damper * braking, bound * constant, rubs, goal)
            if on
            else (0.0, 0.0, 0.0, servo.unpowered_friction, 0.0)
            for on, goal, bound, gain, braking, rubs in zip(
                enabled, reference, limit, self.gains, self.brakes, self.rubs, strict=True
            )
        )

    def _joints(self, dt: float) -> list[_Joint]:
        servo, geometry, at = self._parameters.servo, self._geometry, self._at
        most = servo.stall_torque
        square = at * dt * dt
        self._inertia, self._mass_rate = servo.inertia / square, self._mass / square
        self._drag = servo.viscosity / dt
        momentum, low, high = self._inertia * dt, geometry.joint_min, geometry.joint_max
        joints = []
        parts = (self._rows, self.angles, self._spin, self._turns, self.gear, self._servos, self._elbows)
        for row, angle, spin, (cosine, sine), gear, servo_now, (up, out) in zip(*parts):  # noqa: B905 strict costs
            stiffness, damper, limit, friction, goal = servo_now
            carried = up * cosine - out * sine + momentum * spin
            lead = stiffness * (goal - angle)
            most_now = limit if limit < most else most
            slope = at * stiffness + damper
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
        best, least, moved, best_move = (dx, dy, dz), math.inf, 0.0, 0.0
        if self._stand is not None:
            moved = best_move = self._stand.begin_step(dt)
        for iteration in range(_ITERATIONS):
            fx, fy, fz, xx, xy, xz, yy, yz, zz = self._evaluate(joints, dx, dy, dz, dt)
            size = fx * fx + fy * fy + fz * fz
            if self._stand is not None:
                size += self._yields[0] ** 2
                moved = self._stand.move
            if size < least:
                best, least, best_move = (dx, dy, dz), size, moved
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
            share, full = 1.0, cz
            if iteration >= _FULL_STEPS or square > _LONGEST:
                share = min(0.5 if iteration >= _FULL_STEPS else 1.0, math.sqrt(_LONGEST / square))
                cx, cy, cz = share * cx, share * cy, share * cz
            dx, dy, dz = dx + cx, dy + cy, dz + cz
            if self._stand is not None:
                left, coupled, stiff = self._yields
                self._stand.move += share * (left + coupled * full) / stiff
        if (dx, dy, dz) != best:
            if self._stand is not None:
                self._stand.move = best_move
            self._evaluate(joints, *best, dt)
        self.imbalance = math.sqrt(least)
        return best

    def _evaluate(self, joints: list[_Joint], dx: float, dy: float, dz: float, dt: float) -> _Balance:
        """Return imbalance (N) and tangent (N/m) at a displacement (m), and store the parts' forces in `_found`."""
        mass, play, braked, at = self._mass_rate, self._play, self._inertia + self._drag, self._at
        share = self._parameters.servo.friction_share
        vx, vy, vz = self.velocity
        gravity_x, gravity_y, gravity_z = self._gravity
        fx = mass * (vx * dt - dx) + self._mass * gravity_x
        fy = mass * (vy * dt - dy) + self._mass * gravity_y
        fz = mass * (vz * dt - dz) + self._mass * gravity_z
        xx = yy = zz = mass
        if self._cable is not None:
            (px, py, pz), stiff = self._cable.forces(self.position, dx, dy, dz)
            fx, fy, fz = fx + px, fy + py, fz + pz
            xx = yy = zz = mass + stiff
        xy = xz = yz = 0.0
        motors: list[float] = []
        gears: list[float] = []
        for gx, gy, gz, lead, slope, limit, gear, friction, low, high, carried in joints:
            turn = gx * dx + gy * dy + gz * dz
            if play and slope != 0.0:  # within the play only the damper acts on the arm
                sprung = at * self._servos[len(motors)][0]
                error, most = lead - sprung * turn, sprung / at * play
                if -most < error < most:
                    lead, slope = 0.0, slope - sprung
                else:
                    lead -= most if error > 0.0 else -most
            drive = lead - slope * turn
            stiffness = braked
            sprung = slope
            if drive > limit:
                drive, sprung = limit, 0.0
            elif drive < -limit:
                drive, sprung = -limit, 0.0
            rubs = friction + share * (drive if drive > 0.0 else -drive)
            gear -= GEAR_BRISTLE * turn
            if gear > rubs:
                gear = rubs
                stiffness += sprung * (1.0 + share if drive > 0.0 else 1.0 - share)
            elif gear < -rubs:
                gear = -rubs
                stiffness += sprung * (1.0 - share if drive > 0.0 else 1.0 + share)
            else:
                stiffness += sprung + GEAR_BRISTLE
            torque = drive + gear + carried - braked * turn
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
        gap, stand = self.gap - dz, self._stand
        if gap < math.inf:
            if stand is not None:
                gap += stand.move
            magnet, normal, rx, ry, side, along, aligns = self._touch.forces(gap, dx, dy, self.rub, zz)
            x, y = self._aside
            fx, fy, fz = fx + rx + aligns * (x - dx), fy + ry + aligns * (y - dy), fz + magnet - normal
            side += aligns
            if stand is None:
                zz += along
            else:  # eliminates the target's own displacement
                left, stiff = stand.forces(normal - magnet)
                if along < -0.5 * stiff:
                    along = 0.0
                self._yields = left, along, stiff + along
                passed = along / (stiff + along)
                fz += passed * left
                zz += along * (1.0 - passed)
        self._found = motors, gears, magnet, normal, rx, ry
        return fx, fy, fz, xx + side, xy, xz, yy + side, yz, zz

    def _accept(self, joints: list[_Joint], dx: float, dy: float, dz: float, dt: float) -> None:
        """Apply the displacement (m), or as much of it as the arm reaches."""
        before, before_rows = self.position, self._rows
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
        self._velocity_before, at = self.velocity, self._at
        if moved == (0.0, 0.0, 0.0):
            self.velocity = moved
        else:
            (vx, vy, vz), (mx, my, mz) = self.velocity, moved
            self.velocity = vx + (mx / dt - vx) / at, vy + (my / dt - vy) / at, vz + (mz / dt - vz) / at
        self._spin = self._turning(before_rows)
        self.rates = rates = self._turning(self._rows)
        if at < _END:  # the rows change by half as much up to the middle of the step
            (a, b, c), (d, e, f) = self._spin, rates
            self._spin = 0.5 * (a + d), 0.5 * (b + e), 0.5 * (c + f)
        stood = self._stand is None or self._stand.keep(dt)
        self.still = at_rest and moved == (0.0, 0.0, 0.0) and stood
        motors, gears, self.magnet_force, self.contact_force, rx, ry = self._found
        if at < _END:
            motors = [self._motor(index, joint[5], dt) for index, joint in enumerate(joints)]
        a, b, c = motors
        self.torques = (a, b, c)
        self.gear = (gears[0], gears[1], gears[2])
        self.rub = (rx, ry)
        if self._cable is not None:
            self._cable.keep()
        if self._stand is not None:
            self._shift = self._stand.shift(self.rub)
        if self._play:
            self._take_up_play()
        if (tilt := self._touch.tilt) is not None:
            self.tilt, self._bars = tilt.keep()

    def _motor(self, index: int, limit: float, dt: float) -> float:
        """Return a motor's torque (N·m) at the step's end, as its servo reports it with that angle and rate."""
        stiffness, damper, _, _, goal = self._servos[index]
        error, play = goal - self.angles[index], self._play
        error -= min(max(error, -play), play)
        return min(max(stiffness * error - damper * dt * self.rates[index], -limit), limit)

    def _turning(self, rows: Rows) -> Vector:
        """Return the arms' rates (rad/s) by these rows."""
        (a, b, c), (d, e, f), (g, h, i) = rows
        x, y, z = self.velocity
        return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z

    def _take_up_play(self) -> None:
        """Let each powered encoder run ahead of its arm toward its goal, within the play."""
        play, ahead = self._play, list(self.slack)
        for index, ((spring, _, _, _, goal), angle) in enumerate(zip(self._servos, self.angles)):  # noqa: B905
            if spring > 0.0:
                lag = goal - angle
                ahead[index] = -play if lag < -play else play if lag > play else lag
        self.slack = (ahead[0], ahead[1], ahead[2])
