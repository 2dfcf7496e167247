# SPDX-License-Identifier: Apache-2.0
"""The platform at rest against the target: approach and two tilts from the balance of force and both moments.

Unknowns: z, α (about x: +y comes closer), β (about y: +x comes closer) and the deflection w of both pads' lower
layers. A point at (x, y) comes closer by h = z + α y + β x − gap. The energy is convex: skin (at h − w), lower layer,
bars and platform, minus the work of the force at its line of action. Newton steps in z, α, β with damped steps of w
find its minimum; a step that raises the energy is halved.

**The pads** are elastic foundations. Two layers in series. A skin of thickness t, indented by δ, responds with the
nominal pressure of a neo-Hookean block compressed to the stretch λ = 1 − δ/t: p = (c E / 3) (λ⁻² − λ), c the
confinement. It never pulls. Below it is Pasternak's layer, springs joined by a shear layer: p = k (w − ℓ² ∇²w),
without shear across the pad's rim. The taxels under it carry r = k w = (1 − ℓ² ∇²)⁻¹ p: the load spread over about 2
ℓ, reflected at the rim, with the total unchanged. Both layers follow from a convex energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core import arrays, machine
from deltacharger_lab.second.parameters import BarParameters, FoundationParameters, SecondParameters
from deltacharger_tactile.parameters import PadContactParameters

BEYOND = 1.0
"""Gap (m) of a point without a ridge."""
_LEAST_STRETCH = 0.3  # below it pressure continues along its tangent: a stop, finite at any force


@dataclass(frozen=True)
class Ridges:
    """Form errors of one target's ridges.

    Attributes:
        bow: (2,) m, distance of a ridge's middle behind its ends.
        skew: (2,) m, distance of its end at +x behind its end at −x.
    """

    bow: arrays.Array
    skew: arrays.Array

    @staticmethod
    def draw(parameters: FoundationParameters, random: np.random.Generator) -> Ridges:
        """Draw the ridges of one rig."""
        return Ridges(
            parameters.bow * random.standard_normal(machine.PADS),
            parameters.skew * random.standard_normal(machine.PADS),
        )

    @staticmethod
    def straight() -> Ridges:
        """Return ridges without errors."""
        return Ridges(np.zeros(machine.PADS), np.zeros(machine.PADS))


class PadFoundation:
    """Both pads as grids of m × n points each, P in total; immutable.

    The grid is finer along y than along x, because ridges are narrow along y.

    Attributes:
        x: (P,) m, points along x in end_effector, left pad first.
        y: (P,) m, points along y.
        area: of a point, m².
        base: stiffness of the lower layer, Pa/m.
    """

    def __init__(self, dimensions: PadContactParameters, parameters: FoundationParameters) -> None:
        self._dimensions = dimensions
        fine = parameters.sub_samples
        self._shape = shape = (machine.ROWS * fine, machine.COLUMNS * ((fine + 1) // 2))
        v, u = np.meshgrid(*(dimensions.pad_side * (0.5 - (np.arange(n) + 0.5) / n) for n in shape), indexing="ij")
        centre, points = dimensions.pad_distance, shape[0] * shape[1]
        self.x = np.concatenate([u.ravel() + centre, u.ravel() - centre])
        self.y = np.concatenate([v.ravel(), v.ravel()])
        self.area = dimensions.pad_side**2 / points
        self._centre = np.repeat([centre, -centre], points)
        self._pad = np.repeat([0, 1], points)
        self._factor = parameters.confinement * parameters.modulus / 3.0
        self._thickness = parameters.thickness
        self.base = parameters.base_stiffness
        (self._down, rows), (self._right, columns) = (_waves(n) for n in shape)
        lengths = parameters.shear_length / dimensions.pad_side * np.array(shape)
        self._spread = 1.0 / (1.0 + lengths[0] ** 2 * rows[:, None] + lengths[1] ** 2 * columns)

    def gap(self, pose: arrays.Array, ridges: Ridges) -> arrays.Array:
        """Return (N, P) m, gaps between the ridges and each point at poses (N, 3); BEYOND without a ridge."""
        d = self._dimensions
        x, y, angle = (pose[:, axis, None] for axis in range(3))
        cosine, sine = np.cos(angle), np.sin(angle)
        dx, dy = self.x - x, self.y - y
        along, across = cosine * dx + sine * dy - self._centre, cosine * dy - sine * dx
        gap = across * across * (0.5 / d.crown_radius)
        missed = np.zeros(gap.shape, dtype=bool)
        for distance, half in ((np.abs(across), 0.5 * d.ridge_height), (np.abs(along), 0.5 * d.ridge_length)):
            rounding = np.maximum(distance - (half - d.edge_radius), 0.0)
            gap += d.edge_radius - np.sqrt(np.maximum(d.edge_radius**2 - rounding * rounding, 0.0))
            missed |= rounding > d.edge_radius
        missed |= along * along + across * across < 0.25 * d.hole * d.hole
        share = along / (0.5 * d.ridge_length)
        gap += ridges.bow[self._pad] * (1.0 - share * share) + 0.5 * ridges.skew[self._pad] * share
        gap[missed] = BEYOND
        return np.asarray(gap)

    def press(self, depth: arrays.Array) -> tuple[arrays.Array, arrays.Array, arrays.Array]:
        """Return pressure (Pa), its slope (Pa/m) and the energy (J/m²) of the skin at indentations (m)."""
        pressed = depth > 0.0
        stretch = 1.0 - np.maximum(depth, 0.0) / self._thickness
        held = np.maximum(stretch, _LEAST_STRETCH)
        beyond = (held - stretch) * self._thickness
        inverse = 1.0 / held
        square = inverse * inverse
        slope = (self._factor / self._thickness) * (1.0 + 2.0 * square * inverse)
        first = self._factor * (square - held)
        energy = self._factor * self._thickness * (inverse - 1.0 - 0.5 * (1.0 - held * held))
        energy += beyond * (first + 0.5 * slope * beyond)
        return first + slope * beyond, slope * pressed, energy

    def deflect(self, pressure: arrays.Array) -> arrays.Array:
        """Return the deflection (N, P) m of the lower layer under a pressure (N, P) Pa."""
        return np.asarray(self._filter(pressure).reshape(pressure.shape) / self.base)

    def taxels(self, pressure: arrays.Array) -> arrays.Array:
        """Return the forces on the taxels (N, 2, 10, 10) N by pressure (N, P) Pa; row 0 at +y, column 0 at +x."""
        down, right = self._shape[0] // machine.ROWS, self._shape[1] // machine.COLUMNS
        borne = self._filter(pressure).reshape(-1, machine.PADS, machine.ROWS, down, machine.COLUMNS, right)
        return np.asarray(np.maximum(borne.sum(axis=(3, 5)) * self.area, 0.0))

    def _filter(self, pressure: arrays.Array) -> arrays.Array:
        grid = pressure.reshape(-1, *self._shape)
        return np.asarray(self._down.T @ ((self._down @ grid @ self._right.T) * self._spread) @ self._right)


def _waves(count: int) -> tuple[arrays.Array, arrays.Array]:
    """Return the cosine waves (n, n) of a line of points without flux at its ends, and their squared wave numbers."""
    order = np.arange(count)
    waves = np.sqrt(2.0 / count) * np.cos(np.pi * order[:, None] * (order + 0.5) / count)
    waves[0] /= np.sqrt(2.0)
    return waves, 2.0 - 2.0 * np.cos(np.pi * order / count)


_SEGMENTS = 28  # of a bar along its length: 2.5 mm each
_RAMP = 1e-3  # m of overlap in height for the full force of a segment: bars have rounded edges


class SpringBars:
    """Both bars as segments with one spring law; immutable.

    Attributes:
        x: (2 S,) m, centre of each segment in end_effector, upper bar first.
        y: (2 S,) m.
    """

    def __init__(self, parameters: BarParameters) -> None:
        self._parameters = parameters
        width = machine.BAR_LENGTH / _SEGMENTS
        line = 0.5 * machine.BAR_LENGTH - width * (np.arange(_SEGMENTS) + 0.5)
        middle = 0.5 * (machine.BAR_GAP + machine.BAR_HEIGHT)
        self.x = np.tile(line, 2)
        self.y = np.repeat([middle, -middle], _SEGMENTS)
        self._middle, self._width = middle, width

    def overlap(self, pose: arrays.Array) -> arrays.Array:
        """Return (N, 2 S) the share of each segment, 0 to 1, that overlaps a bar of the target at poses (N, 3)."""
        x, y, angle = (pose[:, axis, None] for axis in range(3))
        cosine, sine = np.cos(angle), np.sin(angle)
        dx, dy = self.x - x, self.y - y
        along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
        end = np.clip((0.5 * machine.BAR_LENGTH - np.abs(along)) / self._width + 0.5, 0.0, 1.0)
        off = np.minimum(np.abs(across - self._middle), np.abs(across + self._middle))
        return np.asarray(end * np.clip((machine.BAR_HEIGHT - off) / _RAMP, 0.0, 1.0))

    def press(self, approach: arrays.Array) -> tuple[arrays.Array, arrays.Array, arrays.Array]:
        """Return force (N), its slope (N/m) and the energy (J) of full segments at approaches (N, 2 S) m.

        The bar first leaves its stop (preload), then its springs yield, then it is solid.
        """
        p = self._parameters
        share = 1.0 / _SEGMENTS
        depth = np.maximum(approach + p.proud, 0.0)
        seated, late = np.minimum(depth, p.seat), np.maximum(depth - p.travel, 0.0)
        first = p.preload / p.seat
        force = first * seated + p.rate * depth + p.stop_stiffness * late
        slope = (depth > 0.0) * p.rate + first * ((depth > 0.0) & (depth < p.seat)) + p.stop_stiffness * (late > 0.0)
        energy = first * seated * (depth - 0.5 * seated) + 0.5 * p.rate * depth**2 + 0.5 * p.stop_stiffness * late**2
        return share * force, share * slope, share * energy


_CHUNK = 48
_ITERATIONS = 300
_BALANCED, _SETTLED = 1e-8, 1e-4  # of the force; of the largest pressure
_LEVER = 0.05  # m, to compare moments with forces
_FARTHEST = np.array([1e-3, 0.02, 0.02])  # m and rad, largest step
_SQUARE = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # index of the monomials in the second moments of (1, y, x)
_SHARE = 0.5  # of a load's deflection that a step predicts under the load itself: 1 suits smooth loads, 0 rough ones
_SOFT = 1.0  # N/m, keeps the step of a platform in free air finite


@dataclass(frozen=True)
class RestingContact:
    """N contacts at rest.

    Attributes:
        taxels: (N, 2, 10, 10) N on each taxel; pad 0 is left (+x), row 0 at +y, column 0 at +x.
        bars: (N, 2) N on the upper and the lower bar; the force is the sum of bars and taxels.
        state: (N, 3) m, rad, rad: approach and tilts about x and y; NaN without contact.
        moments: (N, 2) N·m about x and y of the forces on pads and bars.
    """

    taxels: arrays.Array
    bars: arrays.Array
    state: arrays.Array
    moments: arrays.Array


class _Trial(NamedTuple):
    """Energy (N,), its gradient (N, 3) and curvature (N, 3, 3) by z, α, β; pressure, its slope (N, K), bars' force."""

    energy: arrays.Array
    gradient: arrays.Array
    curvature: arrays.Array
    pressure: arrays.Array
    slope: arrays.Array
    bars: arrays.Array


