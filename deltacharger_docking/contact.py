# SPDX-License-Identifier: Apache-2.0
"""What currents and pads show of a contact: how hard the electrodes press, and whether a measurement still holds.

Encoders show little of a target that moves, because the magnets take the platform along. The pads show it within one
frame: each millimetre of clearance that is lost changes at least 0.3 of their pattern, up to 4 mm or 6° (40 simulated
devices); 2 mm along the bars change less than noise.
"""

import math
from collections import deque
from collections.abc import Iterator

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_docking.observation import NAN3, Observation
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


CONTACT_LOST_CURRENT = 0.15  # A, contact current below which contact is lost
_CONTACT_LOST_RETREAT = 0.0015  # m, retreat while live that means lost contact
PRESS_AGE_MAX = 0.1  # s, age of servo_state and tactile frames that stops the arm

_ASIDE = 0.006  # m; faultless dockings stand still: 0.0 in 420 of seven scenes
_HARDER = 0.3  # A above the band; faultless dockings 0.2, with worn gears
_PATTERN, _LARGEST = 300.0, 1.2  # share of the pattern per m of clearance; and as far as that holds
_NOISE = 0.3  # share that one frame may change in any case; noise changed 0.18 at most


class Evidence:
    """Place of the platform (m, None = no measurement) and pattern of the pads during the last measurement."""

    def __init__(self) -> None:
        self._frames: list[Array] | None = None  # of the measurement under way
        self.place: Vector | None = None
        self._allowed = _NOISE
        self._pattern: Array | None = None
        self._last: Array | None = None  # frame whose change is known
        self._change = 0.0

    def forget(self) -> None:
        """Forget the last measurement: the arm moves."""
        self._frames = self.place = self._pattern = self._last = None

    def begin_contact(self) -> None:
        """Begin a measurement: the frames that follow belong to it. The last one counts until it ends."""
        self._frames = []

    def add(self, frame: Array | None) -> None:
        """Take a tared frame (2, 10, 10) N of the measurement; None = none."""
        if self._frames is not None and frame is not None and not (self._frames and frame is self._frames[-1]):
            self._frames.append(frame)

    def keep(self, position: Vector, margin: float) -> None:
        """End the measurement: the platform rests at `position` (m), with a clearance of at least `margin` (m)."""
        self._allowed = max(min(_PATTERN * margin, _LARGEST), _NOISE)
        pattern = np.nan_to_num(np.mean(self._frames, axis=0)) if self._frames else np.zeros(1)
        self._pattern = pattern if pattern.sum() > 0.0 else None
        self._frames, self.place = None, position

    def lost(self, parameters: DockingParameters, position: Vector, current: float, seen: Observation) -> str:
        """Return why the measurement no longer holds; '' = it does, or there is none.

        Args:
            parameters: of docking.
            position: of the platform, m.
            current: contact current, A; the largest that its noise allows.
            seen: the present observation.
        """
        if self.place is None or seen.oldest > PRESS_AGE_MAX:
            return ""
        x, y, z = (now - then for now, then in zip(position, self.place, strict=True))
        if (aside := math.hypot(x, y)) > _ASIDE:
            return f"the electrodes moved sideways by {1000 * aside:.1f} mm"
        if abs(z) > _CONTACT_LOST_RETREAT:
            return f"the electrodes moved by {1000 * z:+.1f} mm along z"
        if current < CONTACT_LOST_CURRENT or not seen.tactile_contact:
            return "contact was lost"
        if current > parameters.current_max + _HARDER:
            return f"the push rose to {current:.2f} A"
        if (changed := self._changed(seen.taxels)) > self._allowed:
            return f"the target shifted or turned on the pads: {100 * changed:.0f} % of their pattern changed"
        return ""

    def _changed(self, frame: Array | None) -> float:
        """Return the share of the pattern that a frame changes, whatever the push."""
        pattern = self._pattern
        if pattern is None or frame is None:
            return 0.0
        if frame is not self._last:
            felt, total = np.where(np.isfinite(frame), frame, 0.0), float(pattern.sum())
            scale = total / max(float(felt.sum()), 1e-9)
            self._last, self._change = frame, float(np.abs(felt * scale - pattern).sum()) / total
        return self._change
