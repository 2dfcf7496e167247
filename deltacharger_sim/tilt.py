# SPDX-License-Identifier: Apache-2.0
"""The platform's tilt under an off-centre or leaning contact: small angles, at rest in every step, plain floats.

Each electrode presses along the line of length l in which it overlaps its mate, with 1/l of its stiffness per length:
the contact of a spring bed, integrated exactly. A point at (u, v) of the platform is compressed by D + a v − b u, with
D the compression on the platform's axis and (a, b) the platform's tilt less the target's; springs cannot pull, so that
an end or a whole bar lifts. The platform yields by its compliance, α = −c Σ v N and β = c Σ u N. That is the minimum of
a convex energy, (α² + β²)/2c + Σ ∫ k p²/2l over the pressed length.

Where both bars press along their whole length and off their stops, it is a 2 × 2 linear system, solved once for every
place of the target. Elsewhere it is Newton's iteration over the pressed lengths, each step of it cut back where it
overshoots. Without compliance nothing is solved: the target's tilt alone shares the force out.
"""

from __future__ import annotations

from deltacharger_sim.parameters import WorldParameters

PAD = 0.048  # m from the middle to each pad, along x
_ITERATIONS = 60
_ENOUGH = 1e-3  # of the largest compression that a last Newton step may change; its error is about the square of that
_SHORTEST = 1e-6  # m of half an overlap; bars that lie further apart press as on one spot
_OVERSHOT = -0.5  # of the slope along a Newton step; one that ends beyond is cut back

_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0)
# Over what presses: Σ k, Σ k u, Σ k v, Σ k u², Σ k u v, Σ k v² of its stiffness, Σ N, Σ u N, Σ v N of its force,
# and the largest and the least compression (m).
_Sums = tuple[float, float, float, float, float, float, float, float, float, float, float]


def tilts(parameters: WorldParameters) -> bool:
    """Return whether anything tilts; if not, none of this module runs."""
    target = parameters.target
    return parameters.platform.compliance > 0.0 or target.tilt_x != 0.0 or target.tilt_y != 0.0


def left_share(force: float, moment: float) -> float:
    """Return the left pad's share, 0 to 1, of a force (N) whose moment Σ u N is given (N·m), by the lever rule."""
    return min(max(0.5 + 0.5 * moment / (force * PAD), 0.0), 1.0) if force > 0.0 else 0.5