class Equilibrium:
    """Platform, pads and bars for a family of rigs; immutable."""

    def __init__(self, parameters: SecondParameters | None = None) -> None:
        self.parameters = parameters or SecondParameters()
        self._pads = PadFoundation(self.parameters.dimensions, self.parameters.foundation)
        self._bars = SpringBars(self.parameters.bars)

    def solve(
        self,
        pose: ArrayLike,
        force: ArrayLike,
        line: ArrayLike = (0.0, 0.0),
        lean: ArrayLike = (0.0, 0.0),
        ridges: Ridges | None = None,
    ) -> RestingContact:
        """Press the target against platforms.

        Args:
            pose: (N, 3) or (3,) m, m, rad: pose of the target in end_effector.
            force: (N,) or scalar N; no contact if it is not positive.
            line: (N, 2) or (2,) m, point of action of the force: x, y.
            lean: (N, 2) or (2,) rad, tilt (about x, about y) of the platform against the target without moment.
            ridges: of the target; None = straight.
        """
        poses = np.atleast_2d(np.asarray(pose, dtype=float))
        count = len(poses)
        forces = np.broadcast_to(np.asarray(force, dtype=float), (count,))
        lines = np.broadcast_to(np.asarray(line, dtype=float), (count, 2))
        leans = np.broadcast_to(np.asarray(lean, dtype=float), (count, 2))
        rest = RestingContact(
            np.zeros((count, machine.PADS, machine.ROWS, machine.COLUMNS)),
            np.zeros((count, 2)),
            np.full((count, 3), np.nan),
            np.zeros((count, 2)),
        )
        chosen = np.flatnonzero(forces > 0.0)
        for start in range(0, len(chosen), _CHUNK):
            rows = chosen[start : start + _CHUNK]
            work = _Work(
                self.parameters, self._pads, self._bars, poses[rows], forces[rows], lines[rows], leans[rows],
                ridges or Ridges.straight(),
            )  # fmt: skip
            if work.touching.any():
                work.settle(rest, rows)
        return rest


