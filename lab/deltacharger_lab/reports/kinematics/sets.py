# SPDX-License-Identifier: Apache-2.0
"""Seeded sets of points on which the report measures.

Points near the edge of reach are placed by geometry and then moved by a few units in the last place until their exact
distance to the edge, in 60 digits, is as wanted: 1e-17 m can only be met that way.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.geometry import LimbAdjustment
from deltacharger_kinematics.solve import LimbArrays
from deltacharger_lab.reports.kinematics.reference import ExactDelta

_STEPS = np.array(list(itertools.product(range(-4, 5), repeat=3)), dtype=np.float64)  # units in the last place tried
_CLEAR = 0.02  # of the shorter link; distance inside reach of the limbs that a set does not aim at
_DEFAULT_SPAN = 0.28  # m; arm + rod of the default robot, for which distances to the edge are stated
_ROUND = 512  # points moved at a time, to bound memory
_ATTEMPTS = 400
ADJUSTED = (
    LimbAdjustment(0.0010, 0.0020, 0.0030, 0.1010, 0.1810, 0.010),
    LimbAdjustment(-0.0010, 0.0010, -0.0030, 0.0990, 0.1790, -0.020),
    LimbAdjustment(0.0020, -0.0020, 0.0010, 0.1005, None, 0.005),
)
"""Limbs of a calibrated robot, all 18 parameters off."""


@dataclass(frozen=True)
class PointSet:
    """Points (n, 3) m in charger_base.

    Attributes:
        name: in the tables.
        about: method of drawing.
        points: the doubles that count as exact.
        edge: exact distance (n,) m to the edge of reach of the nearest limb, negative outside; None = not needed.
    """

    name: str
    about: str
    points: Array
    edge: Array | None = None


def plain_edge(geometry: DeltaGeometry, points: Array) -> Array:
    """Return the distance (n, 3) m inside reach of points (n, 3) for each limb, in plain doubles."""
    limbs = LimbArrays(geometry)
    x, y, z = points.T
    across = np.hypot(x * limbs.cosine + y * limbs.sine - limbs.difference, z + limbs.motor_height)
    side = y * limbs.cosine - x * limbs.sine - limbs.tangential
    nearest, farthest = np.hypot(across - limbs.arm, side), np.hypot(across + limbs.arm, side)
    return np.asarray(np.minimum(limbs.rod - nearest, farthest - limbs.rod).T)


def interior(geometry: DeltaGeometry, rng: np.random.Generator, count: int) -> PointSet:
    """Return points of the workspace box, evenly spread."""
    points = rng.uniform(geometry.workspace_min, geometry.workspace_max, (count, 3))
    return PointSet("interior", "evenly over the workspace box", points)


def wide(geometry: DeltaGeometry, rng: np.random.Generator, count: int) -> PointSet:
    """Return points of the complete volume that all three limbs reach, also behind the motors."""
    span = abs(geometry.base_radius - geometry.platform_radius) + geometry.arm + geometry.rod
    low, high = np.array([-span, -span, -geometry.z_offset - span]), np.array([span, span, span - geometry.z_offset])

    def draw(size: int) -> Array:
        points = rng.uniform(low, high, (size, 3))
        inside: Mask = plain_edge(geometry, points).min(-1) > 1e-9
        return points[inside]

    return PointSet("wide", "evenly over all that the three limbs reach, in front and behind", _collect(draw, count))


def near_type_2(geometry: DeltaGeometry, rng: np.random.Generator, count: int) -> PointSet:
    """Return points with |det| of the unit rod vectors from 1e-12 to 1e-2, found by bisection between its signs."""
    delta = Delta(geometry)

    def draw(size: int) -> Array:
        ends = wide(geometry, rng, 2 * size).points.reshape(2, size, 3)
        signs = [np.sign(delta.jacobian(end).determinant) for end in ends]
        start, end = (each[signs[0] * signs[1] < 0.0] for each in ends)
        side = np.sign(delta.jacobian(start).determinant)
        low, high = np.zeros(len(start)), np.ones(len(start))
        wanted = 10.0 ** rng.uniform(-12.0, -2.0, len(start))
        for _ in range(70):
            middle = 0.5 * (low + high)
            value = delta.jacobian(start + middle[:, None] * (end - start)).determinant
            before = value * side > wanted
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        points = start + low[:, None] * (end - start)
        value = np.abs(delta.jacobian(points).determinant)
        near: Mask = (value < 0.02) & (plain_edge(geometry, points).min(-1) > 1e-6)
        return points[near]

    return PointSet(
        "near type 2", "rods nearly in a plane, determinant of their directions 1e-12 to 1e-2", _collect(draw, count)
    )


def boundary(exact: ExactDelta, rng: np.random.Generator, count: int) -> PointSet:
    """Return points 1e-17 to 1e-3 m inside the edge of reach: one limb nearly stretched or nearly folded."""
    points, edge = _near_edge(exact, rng, count, (-17.0, -3.0), inside=True, place=_anywhere)
    return PointSet("boundary", "1e-17 to 1e-3 m inside the edge of reach, stretched or folded", points, edge)


def fold(exact: ExactDelta, rng: np.random.Generator, count: int) -> PointSet:
    """Return points with one limb nearly folded, a third with w, a third with u and a third with both near zero."""
    parts = [
        _near_edge(exact, rng, (count + shift) // 3, (-17.0, -3.0), inside=True, place=place)
        for shift, place in enumerate((_folded_w, _folded_u, _folded_both))
    ]
    points, edge = np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
    order = rng.permutation(len(points))  # so that the first few are a fair sample
    about = "one limb nearly folded while w, u or both pass through 0, down to 1e-17 m"
    return PointSet("fold", about, points[order], edge[order])


def outside(exact: ExactDelta, rng: np.random.Generator, count: int, low: float, high: float) -> PointSet:
    """Return points out of reach by 10^low to 10^high m."""
    points, edge = _near_edge(exact, rng, count, (low, high), inside=False, place=_anywhere)
    return PointSet(f"outside 1e{low:.0f} to 1e{high:.0f} m", "out of reach of one limb by this much", points, edge)


Placement = tuple[Array, Array, Array]  # distance from the motor axis, its angle, sideways; of the limb aimed at
Place = Callable[[Array, Array, np.random.Generator, Array], Placement]  # of arms, rods, distances to the edge


def _anywhere(arm: Array, rod: Array, rng: np.random.Generator, edge: Array) -> Placement:
    """Draw a platform joint `edge` m inside reach: on the shell of a torus about the circle of the elbow."""
    size = len(edge)
    around = rng.uniform(-math.pi, math.pi, size)
    folded = rng.random(size) < 0.5
    beyond = folded & (rod * np.cos(around) > arm)  # the rod extends back over the motor axis
    radius = np.where(beyond, rod + edge, rod - edge)
    across = np.where(beyond, -arm, arm) + radius * np.cos(around)
    across = np.where(folded == (beyond | (np.cos(around) < 0.0)), across, -1.0)
    return across, rng.uniform(-math.pi, math.pi, size), radius * np.sin(around)


def _folded(arm: Array, rod: Array, rng: np.random.Generator, edge: Array) -> tuple[Array, Array]:
    around = rng.uniform(-math.pi, math.pi, len(edge))
    beyond = np.cos(around) > arm / rod
    radius = np.where(beyond, rod + edge, rod - edge)
    across = np.where(beyond, radius * np.cos(around) - arm, arm - radius * np.abs(np.cos(around)))
    return across, radius * np.sin(around)


def _small(rng: np.random.Generator, size: int, low: float, high: float) -> Array:
    return np.asarray(10.0 ** rng.uniform(low, high, size) * rng.choice((-1.0, 1.0), size), dtype=np.float64)


def _folded_w(arm: Array, rod: Array, rng: np.random.Generator, edge: Array) -> Placement:
    across, side = _folded(arm, rod, rng, edge)
    ratio = np.clip(_small(rng, len(edge), -17.0, -3.0) / np.maximum(across, 1e-9), -1.0, 1.0)
    return across, np.where(rng.random(len(edge)) < 0.5, np.arcsin(ratio), math.pi - np.arcsin(ratio)), side


def _folded_u(arm: Array, rod: Array, rng: np.random.Generator, edge: Array) -> Placement:
    across, angle, side = _folded_w(arm, rod, rng, edge)
    return across, angle + rng.choice((-0.5, 0.5), len(edge)) * math.pi, side


def _folded_both(arm: Array, rod: Array, rng: np.random.Generator, edge: Array) -> Placement:
    across = np.abs(_small(rng, len(edge), -12.0, -3.0)) + edge
    beyond = rng.random(len(edge)) < 0.5
    radius, along = np.where(beyond, rod + edge, rod - edge), np.where(beyond, arm + across, arm - across)
    side = np.sqrt(np.maximum(radius * radius - along * along, 0.0)) * rng.choice((-1.0, 1.0), len(edge))
    return across, rng.uniform(-math.pi, math.pi, len(edge)), side


def _near_edge(
    exact: ExactDelta, rng: np.random.Generator, count: int, decades: tuple[float, float], *, inside: bool, place: Place
) -> tuple[Array, Array]:
    """Return points (n, 3) and their exact signed distance (n,) to the edge of reach."""
    geometry = exact.geometry
    low, high = (10.0**decade * (geometry.arm + geometry.rod) / _DEFAULT_SPAN for decade in decades)
    arrays = LimbArrays(geometry)
    arms, rods = arrays.arm[:, 0], arrays.rod[:, 0]
    clear = _CLEAR * min(arms.min(), rods.min())
    points, edges = [np.empty((0, 3))], [np.empty(0)]
    missing = count
    for _ in range(_ATTEMPTS):
        wanted = np.exp(rng.uniform(math.log(low), math.log(high), 32 * max(missing, 8))) * (1.0 if inside else -1.0)
        limbs = rng.integers(0, 3, len(wanted))
        placed = _in_base(arrays, limbs, place(arms[limbs], rods[limbs], rng, wanted))
        others = np.where(np.arange(3) == limbs[:, None], np.inf, plain_edge(geometry, placed)).min(-1)
        keep = np.flatnonzero(np.isfinite(placed).all(-1) & (others > clear))[:missing]
        for start in range(0, len(keep), _ROUND):
            chosen = keep[start : start + _ROUND]
            moved = _settle(exact, placed[chosen], limbs[chosen], wanted[chosen])
            distance = exact.edge(moved).min(-1)
            right = (distance > 0.0) if inside else (distance < 0.0)
            right &= (np.abs(distance) >= low / 2) & (np.abs(distance) <= 2 * high)
            points.append(moved[right])
            edges.append(distance[right])
            missing -= int(right.sum())
        if missing <= 0:
            break
    return np.concatenate(points), np.concatenate(edges)


def _in_base(arrays: LimbArrays, limbs: NDArray[np.int64], placement: Placement) -> Array:
    """Turn distance, angle and sideways offset of the limb aimed at into points (n, 3); NaN for none."""
    across, angle, side = placement
    across = np.where(across >= 0.0, across, np.nan)
    names = ("difference", "tangential", "motor_height", "cosine", "sine")
    inward, tangential, height, cosine, sine = (getattr(arrays, name)[limbs, 0] for name in names)
    radial, side = across * np.cos(angle) + inward, side + tangential
    height = across * np.sin(angle) - height
    return np.stack([radial * cosine - side * sine, radial * sine + side * cosine, height], axis=-1)


def _settle(exact: ExactDelta, points: Array, limbs: NDArray[np.int64], wanted: Array) -> Array:
    """Move points by units in the last place until their exact distance to the edge is closest to `wanted`."""
    geometry = exact.geometry
    rows = np.arange(len(points))
    distance = exact.edge(points)[rows, limbs]
    slopes = np.empty_like(points)
    step = 3e-7 * (geometry.arm + geometry.rod)
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        ahead, behind = plain_edge(geometry, points + shift), plain_edge(geometry, points - shift)
        slopes[:, axis] = (ahead - behind)[rows, limbs] / (2.0 * step)
    unit = np.spacing(np.abs(points))
    moves = _STEPS[None] * unit[:, None, :]
    best = np.abs(distance[:, None] + (moves * slopes[:, None, :]).sum(-1) - wanted[:, None]).argmin(-1)
    return np.asarray(points + moves[rows, best], dtype=np.float64)


def _collect(draw: Callable[[int], Array], count: int) -> Array:
    """Call `draw` until there are `count` points, or a bounded number of calls is done."""
    found = [np.empty((0, 3))]
    for _ in range(_ATTEMPTS):
        missing = count - sum(map(len, found))
        if missing <= 0:
            break
        found.append(draw(max(4 * missing, 64))[:missing])
    return np.concatenate(found)
