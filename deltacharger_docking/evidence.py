# SPDX-License-Identifier: Apache-2.0
"""What a measurement of the misalignment rests on, and whether it still does.

Encoders show little of a target that moves, because the magnets take the platform along. The pads show it within one
frame: each millimetre of clearance that is lost changes at least 0.3 of their pattern, up to 4 mm or 6° (40 simulated
devices); 2 mm along the bars change less than noise.
"""

from __future__ import annotations

import math

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_docking.observation import Observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import Vector

CONTACT_LOST_CURRENT = 0.15  # A, contact current below which contact is lost
_CONTACT_LOST_RETREAT = 0.0015  # m, retreat while live that means lost contact
PRESS_AGE_MAX = 0.1  # s, age of servo_state and tactile frames that stops the arm

_ASIDE = 0.006  # m; faultless dockings stand still: 0.0 in 420 of seven scenes
_HARDER = 0.3  # A above the band; faultless dockings 0.2, with worn gears
_PATTERN, _LARGEST = 300.0, 1.2  # share of the pattern per m of clearance; and as far as that holds
_NOISE = 0.3  # share that one frame may change in any case; noise changed 0.18 at most


class Evidence:
    """Place of the platform and pattern of the pads during the last measurement."""

    def __init__(self) -> None:
        self._frames: list[Array] | None = None  # of the measurement under way
        self._place: Vector | None = None
        self._allowed = _NOISE
        self._pattern: Array | None = None
        self._last: Array | None = None  # frame whose change is known
        self._change = 0.0

    def forget(self) -> None:
        """Forget the last measurement: the arm moves."""
        self._frames = self._place = self._pattern = self._last = None

    @property
    def is_kept(self) -> bool:
        """Whether there is a measurement."""
        return self._place is not None

    def begin(self) -> None:
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
        self._frames, self._place = None, position

    def lost(self, parameters: DockingParameters, position: Vector, current: float, seen: Observation) -> str:
        """Return why the measurement no longer holds; '' = it does, or there is none.

        Args:
            parameters: of docking.
            position: of the platform, m.
            current: contact current, A; the largest that its noise allows.
            seen: the present observation.
        """
        if self._place is None or max(seen.servo_age, seen.tactile_age) > PRESS_AGE_MAX:
            return ""
        x, y, z = (now - then for now, then in zip(position, self._place, strict=True))
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