class _Work:
    """One chunk of contacts being solved."""

    def __init__(
        self, parameters: SecondParameters, pads: PadFoundation, bars: SpringBars,
        pose: arrays.Array, force: arrays.Array, line: arrays.Array, lean: arrays.Array, ridges: Ridges,
    ) -> None:  # fmt: skip
        self._pads, self._bars = pads, bars
        self._hold = 1.0 / parameters.platform.compliance
        self._lean, self._overlap = lean, bars.overlap(pose)
        gap = pads.gap(pose, ridges)
        self._index, self._gap = _standing(gap)
        self._at, self._bars_at = _monomials(pads.y[self._index], pads.x[self._index]), _monomials(bars.y, bars.x)
        self._at *= pads.area
        highest = np.where(self._overlap.any(axis=1), parameters.bars.proud, -BEYOND)
        self._highest = np.maximum(highest, -self._gap.min(axis=1))
        self.touching: arrays.Mask = self._highest > -0.5 * BEYOND
        self._force = np.where(self.touching, force, 0.0)
        self._work = self._force[:, None] * np.column_stack([np.ones(len(pose)), line[:, 1], line[:, 0]])
        self._points = gap.shape[1]
        self._flat = self._index + self._points * np.arange(len(pose))[:, None]
        self._stiff = np.diag([_SOFT, self._hold, self._hold])

    def settle(self, rest: RestingContact, rows: NDArray[np.int64]) -> None:
        """Solve every contact and write the result into `rest` at `rows`."""
        state = np.column_stack([2e-4 - self._highest, self._lean])
        load, sunk = np.zeros(self._gap.shape), np.zeros(self._gap.shape)  # on the lower layer, Pa; its deflection, m
        done = ~self.touching
        lowest = np.full(len(state), np.inf)
        at, change, share = (state, load, sunk), (state, load, sunk), np.ones(len(state))
        for _ in range(_ITERATIONS):
            trial = self._try(state, load, sunk)
            done = done | self._is_settled(trial, load)
            if done.all():
                break
            climbed = ~done & (trial.energy > lowest + 1e-13 * self._force)
            good = ~done & ~climbed
            share = np.where(climbed, 0.5 * share, 1.0)
            if good.any():
                lowest = np.where(good, trial.energy, lowest)
                here, step = (state, load, sunk), self._step(trial, load)
                at = _chosen(good, here, at)
                change = _chosen(good, step, change)
            moving = np.where(done, 0.0, share)[:, None]
            fresh = tuple(old + moving * new for old, new in zip(at, change, strict=True))
            state, load, sunk = _chosen(~done, fresh, (state, load, sunk))
        self._write(rest, rows, state, trial)

    def _try(self, state: arrays.Array, load: arrays.Array, sunk: arrays.Array) -> _Trial:
        height = _dot(self._at[:, :, :3], state) / self._pads.area
        pressure, slope, energy = self._pads.press(height - self._gap - sunk)
        force, rate, stored = self._bars.press(state @ self._bars_at[:, :3].T)
        over = self._overlap
        force, rate = over * force, over * rate
        turn = state[:, 1:] - self._lean
        total = self._pads.area * (energy + 0.5 * load * sunk).sum(axis=1) + (over * stored).sum(axis=1)
        total += 0.5 * self._hold * (turn * turn).sum(axis=1) - (self._work * state).sum(axis=1)
        gradient = _sums(pressure, self._at[:, :, :3]) + force @ self._bars_at[:, :3] - self._work
        gradient[:, 1:] += self._hold * turn
        curvature = (_sums(slope, self._at) + rate @ self._bars_at)[:, _SQUARE].reshape(-1, 3, 3)
        curvature += self._stiff
        return _Trial(total, gradient, curvature, pressure, slope, force)

    def _is_settled(self, trial: _Trial, load: arrays.Array) -> arrays.Mask:
        off = np.abs(trial.gradient) / [1.0, _LEVER, _LEVER]
        apart = np.abs(trial.pressure - load).max(axis=1)
        still = apart <= _SETTLED * trial.pressure.max(axis=1)
        return np.asarray((off.max(axis=1) <= _BALANCED * self._force) & still)

    def _step(self, trial: _Trial, load: arrays.Array) -> tuple[arrays.Array, arrays.Array, arrays.Array]:
        """Return steps of state, load and deflection; the Newton step of the state anticipates the other two."""
        more = (trial.pressure - load) / (1.0 + _SHARE * trial.slope / self._pads.base)
        deeper = self._pads.deflect(self._grid(more)).ravel()[self._flat]
        wanted = _sums(trial.slope * deeper, self._at[:, :, :3]) - trial.gradient
        move = np.asarray(np.linalg.solve(trial.curvature, wanted[:, :, None])[:, :, 0], dtype=np.float64)
        move /= np.maximum(np.abs(move) / _FARTHEST, 1.0).max(axis=1, keepdims=True)
        return move, more, deeper

    def _grid(self, values: arrays.Array) -> arrays.Array:
        grid = np.zeros((len(values), self._points))
        grid.ravel()[self._flat] = values
        return grid

    def _write(self, rest: RestingContact, rows: NDArray[np.int64], state: arrays.Array, trial: _Trial) -> None:
        pressure, force = trial.pressure * self.touching[:, None], trial.bars * self.touching[:, None]
        rest.taxels[rows] = self._pads.taxels(self._grid(pressure))
        rest.bars[rows] = force.reshape(len(rows), 2, -1).sum(axis=2)
        rest.state[rows] = np.where(self.touching[:, None], state, np.nan)
        pressed = _sums(pressure, self._at[:, :, :3]) + force @ self._bars_at[:, :3]
        rest.moments[rows] = pressed[:, 1:]


