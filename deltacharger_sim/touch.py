# SPDX-License-Identifier: Apache-2.0
"""Forces of the target on the platform: magnets, electrodes with their stop, friction, and the tilt they cause.

Tilt of the platform under an off-centre or leaning contact: small angles, static in every step, plain floats.
Each electrode presses along the line of length l in which it overlaps its mate, with 1/l of its stiffness per length:
the contact of a spring bed, integrated exactly. A point (u, v) of the platform is compressed by D + a v − b u. D is the
compression on the platform's axis, (a, b) the platform's tilt less the target's. Springs cannot pull, so an end or a
complete bar may lift. The tactile pads, springs K at ±s along x, bear on the target's ridges, at ±s (1, t) if these are
rolled by an angle with tangent t. They turn the platform back by M = 2 K s² (b − t a) about y, until one is empty and
the other bears all: |M| ≤ N s. (For a, a constant is used: the target's pitch that the bars alone leave. With the tilt
of the moment, M would drive itself up on stiff springs.) The pads add no normal force: the electrodes' stiffness
represents bars and pads together. About x they resist a thirtieth of the bars' moment, and turn by −t M; both are
neglected.

The platform yields by its compliance, α = −c Σ v N and β = c (Σ u N − M). While both pads press, that is the minimum of
a convex energy, (α² + β²)/2c + Σ ∫ k p²/2l over the pressed length + K s² (b − t a)². With one pad alone, the moment
follows the normal force at once: with the previous step's moment, force and moment would oscillate where inertia holds
the depth.

If both bars press along their complete length and off their stops, it is a 2 × 2 linear system, with both pads pressed
or one of them empty, solved once for every position of the target. Otherwise, Newton's iteration over the pressed
lengths is used, with each step cut back if it overshoots. Without compliance nothing is solved.
"""

from __future__ import annotations

import math
from math import hypot
from typing import NamedTuple

from deltacharger_core.machine import BAR_GAP, BAR_HEIGHT, BAR_LENGTH, PAD_DISTANCE
from deltacharger_sim.pads import Turn
from deltacharger_sim.parameters import WorldParameters


class Bars(NamedTuple):
    """Forces on both electrodes.

    Attributes:
        upper: normal force on the electrode at +y, N.
        lower: on the electrode at −y, N.
        upper_pressed: share of the upper overlap's length that presses, 0 to 1.
        lower_pressed: of the lower overlap's length.
    """

    upper: float
    lower: float
    upper_pressed: float = 1.0
    lower_pressed: float = 1.0

    @staticmethod
    def flat(force: float) -> Bars:
        """Return the bars' shares of `force` (N) if nothing leans."""
        return Bars(0.5 * force, 0.5 * force)


PAD = PAD_DISTANCE
_ITERATIONS, _HALVINGS = 40, 8
PAD_STIFFNESS = 1.5e5  # N/m of each pad against yaw of the platform: slope of the tactile contact model at 78 N
PADS_TURN = 2.0 * PAD_STIFFNESS * PAD * PAD
"""Moment of both pads about y while both press, N·m per rad of residual yaw."""
_ENOUGH = 1e-3  # of the largest compression, change in the last Newton step; the error is about its square
_SHORTEST = 1e-6  # m of half an overlap; with less, bars press as on one spot
_OVERSHOT = -0.5  # of the slope along a Newton step; a step that ends beyond is cut back
_WEAKEST = 0.1  # of the force, share that one pad's moment may remove; beyond, bars with a large offset would snap

_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0)
# Over the pressed parts: Σ k, Σ k u, Σ k v, Σ k u², Σ k u v, Σ k v² of stiffness, Σ N, Σ u N, Σ v N of force,
# and the largest and the least compression (m).
_Sums = tuple[float, float, float, float, float, float, float, float, float, float, float]


def tilts(parameters: WorldParameters) -> bool:
    """Return whether anything tilts; if not, this module is not used."""
    target = parameters.target
    return parameters.platform.compliance > 0.0 or target.tilt_x != 0.0 or target.tilt_y != 0.0


