# SPDX-License-Identifier: Apache-2.0
"""Forces of the target on the platform: magnets, electrodes with their stop, lateral friction."""

from __future__ import annotations

from math import hypot

from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.tilt import PlatformTilt, tilts

LATERAL_MOST = 1e6  # N/m; stiffer bristles would yield less than 20 µm, but make stick and slip hard to solve


class TargetTouch:
    """Magnets and electrodes against a target whose lateral offset is set by `lie`.

    Attributes:
        tilt: of the platform in contact; None if nothing tilts.
        side: lateral stiffness of the electrodes before they slide, N/m.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        self._magnets, self._contact = parameters.magnets, parameters.contact
        self.tilt = PlatformTilt(parameters) if tilts(parameters) else None
        self.side = min(2.0 * self._contact.stiffness, LATERAL_MOST)
        if parameters.stand.stiffness > 0.0:  # in series with the robots' tyres
            self.side /= 1.0 + self.side / parameters.stand.stiffness
        self._pull = self._aligns = 0.0

    def lie(self, x: float, y: float) -> None:
        """Set the target's centre to (x, y) in end_effector, m."""
        distance = hypot(x, y) / self._magnets.width
        magnets, share = self._magnets, 1.0 / (1.0 + distance * distance)
        self._pull = magnets.force * max(magnets.floor, share)
        # From the same energy as the pull: −force · range / (1 + gap/range) · share.
        steep = 2.0 * magnets.force * magnets.range / magnets.width**2 if share > magnets.floor else 0.0
        self._aligns = steep * share * share
        if self.tilt is not None:
            self.tilt.lie(x, y)

    @property
    def onset(self) -> float:
        """Gap of the faces (m) at which they first touch."""
        return 0.0 if self.tilt is None else self.tilt.onset

    def forces(
        self, gap: float, dx: float, dy: float, rub: tuple[float, float], before: float
    ) -> tuple[float, float, float, float, float, float, float]:
        """Return pull, normal force, lateral friction along x and y (N), two tangents and the magnets' aligning (N/m).

        Args:
            gap: of the faces, m; negative = compression.
            dx: lateral displacement in this step, m.
            dy: along y, m.
            rub: lateral friction at the step's start, N.
            before: tangent along z of all other parts, N/m.

        Returns:
            The tangents are the lateral one and the increase of the normal one. The magnets' negative one counts
            only while it is less than half of the others'. Aligning is the magnets' lateral pull per offset.
        """
        if self.tilt is not None:
            normal, stiffer = self.tilt.press(-gap)
        elif gap < 0.0:
            normal, stiffer = self._press(-gap)
        else:
            normal = stiffer = 0.0
        magnet, aligns = self._pull, self._aligns
        if gap > 0.0:
            # With a lean, an end may press while the middle does not touch yet.
            reach = self._magnets.range
            ratio = 1.0 + gap / reach
            magnet /= ratio * ratio
            aligns /= ratio
            softer = 2.0 * magnet / (ratio * reach)
            if softer < 0.5 * (before + stiffer):
                stiffer -= softer
        if normal <= 0.0:
            return magnet, 0.0, 0.0, 0.0, 0.0, stiffer, aligns
        if self.tilt is not None:
            swung_x, swung_y = self.tilt.swing
            dx, dy = dx + swung_x, dy + swung_y
        contact = self._contact
        side = self.side
        rx, ry = rub[0] - side * dx, rub[1] - side * dy
        size, most = hypot(rx, ry), contact.friction * normal
        if size > most:
            scale = most / size
            rx, ry, side = rx * scale, ry * scale, side * scale
        return magnet, normal, rx, ry, side, stiffer, aligns

    def _press(self, depth: float) -> tuple[float, float]:
        """Return the normal force (N) and stiffness (N/m) of both electrodes at a compression (m)."""
        contact = self._contact
        stiffness = 2.0 * contact.stiffness
        if depth > contact.hard_stop:
            stop = contact.hard_stop_stiffness
            return depth * stiffness + (depth - contact.hard_stop) * stop, stiffness + stop
        return depth * stiffness, stiffness
