"""From servo currents to one signed number that says how hard the electrodes are pushed."""

from __future__ import annotations

import math
from collections import deque

from deltacharger_docking.observation import NAN3
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.statics import TORQUE_CONSTANT

_WINDOW = 0.12  # s; a median over at least 100 ms suppresses current noise and single bad replies


class ContactCurrent:
    """Contact current I_c = f_z J_z / Kt, with f_z from J⁻ᵀ (τ − τ_hold(p)) less its reading in free air.

    It is the current that each servo spends on pushing along +z: positive when pushing, negative when the magnets pull
    the servos back. The arm's weight and the friction of free motion are removed; the raw maximum or sum of the servos,
    which contain both, stay selectable for comparison.
    """

    def __init__(self, kinematics: ScalarDelta, parameters: DockingParameters) -> None:
        self._kinematics = kinematics
        self._gravity = parameters.gravity
        self._signal = parameters.current_signal
        self._window: deque[tuple[float, float]] = deque()
        self._tare = 0.0
        self._factor = math.nan
        self.position: Vector = NAN3

    def update(self, time: float, angles: Vector, currents: Vector) -> None:
        """Take one reading of arm angles (rad) and currents (A) made at `time` (s)."""
        kinematics = self._kinematics
        self.position = x, y, z = kinematics.forward(*angles)
        jacobian = kinematics.jacobian(x, y, z)
        self._factor = (jacobian[6] + jacobian[7] + jacobian[8]) / (3.0 * TORQUE_CONSTANT)
        if self._signal == "contact":
            held = kinematics.holding_torque(x, y, z, self._gravity)
            push = [current * TORQUE_CONSTANT - hold for current, hold in zip(currents, held, strict=True)]
            value = kinematics.force(x, y, z, (push[0], push[1], push[2]))[2]
        else:
            raw = max(abs(current) for current in currents) if self._signal == "max" else sum(map(abs, currents))
            value = raw / self._factor
        if math.isfinite(value):
            self._window.append((time, value))
        while self._window and self._window[0][0] < time - _WINDOW:
            self._window.popleft()

    def clear(self) -> None:
        """Forget what was read before, so that the next value holds only what follows."""
        self._window.clear()

    def tare(self) -> None:
        """Take the present force as zero (free air, at rest after a motion along +z); raw signals have no zero."""
        if self._window and self._signal == "contact":
            self._tare += self.force

    @property
    def force(self) -> float:
        """Force (N) of the servos on the target along +z, median over 0.12 s; NaN without readings."""
        if not self._window:
            return math.nan
        values = sorted(value for _, value in self._window)
        middle = len(values) // 2
        median = values[middle] if len(values) % 2 else 0.5 * (values[middle - 1] + values[middle])
        return median - self._tare

    @property
    def value(self) -> float:
        """Contact current (A per servo); NaN without readings."""
        return self.force * self._factor