def level_yaw(parameters: WorldParameters) -> float:
    """Return the platform's tilt about y (rad) at which both pads bear equally: on rolled ridges pitch acts as yaw."""
    target, up = parameters.target, 0.5 * (BAR_GAP + BAR_HEIGHT)
    held = 2.0 * parameters.contact.stiffness * up * up
    left = target.tilt_x / (1.0 + parameters.platform.compliance * held)
    return target.tilt_y - math.tan(target.roll) * left


class PlatformTilt:
    """Contact of two electrodes that need not be parallel to the target's.

    Attributes:
        angles: of the platform about x and y, rad, of the last `press`.
        swing: lateral move of the face along x and y by its tilt in the last step, m. It acts on the electrodes in the
            next step, so that friction within a step does not depend on the tilt and needs no further iteration.
    """

    def __init__(self, parameters: WorldParameters) -> None:
        self._compliance = parameters.platform.compliance
        self._target = parameters.target.tilt_x, parameters.target.tilt_y
        contact = parameters.contact
        self._yaw = level_yaw(parameters)
        self._stiffness, self._stop = contact.stiffness, 0.5 * contact.hard_stop_stiffness  # of one bar
        self._travel = contact.hard_stop
        self._up = 0.5 * (BAR_GAP + BAR_HEIGHT)
        self.angles = (0.0, 0.0)
        self._load = (0.0, 0.0)  # N of the last `press`, and the compression (m) of the platform's axis
        self._pads = PADS_TURN if self._compliance > 0.0 else 0.0  # N·m/rad
        self.swing = (0.0, 0.0)
        self._lifts = False  # whether the last `press` found an end lifted or a stop reached
        self._lever = parameters.platform.lever
        self._kept = (0.0, 0.0)  # angles at the last step's end
        self._tangent = (0.0, 0.0, 0.0)  # compression (m) of the last iteration's end, dα/dD and dβ/dD (rad/m)
        self.lie(0.0, 0.0)

    def lie(self, x: float, y: float) -> None:
        """Set the target's centre to (x, y) in end_effector, m."""
        tilt_x, tilt_y = self._target
        self._middle = middle_x, middle_y = 0.5 * x, 0.5 * y  # of what overlaps
        half = 0.5 * (BAR_LENGTH - abs(x))
        self._half = half = half if half > _SHORTEST else _SHORTEST
        # The target leans about its own centre; the resulting compression on the platform's axis.
        self._lift = tilt_x * y - tilt_y * x
        # Extra compression of the most compressed end against the axis while the platform is level.
        self._reach = tilt_y * middle_x - tilt_x * middle_y + abs(tilt_x) * self._up + abs(tilt_y) * half
        self._flat: tuple[float, ...] = ()  # of `_lie_flat` with both pads pressed
        self._empty: tuple[float, ...] = ()  # the same with one of them empty

    @property
    def onset(self) -> float:
        """Gap (m) between platform and target's centre at which a level platform first touches."""
        return self._lift + self._reach

    def press(self, depth: float) -> tuple[float, float]:
        """Return normal force (N) and stiffness (N/m) for a compression (m) of the target's centre by the platform."""
        depth += self._lift
        if depth + self._reach <= 0.0:
            self.angles, self._load, self._tangent = (0.0, 0.0), (0.0, 0.0), (0.0, 0.0, 0.0)
            return 0.0, 0.0
        if self._lifts:
            return self._settle(depth)
        if not self._flat:
            self._flat, self._empty = self._lie_flat(self._pads), ()
        a0, b0, n0, a1, b1, n1, _, _, _ = self._flat
        alpha, beta, force = a0 + a1 * depth, b0 + b1 * depth, n0 + n1 * depth
        moment, most = self._pads * (beta - self._yaw), PAD * force
        if not -most <= moment <= most:
            self._empty = self._empty or self._lie_flat(0.0)
            a0, b0, n0, a1, b1, n1, a2, b2, n2 = self._empty
            arm = math.copysign(PAD, moment)
            weaker = max(1.0 - n2 * arm, _WEAKEST)
            force, n1 = (n0 + n1 * depth) / weaker, n1 / weaker
            alpha, beta = a0 + a1 * depth + a2 * arm * force, b0 + b1 * depth + b2 * arm * force
            a1, b1 = a1 + a2 * arm * n1, b1 + b2 * arm * n1
        if self._is_lifting(depth, alpha, beta):
            return self._settle(depth)
        self.angles, self._load, self._tangent = (alpha, beta), (force, depth), (depth, a1, b1)
        return force, n1

    def _is_lifting(self, depth: float, alpha: float, beta: float) -> bool:
        """Return whether part of a bar does not press, or presses on its stop."""
        a, b = alpha - self._target[0], beta - self._target[1]
        middle = depth + a * self._middle[1] - b * self._middle[0]
        spread = abs(a) * self._up + abs(b) * self._half
        return not spread <= middle <= self._travel - spread

    def keep(self) -> tuple[Turn, Bars]:
        """Take the last `press` as a step's end; return tilt (rad) and forces on the bars."""
        (alpha, beta), (before_a, before_b), lever = self.angles, self._kept, self._lever
        self.swing = (lever * (beta - before_b), lever * (before_a - alpha)) if alpha or beta else (0.0, 0.0)
        self._kept = self.angles
        return self.angles, self._bars()

    def _bars(self) -> Bars:
        """Return the forces on the bars after the last `press`."""
        (force, depth), (mx, my), (alpha, beta) = self._load, self._middle, self.angles
        if force <= 0.0:
            return Bars(0.0, 0.0, 0.0, 0.0)
        a, b = alpha - self._target[0], beta - self._target[1]
        middle, lean, spread = depth + a * my - b * mx, a * self._up, abs(b) * self._half
        forces, shares = [], []
        for pressed in (middle + lean, middle - lean):
            stiff, _, _, bears, _ = self._line(pressed, b, self._stiffness, spread)
            beyond = self._line(pressed - self._travel, b, self._stop, spread)[3]
            forces.append(bears + beyond)
            shares.append(stiff / self._stiffness)
        return Bars(forces[0], forces[1], shares[0], shares[1])

    def _lie_flat(self, pads: float) -> tuple[float, ...]:
        """Return α, β and Σ N while both bars press completely: constants, slopes over D and over a moment of the pads.

        The pads' resistance is `pads` N·m/rad.
        """
        (mx, my), (tx, ty), up, half = self._middle, self._target, self._up, self._half
        stiff = 2.0 * self._stiffness
        q = self._compliance * stiff
        uv, uu, vv = mx * my, mx * mx + half * half / 3.0, my * my + up * up
        held = pads / stiff
        aa, bb, ab = 1.0 + q * vv, 1.0 + q * (uu + held), -q * uv
        determinant = aa * bb - ab * ab
        found: list[float] = []
        for depth, target_a, target_b, right_a, right_b in (
            (0.0, tx, ty, tx * vv - ty * uv, ty * uu - tx * uv + held * self._yaw),
            (1.0, 0.0, 0.0, -my, mx),
            (0.0, 0.0, 0.0, 0.0, -1.0 / stiff),
        ):
            alpha = q * (bb * right_a - ab * right_b) / determinant
            beta = q * (aa * right_b - ab * right_a) / determinant
            found += alpha, beta, stiff * (depth + (alpha - target_a) * my - (beta - target_b) * mx)
        return tuple(found)

    def _settle(self, depth: float) -> tuple[float, float]:
        """Return force and stiffness if an end lifts or a stop is reached, by iteration from the last angles."""
        c, half, up = self._compliance, self._half, self._up
        if c == 0.0:
            stiff, _, _, _, _, _, force, _, _, most, least = self._sums(depth, 0.0, 0.0)
            self._load, self._lifts = (force, depth), least < 0.0 or most > self._travel
            return force, stiff
        (last, turn_a, turn_b), (alpha, beta) = self._tangent, self.angles
        # Start from the last solution's tangent.
        alpha, beta = alpha + (depth - last) * turn_a, beta + (depth - last) * turn_b
        da = db = slope = 0.0
        tip, yaw = self._pads, self._yaw
        for left in range(_ITERATIONS, -1, -1):
            stiff, ku, kv, kuu, kuv, kvv, force, moment_u, moment_v, most, least = self._sums(depth, alpha, beta)
            pads, held, arm, bound = tip * (beta - yaw), tip, 0.0, PAD * force
            if pads > bound or pads < -bound:
                arm = PAD if pads > 0.0 else -PAD
                pads, held = arm * force, 0.0
            # α + c Σ v N = 0 and β − c (Σ u N − M) = 0, with their derivatives by α and β.
            ra, rb = alpha + c * moment_v, beta - c * (moment_u - pads)
            ends = ra * da + rb * db
            if left and ends < _OVERSHOT * slope:
                alpha, beta = self._cut_back(depth, (alpha, beta), (da, db), slope, ends)
                da = db = slope = 0.0
                continue
            aa, ab = 1.0 + c * kvv, -c * kuv
            ba, bb = ab + c * arm * kv, 1.0 + c * (kuu + held - arm * ku)
            determinant = aa * bb - ab * ba
            if not left:  # steps may oscillate around the kink at which a pad empties: keep this, not quite balanced
                break
            da, db = (bb * ra - ab * rb) / determinant, (aa * rb - ba * ra) / determinant
            alpha, beta, slope = alpha - da, beta - db, ra * da + rb * db
            if abs(da) * up + abs(db) * half <= _ENOUGH * most:
                # The rest is linear: not worth another sum.
                force = force - kv * da + ku * db
                if (-PAD * force <= tip * (beta - yaw) <= PAD * force) == (held > 0.0):
                    break
        # Change of tilt as the centre goes deeper: dα = −c Σ k v …, the same system with another right side.
        wa, wb = -c * kv, c * (ku - arm * stiff)
        da, db = (bb * wa - ab * wb) / determinant, (aa * wb - ba * wa) / determinant
        self.angles, self._load, self._tangent = (alpha, beta), (force, depth), (depth, da, db)
        self._lifts = least < 0.0 or most > self._travel
        return force, max(stiff + kv * da - ku * db, 0.0)

    def _cut_back(
        self, depth: float, there: tuple[float, float], step: tuple[float, float], slope: float, ends: float
    ) -> tuple[float, float]:
        """Return the tilt (rad) at which the moments along a step ending at `there` are in balance.

        Moments are `slope` at the start and `ends` < 0 at the end. Uses a secant in a bracket whose far end counts half
        (Illinois rule).
        """
        (alpha, beta), (da, db), c = there, step, self._compliance
        low, high, at_low, at_high, back = 0.0, 1.0, ends, slope, 0.0  # shares of the step, from its end
        for _ in range(_HALVINGS):
            if at_high == at_low:
                break
            back = low - at_low * (high - low) / (at_high - at_low)
            a, b = alpha + back * da, beta + back * db
            force, moment_u, moment_v = self._sums(depth, a, b)[6:9]
            most = PAD * force
            pads = min(max(self._pads * (b - self._yaw), -most), most)
            here = (a + c * moment_v) * da + (b - c * (moment_u - pads)) * db
            if abs(here) <= -_OVERSHOT * slope:
                break
            if here < 0.0:
                low, at_low, at_high = back, here, 0.5 * at_high
            else:
                high, at_high, at_low = back, here, 0.5 * at_low
        return alpha + back * da, beta + back * db

    def _sums(self, depth: float, alpha: float, beta: float) -> _Sums:
        """Return the sums over the pressed parts for a compression (m) of the axis and a tilt (rad)."""
        (mx, my), up, k = self._middle, self._up, self._stiffness
        a, b = alpha - self._target[0], beta - self._target[1]
        middle = depth + a * my - b * mx
        lean = a * up
        # Of the upper and the lower bar, about the middle of the overlap, u = mx + w: Σ k, Σ k w, Σ k w², Σ N, Σ w N.
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
