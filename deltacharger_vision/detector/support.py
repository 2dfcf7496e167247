# SPDX-License-Identifier: Apache-2.0
"""What the image shows of a pose's bars: edges along them, and what hides their parts.

Finds hidden and missing parts of a terminal: checks whether places beside edges look like its plate.
Beside the plate, an end is the end of a bar; beside anything else, something hides the rest of the bar. Where a pose
has a bar, the plate must not be visible. The plate is dark and behind; what hides a bar is bright or in front of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.detector.edges import SAMPLES, EdgePoints, Lines
from deltacharger_vision.detector.fit import PoseFit
from deltacharger_vision.detector.plane import Plane
from deltacharger_vision.images import Intrinsics, RgbdImage, project
from deltacharger_vision.terminal import Terminal, TerminalPose

_SEEN = 0.55  # least visible share of both outlines
SEEN_UNCHECKED = 0.8  # least visible share of both outlines if no depth checks the pose
_WHOLE = 0.75  # least visible share of the clearer bar's outline
SIDE_SEEN = 0.15  # least visible share of each long side of the other bar
SIDES_SEEN = 0.4  # least visible share of all long sides of partly hidden bars
END_SEEN = 0.5  # least visible share of each end of the clearer bar
LARGEST_SCATTER = 1.0  # px, largest scatter of the edge points
LIGHT_AROUND = 0.45  # largest light above and below the bars, relative to theirs
DEPTH_RISE = 30.0  # largest rise of the squared error when depth is added

_LONG, _ENDS = (0, 2), (1, 3)


def outline_shares(points: EdgePoints, fit: PoseFit, outer: bool = False) -> Array:
    """Return the visible share (2, 4) of each side of each bar; 0 outside the image.

    Args:
        points: the edge points.
        fit: the pose.
        outer: count only the outermost line of each side.
    """
    shares = np.zeros((2, 4))
    lines = points.lines
    for index in np.flatnonzero(lines.outer) if outer else range(len(lines.bar)):
        share = float(np.mean(fit.used[index]))
        # Either line of a side suffices.
        bar, side = lines.bar[index], lines.side[index]
        shares[bar, side] = max(shares[bar, side], share)
    return shares


def plate_is_dark(
    grey: NDArray[Any], pose: TerminalPose, terminal: Terminal, intrinsics: Intrinsics, share: float
) -> tuple[float, bool]:
    """Return `share` of the bars' light (H, W), and whether the image is darker where a third bar would be."""
    places = np.linspace(-0.4, 0.4, 9) * terminal.bar_length
    rows = np.array([-1.5, -0.5, 0.5, 1.5]) * terminal.spacing
    points = np.stack(np.broadcast_arrays(places, rows[:, None], 0.0), axis=-1)
    points[[0, 3], :, 2] = terminal.bar_thickness
    pixels = np.round(project(pose.points(points), intrinsics)).astype(int)
    height, width = grey.shape
    inside = np.all((pixels >= 0) & (pixels < [width, height]), axis=-1)
    pixels = np.clip(pixels, 0, [width - 1, height - 1])
    light = np.where(inside, grey[pixels[..., 1], pixels[..., 0]].astype(float), np.nan)
    bars = light[1:3][inside[1:3]]
    if not len(bars):
        return math.inf, False
    limit = share * float(np.median(bars))
    return limit, all(not inside[row].any() or float(np.nanmedian(light[row])) < limit for row in (0, 3))


def supported(shares: Array, fit: PoseFit) -> float:
    """Return the visible share (0 to 1) of the outlines, or 0 if that is too little for a pose."""
    long_sides, ends = shares[:, _LONG], shares[:, _ENDS]
    bars = 0.7 * long_sides.mean(axis=1) + 0.3 * ends.mean(axis=1)
    clear = int(np.argmax(bars))
    overall = float(bars.mean())
    enough = (
        overall >= _SEEN
        and bars[clear] >= _WHOLE
        and long_sides[1 - clear].min() >= SIDE_SEEN
        and ends[clear].min() >= END_SEEN
        and fit.scatter <= LARGEST_SCATTER
    )
    return overall if enough else 0.0


