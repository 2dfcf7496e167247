"""Platform, servos, electrodes and magnets as one implicit step in plain Python floats.

The unknown of a step is the platform's displacement δ (3). Servos are springs and dampers behind a torque limit,
τ = clip(k (reference − θ) − d θ̇, ±limit), with θ = θ₀ + J⁻¹δ; gears and electrodes rub by radial return (an elastic
bristle whose force is cut back to the friction limit), which has no smoothing speed and so stays right at any step;
electrodes are springs with a hard stop; magnets pull across the gap. Backward Euler on their balance,
m δ̈ = Σ forces, is solved by a damped Newton iteration, each part giving its own tangent. The magnets' negative
stiffness is left out of the tangent, so that the iteration moves on to the stable side of a snap instead of diverging.
"""

from __future__ import annotations

import math

from deltacharger_kinematics.geometry import LIMB_DIRECTIONS, DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.magnets import pull
from deltacharger_sim.parameters import WorldParameters

_GEAR_BRISTLE = 400.0  # N·m/rad; a gear yields 0.15 mrad before it slips
_LATERAL_MOST = 1e6  # N/m; stiffer bristles would give less than 20 µm and only make stick and slip hard to solve
_END_STOP = 2000.0  # N·m/rad behind a joint limit
_ITERATIONS = 60
_TOLERANCE = 1e-9  # m of displacement
_LONGEST = 0.004  # m that one Newton step may move the platform
_FORCE_LIMIT = 1e-5  # N of imbalance that ends the iteration

Symmetric = tuple[float, float, float, float, float, float]


class Mechanics:
    """Three degrees of freedom of the charger against a target.

    Attributes:
        position: of the platform, m, charger_base.
        velocity: m/s.
        angles: of the arms, rad.
        rates: rad/s.
        torques: of the motors, N·m, before gear friction.
        slack: how far play lets each encoder run ahead of its arm, rad.
        contact_force: normal force on the electrodes together, N.
        imbalance: what the last step's solution left unbalanced, N; small unless the step is long and friction slips.
        gap: distance of the touched faces, m; negative = compression of the springs; inf without a target.
    """

    def __init__(self, parameters: WorldParameters, geometry: DeltaGeometry, start: Vector) -> None:
        self._parameters = parameters
        self._kinematics = ScalarDelta(geometry)
        self._geometry = geometry
        self._mass = geometry.platform_mass + 1.5 * geometry.rod_mass
        self._gravity = (parameters.gravity_x, parameters.gravity_y, parameters.gravity_z)
        self.position: Vector = start
        self.velocity: Vector = (0.0, 0.0, 0.0)
        self.angles: Vector = self._kinematics.inverse(*start)
        self.rates: Vector = (0.0, 0.0, 0.0)
        self.torques: Vector = (0.0, 0.0, 0.0)
        self.slack: Vector = (0.0, 0.0, 0.0)
        self.contact_force = 0.0
        self.magnet_force = 0.0
        self.imbalance = 0.0
        self._gear = [0.0, 0.0, 0.0]
        self._rub = [0.0, 0.0]

    @property
    def gap(self) -> float:
        """Distance between the touched faces (m); negative = springs compressed."""
        target = self._parameters.target
        return target.z - self.position[2] if target.present else math.inf

    def step(
        self, dt: float, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector, offset: float
    ) -> None:
        """Advance by `dt` s.

        Args:
            dt: s.
            enabled: whether each servo's torque is on.
            reference: goal angle of each servo, rad.
            limit: current bound of each servo, A.
            offset: lateral distance of the terminals' centres, m; it weakens the magnets.
        """
        balance = _Balance(self, dt, enabled, reference, limit, offset)
        displacement = balance.solve()
        self._accept(displacement, dt, balance)

    def _accept(self, displacement: list[float], dt: float, balance: _Balance) -> None:
        scale = 1.0
        while True:
            x, y, z = (p + scale * d for p, d in zip(self.position, displacement, strict=True))
            angles = self._kinematics.inverse(x, y, z)
            if angles[0] == angles[0]:
                break
            scale *= 0.5
            if scale < 1e-6:
                x, y, z = self.position
                angles = self.angles
                break
        moved = (x - self.position[0], y - self.position[1], z - self.position[2])
        self.velocity = (moved[0] / dt, moved[1] / dt, moved[2] / dt)
        self.rates = (
            (angles[0] - self.angles[0]) / dt,
            (angles[1] - self.angles[1]) / dt,
            (angles[2] - self.angles[2]) / dt,
        )
        self.position = (x, y, z)
        self.angles = angles
        self.torques = balance.motor
        if balance.play > 0.0:
            self.slack = balance.slack(angles)
        self._gear = balance.gear
        self._rub = balance.rub
        self.contact_force = balance.normal
        self.magnet_force = balance.magnet
        self.imbalance = balance.imbalance