def _standing(gap: arrays.Array) -> tuple[NDArray[np.int64], arrays.Array]:
    """Return (N, K) indices of the points under ridges, padded with others, and their gaps."""
    on = gap < 0.5 * BEYOND
    most = max(int(on.sum(axis=1).max()), 1)
    index = np.argsort(~on, axis=1, kind="stable")[:, :most]
    return index, np.take_along_axis(gap, index, axis=1)


def _chosen(
    rows: arrays.Mask, fresh: tuple[arrays.Array, ...], old: tuple[arrays.Array, ...]
) -> tuple[arrays.Array, arrays.Array, arrays.Array]:
    if rows.all():
        return fresh  # type: ignore[return-value]
    a, b, c = (np.where(rows[:, None], new, before) for new, before in zip(fresh, old, strict=True))
    return a, b, c


def _monomials(y: arrays.Array, x: arrays.Array) -> arrays.Array:
    """Return (…, 6): 1, y, x, y², y x, x²."""
    return np.stack([np.ones(y.shape), y, x, y * y, y * x, x * x], axis=-1)


def _sums(values: arrays.Array, weights: arrays.Array) -> arrays.Array:
    """Return (N, M) sums of values (N, K) with weights (N, K, M)."""
    return np.asarray((values[:, None] @ weights)[:, 0])


def _dot(weights: arrays.Array, values: arrays.Array) -> arrays.Array:
    """Return (N, K) sums of values (N, M) with weights (N, K, M)."""
    return np.asarray((weights @ values[:, :, None])[:, :, 0])