_LONG_SIDES = 0, 2
_ROWS = np.array([-0.25, 0.0, 0.25])  # of a bar's height
_BESIDE = np.array([3.0, 4.5, 6.0])  # px beyond an end: nearer, stereo smears the bar's depth
_WITHIN = np.array([1.5, 3.0, 4.5])  # px before it
_BEHIND = 0.5  # of the bars' thickness: less height above the plate counts as plate
_EMPTY = 3  # places of 2 × SAMPLES that may look like plate by chance
_ALIKE = 4.0  # of these places share the noise of depth
_LEAST = 8  # of these places must show bars
_CERTAIN = 2.0  # standard deviations


@dataclass(frozen=True)
class Hiding:
    """Appearance of a terminal's surroundings and faces in image and depth.

    Attributes:
        ends: (2, 2) whether each end of each bar, at +x and at −x, is beside the plate.
        refuted: whether the plate is visible where the bars should be, or a bar where the plate should be.
        off: whether known depth of the bars' faces differs from a bar's thickness above the plate.
    """

    ends: Mask
    refuted: bool
    off: bool


def hiding(
    grey: NDArray[Any],
    image: RgbdImage,
    pose: TerminalPose,
    terminal: Terminal,
    plane: Plane,
    lines: Lines,
    used: Mask,
    dark: float,
) -> Hiding:
    """Check a terminal for hidden parts.

    Args:
        grey: (H, W) light.
        image: with depth.
        pose: of the terminal.
        terminal: its size.
        plane: plane of the plate.
        lines: visible lines at the pose.
        used: (L, S) places of these lines with an edge.
        dark: largest light of the plate, relative to the bars'.
    """
    view = _View(grey, image, pose, plane)
    bars = np.array([-0.5, 0.5]) * terminal.spacing
    y = bars[:, None] + terminal.bar_height * _ROWS
    x = 0.5 * terminal.bar_length * (2.0 * (np.arange(SAMPLES) + 0.5) / SAMPLES - 1.0)
    light, raised = view.at(x[None, :, None], y[:, None, :], 0.0)
    light, raised = view.middle(light, 2), view.middle(raised, 2)
    # At a slant, half of the area between the bars is a side of one of them.
    rows = terminal.spacing * np.array([[-1.0], [0.0], [1.0]])
    between, _ = view.at(x, rows, 0.5 * terminal.bar_thickness)
    seen = _beside_edges(lines, used)
    limit = dark * float(np.median(light[seen])) if seen.any() else 0.0
    seen &= (between[:2] < limit) & (between[1:] < limit) & (light > limit)
    behind = _BEHIND * terminal.bar_thickness
    if seen.sum() < _LEAST:
        return Hiding(np.zeros((2, 2), dtype=bool), True, True)
    known = raised[seen & np.isfinite(raised)]
    unsure = _BEHIND * terminal.bar_thickness + _CERTAIN * view.noise / np.sqrt(max(1.0, len(known) / _ALIKE))
    # If noise hides the difference between bars and plate, depth does not show what lies in front of them.
    apart = abs(float(np.median(known)) - terminal.bar_thickness) if len(known) >= _LEAST else 0.0
    off = bool(view.noise > terminal.bar_thickness or apart > unsure)
    empty = ~seen & (light < limit) & ~(raised > behind)
    ends, longer = _ends(view, terminal, image.intrinsics.fx, y, limit)
    return Hiding(ends, longer or int(empty.sum()) > _EMPTY, off)