class PlatformTilt:
    """Contact of two electrodes that need not lie flat.

    Attributes:
        angles: of the platform about x and y, rad, of the last `press`.
        swing: how far the face swung aside along x and y by its tilt in the last step, m. The electrodes feel it in the
            next one: friction within a step then hangs on no tilt, and each costs no iteration more.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        self._compliance = parameters.platform.compliance
        self._target = parameters.target.tilt_x, parameters.target.tilt_y
        contact, terminal = parameters.contact, parameters.terminal
        self._stiffness, self._stop = contact.stiffness, 0.5 * contact.hard_stop_stiffness  # of one bar
        self._travel = contact.hard_stop
        self._length, self._up = terminal.length, 0.5 * (terminal.gap + terminal.height)
        self.angles = (0.0, 0.0)
        self._load = (0.0, 0.0)  # Σ N (N) and Σ u N (N·m) of the last `press`
        self.swing = (0.0, 0.0)
        self._lifts = False  # whether the last `press` found an end lifted or a stop reached
        self._lever = parameters.platform.lever
        self._kept = (0.0, 0.0)  # angles at the last step's end
        self._tangent = (0.0, 0.0, 0.0)  # compression (m) of the last iteration's end, dα/dD and dβ/dD (rad/m)
        self.lie(0.0, 0.0)

    def lie(self, x: float, y: float) -> None:
        """Put the target's centre to (x, y) in end_effector, m."""
        tilt_x, tilt_y = self._target
        self._middle = middle_x, middle_y = 0.5 * x, 0.5 * y  # of what overlaps
        half = 0.5 * (self._length - abs(x))
        self._half = half = half if half > _SHORTEST else _SHORTEST
        # The target leans about its own centre; what that adds to the compression on the platform's axis.
        self._lift = tilt_x * y - tilt_y * x
        # What the most compressed end has more than the axis while the platform is level.
        self._reach = tilt_y * middle_x - tilt_x * middle_y + abs(tilt_x) * self._up + abs(tilt_y) * half
        self._linear: tuple[float, ...] = ()

    @property
    def onset(self) -> float:
        """Gap (m) between platform and target's centre at which the first end touches while the platform is level."""
        return self._lift + self._reach

    def press(self, depth: float) -> tuple[float, float]:
        """Return normal force (N) and stiffness (N/m) at a compression (m) of the target's centre by the platform."""
        depth += self._lift
        if depth + self._reach <= 0.0:
            self.angles, self._load, self._tangent = (0.0, 0.0), (0.0, 0.0), (0.0, 0.0, 0.0)
            return 0.0, 0.0
        if self._lifts:
            return self._settle(depth)
        a0, a1, b0, b1, n0, n1, m0, m1 = self._linear or self._lie_flat()
        alpha, beta = a0 + a1 * depth, b0 + b1 * depth
        if self._is_lifting(depth, alpha, beta):
            return self._settle(depth)
        force = n0 + n1 * depth
        self.angles, self._load, self._tangent = (alpha, beta), (force, m0 + m1 * depth), (depth, a1, b1)
        return force, n1

    def _is_lifting(self, depth: float, alpha: float, beta: float) -> bool:
        """Return whether not all of both bars presses, or any of it on its stop."""
        a, b = alpha - self._target[0], beta - self._target[1]
        middle = depth + a * self._middle[1] - b * self._middle[0]
        spread = abs(a) * self._up + abs(b) * self._half
        return not spread <= middle <= self._travel - spread

    @property
    def left_share(self) -> float:
        """Share of the contact force on the left pad (at +x) after the last `press`, 0 to 1, by the lever rule."""
        return left_share(*self._load)

    def keep(self) -> tuple[tuple[float, float], float]:
        """Take the last `press` as a step's end; return its tilt (rad) and left share."""
        (alpha, beta), (before_a, before_b), lever = self.angles, self._kept, self._lever
        self.swing = (lever * (beta - before_b), lever * (before_a - alpha)) if alpha or beta else (0.0, 0.0)
        self._kept = self.angles
        return self.angles, self.left_share

    def _lie_flat(self) -> tuple[float, ...]:
        """Return what α, β, Σ N and Σ u N are while all of both bars presses: (constant, slope over D) of each."""
        (mx, my), (tx, ty), up, half = self._middle, self._target, self._up, self._half
        stiff = 2.0 * self._stiffness
        q = self._compliance * stiff
        uv, uu, vv = mx * my, mx * mx + half * half / 3.0, my * my + up * up
        aa, bb, ab = 1.0 + q * vv, 1.0 + q * uu, -q * uv
        determinant = aa * bb - ab * ab
        found = []
        for depth, right_a, right_b in ((0.0, tx * vv - ty * uv, ty * uu - tx * uv), (1.0, -my, mx)):
            alpha = q * (bb * right_a - ab * right_b) / determinant
            beta = q * (aa * right_b - ab * right_a) / determinant
            a, b = (alpha, beta) if depth else (alpha - tx, beta - ty)
            found.append((alpha, beta, stiff * (depth + a * my - b * mx), stiff * (depth * mx + a * uv - b * uu)))
        (a0, b0, n0, m0), (a1, b1, n1, m1) = found
        self._linear = a0, a1, b0, b1, n0, n1, m0, m1
        return self._linear

    def _settle(self, depth: float) -> tuple[float, float]:
        """Return force and stiffness where an end lifts or a stop is reached, by iteration from the last angles."""
        c, half, up = self._compliance, self._half, self._up
        if c == 0.0:
            stiff, _, _, _, _, _, force, moment_u, _, most, least = self._sums(depth, 0.0, 0.0)
            self._load, self._lifts = (force, moment_u), least < 0.0 or most > self._travel
            return force, stiff
        (last, turn_a, turn_b), (alpha, beta) = self._tangent, self.angles
        # From where the last solution's tangent leads.
        alpha, beta = alpha + (depth - last) * turn_a, beta + (depth - last) * turn_b
        da = db = slope = 0.0
        for _ in range(_ITERATIONS):
            stiff, ku, kv, kuu, kuv, kvv, force, moment_u, moment_v, most, least = self._sums(depth, alpha, beta)
            # α + c Σ v N = 0 and β − c Σ u N = 0, with their derivatives by α and β.
            ra, rb = alpha + c * moment_v, beta - c * moment_u
            ends = ra * da + rb * db
            if ends < _OVERSHOT * slope:
                alpha, beta = self._cut_back(depth, (alpha, beta), (da, db), slope, ends)
                da = db = slope = 0.0
                continue
            aa, ab, bb = 1.0 + c * kvv, -c * kuv, 1.0 + c * kuu
            determinant = aa * bb - ab * ab
            da, db = (bb * ra - ab * rb) / determinant, (aa * rb - ab * ra) / determinant
            alpha, beta, slope = alpha - da, beta - db, ra * da + rb * db
            if abs(da) * up + abs(db) * half <= _ENOUGH * most:
                # What is left is linear: not worth another sum.
                force, moment_u = force - kv * da + ku * db, moment_u - kuv * da + kuu * db
                break
        # What the tilt gives way as the centre goes deeper: dα = −c Σ k v …, the same system with another right side.
        wa, wb = -c * kv, c * ku
        da, db = (bb * wa - ab * wb) / determinant, (aa * wb - ab * wa) / determinant
        self.angles, self._load, self._tangent = (alpha, beta), (force, moment_u), (depth, da, db)
        self._lifts = least < 0.0 or most > self._travel
        return force, max(stiff + kv * da - ku * db, 0.0)

    def _cut_back(
        self, depth: float, there: tuple[float, float], step: tuple[float, float], slope: float, ends: float
    ) -> tuple[float, float]:
        """Return the tilt (rad) on a step that ended at `there` where the energy hardly falls or rises any more.

        Its slope along the step is `slope` at the start and `ends` < 0 at the end. By a secant in a bracket whose
        far end counts half, after the Illinois rule.
        """
        (alpha, beta), (da, db), c = there, step, self._compliance
        low, high, at_low, at_high, back = 0.0, 1.0, ends, slope, 0.0  # shares of the step, from its end
        for _ in range(_ITERATIONS):
            back = low - at_low * (high - low) / (at_high - at_low)
            a, b = alpha + back * da, beta + back * db
            moment_u, moment_v = self._sums(depth, a, b)[7:9]
            here = (a + c * moment_v) * da + (b - c * moment_u) * db
            if abs(here) <= -_OVERSHOT * slope:
                break
            if here < 0.0:
                low, at_low, at_high = back, here, 0.5 * at_high
            else:
                high, at_high, at_low = back, here, 0.5 * at_low
        return alpha + back * da, beta + back * db

    def _sums(self, depth: float, alpha: float, beta: float) -> _Sums:
        """Return the sums over what presses at a compression (m) of the axis and a tilt (rad)."""
        (mx, my), up, k = self._middle, self._up, self._stiffness
        a, b = alpha - self._target[0], beta - self._target[1]
        middle = depth + a * my - b * mx
        lean = a * up
        # Of the upper and the lower bar, about the middle of what overlaps, u = mx + w: Σ k, Σ k w, Σ k w², Σ N, Σ w N.
        upper, lower, spread = middle + lean, middle - lean, abs(b) * self._half
        p0, p1, p2, pn, pm = self._line(upper, b, k, spread)
        q0, q1, q2, qn, qm = self._line(lower, b, k, spread)
        most = (upper if lean > 0.0 else lower) + spread
        if most > self._travel:
            stop, travel = self._stop, self._travel
            s0, s1, s2, sn, sm = self._line(upper - travel, b, stop, spread)
            t0, t1, t2, tn, tm = self._line(lower - travel, b, stop, spread)
            p0, p1, p2, pn, pm = p0 + s0, p1 + s1, p2 + s2, pn + sn, pm + sm
            q0, q1, q2, qn, qm = q0 + t0, q1 + t1, q2 + t2, qn + tn, qm + tm
        stiff, first, force, higher, lower = p0 + q0, p1 + q1, pn + qn, my + up, my - up
        p0v, q0v = p0 * higher, q0 * lower
        kv = p0v + q0v
        kuu, kuv = mx * (mx * stiff + 2.0 * first) + p2 + q2, mx * kv + p1 * higher + q1 * lower
        kvv = p0v * higher + q0v * lower
        moment_u, moment_v = mx * force + pm + qm, pn * higher + qn * lower
        return stiff, mx * stiff + first, kv, kuu, kuv, kvv, force, moment_u, moment_v, most, 2.0 * middle - most

    def _line(self, pressed: float, b: float, k: float, spread: float) -> tuple[float, float, float, float, float]:
        """Return Σ k, Σ k w, Σ k w², Σ N and Σ w N of a bar compressed by pressed − b w, |w| up to half its overlap.

        `spread` is |b| times half its overlap.
        """
        half = self._half
        if pressed >= spread:
            k2 = k * half * half / 3.0
            return k, 0.0, k2, k * pressed, -k2 * b
        if pressed <= -spread:
            return _NOTHING
        # It presses from the nearer end to `edge` beyond the middle.
        edge = pressed * half / spread
        beyond = edge - half
        k0 = k * (0.5 + 0.5 * edge / half)
        k1 = 0.5 * k0 * (beyond if b > 0.0 else -beyond)
        k2 = k0 * (half * half + edge * beyond) / 3.0
        return k0, k1, k2, k0 * pressed - k1 * b, k1 * pressed - k2 * b
