# SPDX-License-Identifier: Apache-2.0
"""The platform's tilt under an off-centre or tilted contact: small angles, at rest in every step, plain floats.

Each electrode presses at two points, ± l/(2√3) along its overlap of length l with its mate, which together are as stiff
against turning as the whole line. A point at (u, v) of the platform is compressed by depth + φx v − φy u, with φ the
platform's tilt less the target's; its springs cannot pull. The platform yields by its compliance, α = −c Σ v N and
β = c Σ u N: two equations, solved by Newton with the springs that press. Without compliance the platform keeps its
attitude and the target's tilt alone shares the force out.
"""

from __future__ import annotations

from math import sqrt

from deltacharger_sim.parameters import WorldParameters

_PAD = 0.048  # m from the middle to each pad, along x
_ROOT_12 = sqrt(12.0)
_ITERATIONS = 20
_ENOUGH = 1e-12  # rad


def tilts(parameters: WorldParameters) -> bool:
    """Return whether anything tilts; if not, none of this module runs."""
    target = parameters.target
    return parameters.platform.compliance > 0.0 or target.tilt_x != 0.0 or target.tilt_y != 0.0


class PlatformTilt:
    """Contact of two electrodes that need not lie flat.

    Attributes:
        angles: of the platform about x and y, rad, of the last `press`.
        left_share: of the contact force on the left pad (at +x), 0 to 1, by the lever rule.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        self._compliance = parameters.platform.compliance
        self._target = parameters.target.tilt_x, parameters.target.tilt_y
        self._contact = parameters.contact
        terminal = parameters.terminal
        self._length, self._up = terminal.length, 0.5 * (terminal.gap + terminal.height)
        self.angles = (0.0, 0.0)
        self.left_share = 0.5

    def press(self, depth: float, x: float, y: float) -> tuple[float, float]:
        """Return normal force (N) and stiffness (N/m) at the centre's compression (m) with the target at x, y (m)."""
        # The electrodes press at four points around the middle of what overlaps.
        half = max(self._length - abs(x), 0.0) / _ROOT_12
        middle_x, middle_y, up = 0.5 * x, 0.5 * y, self._up
        # More than this no point can be compressed, whatever the platform does.
        reach = (abs(middle_x) + half) * abs(self._target[1]) + (abs(middle_y) + up) * abs(self._target[0])
        if depth + reach <= 0.0:
            self.angles, self.left_share = (0.0, 0.0), 0.5
            return 0.0, 0.0
        points = [(middle_x + su * half, middle_y + sv * up) for su in (1.0, -1.0) for sv in (1.0, -1.0)]
        return self._settle(depth, points)

    def _settle(self, depth: float, points: list[tuple[float, float]]) -> tuple[float, float]:
        contact, c = self._contact, self._compliance
        alpha, beta = self.angles
        for _ in range(_ITERATIONS):
            force = stiff = first_u = first_v = 0.0  # Σ N, Σ k, Σ k u, Σ k v
            moment_u = moment_v = uu = uv = vv = 0.0  # Σ u N, Σ v N, Σ k u², Σ k u v, Σ k v²
            for u, v in points:
                pressed = depth + (alpha - self._target[0]) * v - (beta - self._target[1]) * u
                if pressed <= 0.0:
                    continue
                k = 0.5 * contact.stiffness
                normal = k * pressed
                if pressed > contact.hard_stop:
                    stop = 0.25 * contact.hard_stop_stiffness
                    normal, k = normal + stop * (pressed - contact.hard_stop), k + stop
                force, stiff = force + normal, stiff + k
                moment_u, moment_v = moment_u + u * normal, moment_v + v * normal
                first_u, first_v = first_u + k * u, first_v + k * v
                uu, uv, vv = uu + k * u * u, uv + k * u * v, vv + k * v * v
            # α + c Σ v N = 0 and β − c Σ u N = 0, with their derivatives by α and β.
            ra, rb = alpha + c * moment_v, beta - c * moment_u
            aa, ab, bb = 1.0 + c * vv, -c * uv, 1.0 + c * uu
            determinant = aa * bb - ab * ab
            da, db = (bb * ra - ab * rb) / determinant, (aa * rb - ab * ra) / determinant
            if abs(da) + abs(db) < _ENOUGH:
                break
            alpha, beta = alpha - da, beta - db
        self.angles = (alpha, beta)
        self.left_share = min(max(0.5 + 0.5 * moment_u / (force * _PAD), 0.0), 1.0) if force > 0.0 else 0.5
        # What the tilt gives way as the centre goes deeper: dα = −c Σ v k …, the same system with another right side.
        wa, wb = c * first_v, -c * first_u
        da, db = (bb * wa - ab * wb) / determinant, (aa * wb - ab * wa) / determinant
        return force, max(stiff - first_v * da + first_u * db, 0.0)