def _ends(view: _View, terminal: Terminal, focal: float, y: Array, limit: float) -> tuple[Mask, bool]:
    """Return which ends (2, 2) of bars with rows at y (2, 3) m are beside the plate, and whether a bar continues."""
    pose, rows = view.pose, terminal.spacing * np.array([[-1.0], [0.0], [1.0]])
    pixel, camera = pose.translation[2] / focal, -pose.rotation.T @ pose.translation
    ends, longer = np.zeros((2, 2), dtype=bool), False
    for side, sign in enumerate((1.0, -1.0)):
        end = 0.5 * sign * terminal.bar_length
        # If the end's own side is visible, the plate begins at its root.
        root = terminal.bar_thickness if sign * camera[0] > 0.5 * terminal.bar_length else 0.0
        beyond, before = (
            view.at(end + sign * pixel * steps[None, :, None], y[:, None, :], depth)
            for steps, depth in ((_BESIDE, root), (-_WITHIN, 0.0))
        )
        height, bright = view.middle(beyond[1].reshape(2, -1), 1), np.any(view.middle(beyond[0], 2) > limit, axis=1)
        around = view.middle(view.at(end + sign * pixel * _BESIDE, rows, 0.5 * root)[0], 1) < limit
        longer |= bool(np.any(bright & around[:2] & around[1:]))
        plate = ~bright & (height < _BEHIND * terminal.bar_thickness + _CERTAIN * view.noise)
        ends[:, side] = plate & (view.middle(before[0].reshape(2, -1), 1) > limit)
    return ends, longer


def _beside_edges(lines: Lines, used: Mask) -> Mask:
    """Return (2, SAMPLES), from −x to +x, whether edges of both long sides of each bar were found."""
    seen = np.zeros((2, 2, SAMPLES), dtype=bool)
    for index in range(len(lines.bar)):
        side = int(lines.side[index])
        if side in _LONG_SIDES:
            # Corners go around a bar, so its upper side runs from +x to −x.
            seen[lines.bar[index], _LONG_SIDES.index(side)] |= used[index] if side == 0 else used[index][::-1]
    return np.asarray(seen.all(axis=1))


class _View:
    """Light and height above the plate of places in a terminal's frame."""

    def __init__(self, grey: NDArray[Any], image: RgbdImage, pose: TerminalPose, plane: Plane) -> None:
        self._grey, self._image, self.pose, self._plane = grey, image, pose, plane
        away = float(pose.translation[2])
        self.noise = plane.scatter * away**2
        """m, standard deviation of one height; neighbouring places correlate."""

    def at(self, x: Array, y: Array, z: float) -> tuple[Array, Array]:
        """Return light and height (m, NaN = unknown) at places (m), NaN outside the image."""
        points = np.stack(np.broadcast_arrays(x, y, np.float64(z)), axis=-1)
        pixels = np.round(project(self.pose.points(points), self._image.intrinsics)).astype(int)
        height, width = self._grey.shape
        inside = np.all((pixels >= 0) & (pixels < [width, height]), axis=-1)
        column, row = np.moveaxis(np.clip(pixels, 0, [width - 1, height - 1]), -1, 0)
        light = np.where(inside, self._grey[row, column].astype(float), np.nan)
        depth = np.where(inside, self._image.depth[row, column].astype(float), np.nan)
        ray = self.pose.points(points)
        ray = ray / ray[..., 2:]
        plate = 1.0 / np.maximum(ray @ self._plane.coefficients, 1e-6)
        return light, (plate - depth) * float(self.pose.rotation[2, 2])

    @staticmethod
    def middle(values: Array, axis: int) -> Array:
        """Return the median of the known values, −inf if none is known."""
        known = np.isfinite(values)
        filled = np.where(known, values, np.inf)
        order = np.sort(filled, axis=axis)
        index = np.maximum((known.sum(axis=axis) - 1) // 2, 0)
        found = np.take_along_axis(order, np.expand_dims(index, axis), axis=axis).squeeze(axis)
        return np.where(np.isfinite(found), found, -np.inf)