class _Balance:
    """Forces of one step as functions of the displacement, with their tangents."""

    def __init__(
        self,
        state: Mechanics,
        dt: float,
        enabled: tuple[bool, bool, bool],
        reference: Vector,
        limit: Vector,
        offset: float,
    ) -> None:
        parameters = state._parameters
        servo = parameters.servo
        self._dt = dt
        self._contact = parameters.contact
        self._magnets = parameters.magnets
        self._offset = offset
        self._state = state
        self._gap = state.gap
        self._gravity = state._gravity
        self._inverse = _inverse(state._kinematics.jacobian(*state.position))
        self.play = 0.5 * servo.backlash
        self._reference = reference
        self._stiffness = servo.stiffness
        self._damping = servo.damping / dt
        self._inertia = servo.inertia / (dt * dt)
        self._limits = [min(bound * servo.torque_constant, servo.stall_torque) for bound in limit]
        self._enabled = enabled
        self._lead = [goal - angle for goal, angle in zip(reference, state.angles, strict=True)]
        self._friction = [servo.friction if on else servo.unpowered_friction for on in enabled]
        self._carried = self._carried_torque()
        self.motor: Vector = (0.0, 0.0, 0.0)
        self.gear = list(state._gear)
        self.rub = list(state._rub)
        self.normal = 0.0
        self.magnet = 0.0
        self.imbalance = 0.0

    def solve(self) -> list[float]:
        """Return the displacement (m) at which the forces balance, or the best found."""
        dt, velocity = self._dt, self._state.velocity
        guess = [value * dt for value in velocity]
        best, best_force = list(guess), math.inf
        for iteration in range(_ITERATIONS):
            force, tangent = self._evaluate(guess)
            size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
            if size < best_force:
                best, best_force = list(guess), size
            if size < _FORCE_LIMIT:
                break
            change = _solve(tangent, force)
            length = math.sqrt(change[0] ** 2 + change[1] ** 2 + change[2] ** 2)
            if length < _TOLERANCE * 1e-3:
                break
            # Late iterations are halved: piecewise-linear parts can make full Newton steps go back and forth.
            damping = 1.0 if iteration < 20 else 0.5
            damping = min(damping, _LONGEST / length) if length > 0.0 else damping
            guess = [g + damping * c for g, c in zip(guess, change, strict=True)]
        self._evaluate(best)
        self.imbalance = best_force
        return best

    def slack(self, angles: Vector) -> Vector:
        """Return how far each encoder is ahead of its arm (rad): toward its goal, as far as the play allows."""
        ahead = list(self._state.slack)
        for index, angle in enumerate(angles):
            if self._enabled[index]:
                ahead[index] = max(-self.play, min(self.play, self._reference[index] - angle))
        return ahead[0], ahead[1], ahead[2]

    def _evaluate(self, d: list[float]) -> tuple[list[float], Symmetric]:
        """Return the imbalance (N) at displacement `d` (m) and the positive-definite tangent (N/m)."""
        state, dt, inverse = self._state, self._dt, self._inverse
        mass = state._mass / (dt * dt)
        velocity, gravity = state.velocity, self._gravity
        fx = -mass * (d[0] - velocity[0] * dt) + state._mass * gravity[0]
        fy = -mass * (d[1] - velocity[1] * dt) + state._mass * gravity[1]
        fz = -mass * (d[2] - velocity[2] * dt) + state._mass * gravity[2]
        xx = yy = zz = mass
        xy = xz = yz = 0.0
        motor = []
        for index in range(3):
            gx, gy, gz = inverse[index]
            turn = gx * d[0] + gy * d[1] + gz * d[2]
            torque, stiffness, drive = self._joint(index, turn)
            motor.append(drive)
            fx += gx * torque
            fy += gy * torque
            fz += gz * torque
            xx += stiffness * gx * gx
            yy += stiffness * gy * gy
            zz += stiffness * gz * gz
            xy += stiffness * gx * gy
            xz += stiffness * gx * gz
            yz += stiffness * gy * gz
        self.motor = (motor[0], motor[1], motor[2])
        fx, fy, fz, side, along = self._touch(d, fx, fy, fz)
        return [fx, fy, fz], (xx + side, xy, xz, yy + side, yz, zz + along)

    def _joint(self, index: int, turn: float) -> tuple[float, float, float]:
        """Return torque on the arm, its tangent (N·m/rad) and the motor's share, for a turn (rad) in this step."""
        state = self._state
        drive, tangent = 0.0, 0.0
        if self._enabled[index]:
            limit = self._limits[index]
            error, slope = self._lead[index] - turn, self._stiffness + self._damping
            if self.play > 0.0:
                # Within the play the position loop turns its own side of the gear only; the arm feels no spring.
                if abs(error) < self.play:
                    error, slope = 0.0, self._damping
                else:
                    error -= math.copysign(self.play, error)
            drive = self._stiffness * error - self._damping * turn
            if drive > limit:
                drive = limit
            elif drive < -limit:
                drive = -limit
            else:
                tangent = slope
        friction = self._friction[index]
        gear = state._gear[index] - _GEAR_BRISTLE * turn
        if gear > friction:
            gear = friction
        elif gear < -friction:
            gear = -friction
        else:
            tangent += _GEAR_BRISTLE
        self.gear[index] = gear
        angle = state.angles[index] + turn
        stop = 0.0
        if angle < state._geometry.joint_min:
            stop = _END_STOP * (state._geometry.joint_min - angle)
            tangent += _END_STOP
        elif angle > state._geometry.joint_max:
            stop = _END_STOP * (state._geometry.joint_max - angle)
            tangent += _END_STOP
        inertia = -self._inertia * (turn - state.rates[index] * self._dt)
        return drive + gear + stop + inertia + self._carried[index], tangent + self._inertia, drive

    def _touch(self, d: list[float], fx: float, fy: float, fz: float) -> tuple[float, float, float, float, float]:
        """Add contact, its friction and the magnets; return the forces and the lateral and normal tangents."""
        self.normal = self.magnet = 0.0
        if self._gap == math.inf:
            self.rub = [0.0, 0.0]
            return fx, fy, fz, 0.0, 0.0
        gap = self._gap - d[2]
        self.magnet, _ = pull(self._magnets, gap, self._offset)
        fz += self.magnet
        if gap >= 0.0:
            self.rub = [0.0, 0.0]
            return fx, fy, fz, 0.0, 0.0
        contact = self._contact
        stiffness = 2.0 * contact.stiffness
        normal, along = -gap * stiffness, stiffness
        if -gap > contact.hard_stop:
            normal += (-gap - contact.hard_stop) * contact.hard_stop_stiffness
            along += contact.hard_stop_stiffness
        self.normal = normal
        fz -= normal
        side = min(stiffness, _LATERAL_MOST)
        rx, ry = self._state._rub[0] - side * d[0], self._state._rub[1] - side * d[1]
        size, most = math.hypot(rx, ry), contact.friction * normal
        if size > most:
            scale = most / size
            rx, ry = rx * scale, ry * scale
            side *= scale
        self.rub = [rx, ry]
        return fx + rx, fy + ry, fz, side, along

    def _carried_torque(self) -> list[float]:
        """Return what the weight of the rods' elbow halves does to each arm (N·m)."""
        state = self._state
        geometry, (gx, gy, gz) = state._geometry, self._gravity
        half = 0.5 * geometry.rod_mass * geometry.arm
        torques = []
        for angle, (cosine, sine) in zip(state.angles, LIMB_DIRECTIONS, strict=True):
            torques.append(half * (gz * math.cos(angle) - (gx * cosine + gy * sine) * math.sin(angle)))
        return torques


