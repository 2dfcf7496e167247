# SPDX-License-Identifier: Apache-2.0
"""Contact current: one signed number for the force of the electrodes, from the servos' currents."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

from deltacharger_docking.observation import NAN3
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import LIMB_COUNT, Vector
from deltacharger_kinematics.scalar import ScalarDelta

CONTACT_WINDOW = 0.12  # s, window of the contact current's median


class ContactCurrent:
    """Contact current I_c = f_z J_z / Kt, with f_z from J⁻ᵀ (τ − τ_hold(p)) less its reading in free air.

    It is each servo's current for pushing along +z: positive for a push, negative if the magnets pull. The arm's weight
    and the friction of free motion are removed.

    Attributes:
        position: of the platform, m in charger_base.
        per_force: contact current per force, A/N.
        changed: s, time of the last reading that differed from the one before.
    """

    def __init__(self, kinematics: ScalarDelta, parameters: DockingParameters) -> None:
        self._kinematics = kinematics
        self._gravity = parameters.gravity
        self._span = CONTACT_WINDOW
        self._constant = parameters.torque_constant
        geometry = kinematics.geometry
        self._limbs = tuple(geometry.limb(index) for index in range(LIMB_COUNT))
        self._platform = geometry.platform_mass + 1.5 * geometry.rod_mass
        self._half_rod = 0.5 * geometry.rod_mass
        self._window: deque[tuple[float, float, Vector]] = deque()
        self._median = math.nan
        self._tare = 0.0
        self.per_force = math.nan
        self._angles: Vector = NAN3
        self._along_z: Vector = NAN3
        self._weight = math.nan
        self.position: Vector = NAN3
        self._reading = NAN3, NAN3  # the last one
        self.changed = -math.inf

    def update(self, time: float, angles: Vector, currents: Vector) -> None:
        """Take one reading of arm angles (rad) and currents (A) made at `time` (s)."""
        if (angles, currents) != self._reading:
            self._reading, self.changed = (angles, currents), time
        if angles != self._angles:
            self._move(angles)
        a, b, c = self._along_z
        value = self._constant * (a * currents[0] + b * currents[1] + c * currents[2]) - self._weight
        window = self._window
        if math.isfinite(value):
            window.append((time, value, currents))
        while window and window[0][0] < time - self._span:
            window.popleft()
        self._median = math.nan

    def _move(self, angles: Vector) -> None:
        """Set arm angles (rad): calculate the platform's position and the servos' effect there.

        The force along z is the last column of J⁻¹ times the torques, less the same product with the holding torques
        τ_hold = Jᵀ(−m g) − rods. That product is the weight, −m g_z, and the part of the rods' elbow halves.
        """
        self._angles = angles
        self.position = x, y, z = self._kinematics.forward(*angles)
        a, b, c, d, e, f, g, h, i = self._kinematics.jacobian(x, y, z)
        self.per_force = (g + h + i) / (3.0 * self._constant)
        p, q, r = b * f - c * e, c * d - a * f, a * e - b * d
        determinant = g * p + h * q + i * r
        if determinant == 0.0 or not math.isfinite(determinant):  # a limb at its edge, or invalid angles
            self._along_z, self._weight = NAN3, math.nan
            return
        self._along_z = p / determinant, q / determinant, r / determinant
        self._weight = self._rods_along_z() - self._platform * self._gravity[2]

    def _rods_along_z(self) -> float:
        """Return the force (N) along z of the torques that hold the rods' elbow halves."""
        gx, gy, gz = self._gravity
        force = 0.0
        for share, limb, angle in zip(self._along_z, self._limbs, self._angles, strict=True):
            turned = angle + limb.angle_offset
            torque = limb.arm * (gz * math.cos(turned) - (gx * limb.cosine + gy * limb.sine) * math.sin(turned))
            force -= share * self._half_rod * torque
        return force

    def clear(self) -> None:
        """Clear the window, so that the next value holds only later readings."""
        self._window.clear()
        self._median = math.nan

    @property
    def span(self) -> float:
        """Time (s) from the oldest to the newest reading in the window."""
        return self._window[-1][0] - self._window[0][0] if self._window else 0.0

    def tare(self) -> None:
        """Use the present force as zero (free air, at rest after a motion along +z)."""
        if self._window:
            self._tare += self.force

    @property
    def force(self) -> float:
        """Force (N) of the servos on the target along +z, median over CONTACT_WINDOW; NaN without readings."""
        if self._median != self._median and self._window:
            values = sorted(value for _, value, _ in self._window)
            middle = len(values) // 2
            self._median = values[middle] if len(values) % 2 else 0.5 * (values[middle - 1] + values[middle])
        return self._median - self._tare

    @property
    def drift(self) -> float:
        """Change (A) of the contact current from the older to the newer half of its window; NaN without readings."""
        values = [value for _, value, _ in self._window]
        half = len(values) // 2
        return (sum(values[-half:]) - sum(values[:half])) / half * self.per_force if half else math.nan

    @property
    def currents(self) -> Vector:
        """Mean of the servos' currents (A) over CONTACT_WINDOW; NaN without readings."""
        count = len(self._window)
        if not count:
            return NAN3
        a, b, c = map(sum, self._by_servo())
        return a / count, b / count, c / count

    def _by_servo(self) -> Iterator[tuple[float, ...]]:
        """Return the currents (A) of each servo in the window."""
        return zip(*(currents for _, _, currents in self._window), strict=True)

    @property
    def currents_error(self) -> float:
        """Largest standard error (A) of those means, by the scatter of the readings; 0 with fewer than two."""
        count = len(self._window)
        if count < 2:
            return 0.0
        servos = zip(self._by_servo(), self.currents, strict=True)
        squares = [sum([(value - mean) ** 2 for value in values]) for values, mean in servos]
        return math.sqrt(max(squares)) / count  # `statistics.pstdev` takes 50 times as long

    @property
    def repeats_itself(self) -> bool:
        """Whether all currents of the window are equal, as when servo_state repeats itself."""
        return all(reading[2] == self._window[0][2] for reading in self._window)

    @property
    def value(self) -> float:
        """Contact current (A per servo); NaN without readings."""
        return self.force * self.per_force