def _inverse(m: tuple[float, ...]) -> tuple[Vector, Vector, Vector]:
    """Return the inverse of a 3×3 matrix given row by row, as rows."""
    a, b, c, d, e, f, g, h, i = m
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    s = 1.0 / determinant
    return (
        ((e * i - f * h) * s, (c * h - b * i) * s, (b * f - c * e) * s),
        ((f * g - d * i) * s, (a * i - c * g) * s, (c * d - a * f) * s),
        ((d * h - e * g) * s, (b * g - a * h) * s, (a * e - b * d) * s),
    )


def _solve(matrix: Symmetric, right: list[float]) -> list[float]:
    """Solve a symmetric positive-definite 3×3 system by Cholesky's factors."""
    xx, xy, xz, yy, yz, zz = matrix
    l21, l31 = xy / xx, xz / xx
    d2 = yy - l21 * xy
    l32 = (yz - l31 * xy) / d2
    d3 = zz - l31 * xz - l32 * (yz - l31 * xy)
    y0 = right[0]
    y1 = right[1] - l21 * y0
    y2 = right[2] - l31 * y0 - l32 * y1
    z2 = y2 / d3
    z1 = y1 / d2 - l32 * z2
    z0 = y0 / xx - l21 * z1 - l31 * z2
    return [z0, z1, z2]
