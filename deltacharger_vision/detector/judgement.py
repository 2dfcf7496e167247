# SPDX-License-Identifier: Apache-2.0
"""Judges a pair of blobs by edges and depth: a pose with its covariance, or nothing.

Image alone and image with depth are fitted separately. If depth raises the squared error by more than chance explains,
the image shows bars of another size, or no bars at all: the metric gate.

What the image shows of a pose's bars: edges along them, and what hides their parts.
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
from deltacharger_vision.detector import blobs, observed
from deltacharger_vision.detector.fit import (
    EDGE_BIAS,
    EDGE_NOISE,
    LARGE_LEANS,
    ROUNDS,
    SMALL_LEANS,
    Edges,
    PoseFit,
    by_corners,
    ends_swapped,
    laid_over,
    leaning,
    mirrored,
    tilted,
)
from deltacharger_vision.images import Intrinsics, RgbdImage, project
from deltacharger_vision.terminal import Terminal, TerminalPose, facing

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


def outline_shares(points: observed.EdgePoints, fit: PoseFit, outer: bool = False) -> Array:
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
    plane: observed.Plane,
    lines: observed.Lines,
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
    x = 0.5 * terminal.bar_length * (2.0 * (np.arange(observed.SAMPLES) + 0.5) / observed.SAMPLES - 1.0)
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


def _beside_edges(lines: observed.Lines, used: Mask) -> Mask:
    """Return (2, SAMPLES), from −x to +x, whether edges of both long sides of each bar were found."""
    seen = np.zeros((2, 2, observed.SAMPLES), dtype=bool)
    for index in range(len(lines.bar)):
        side = int(lines.side[index])
        if side in _LONG_SIDES:
            # Corners go around a bar, so its upper side runs from +x to −x.
            seen[lines.bar[index], _LONG_SIDES.index(side)] |= used[index] if side == 0 else used[index][::-1]
    return np.asarray(seen.all(axis=1))


class _View:
    """Light and height above the plate of places in a terminal's frame."""

    def __init__(self, grey: NDArray[Any], image: RgbdImage, pose: TerminalPose, plane: observed.Plane) -> None:
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


NEAREST_TARGET = 0.08  # m, least range
FARTHEST_TARGET = 1.1  # m, largest range: beyond it the gap is less than 3 px at f = 441 px
_TILT = 1.1  # rad, largest angle between the line of sight and the normal
CLEAR_MISFIT = 60.0  # squared error below which no other start is tried
_AMBIGUOUS = 12.0  # rise of the squared error that rules out a mirrored tilt
DEPTH_AGREEMENT = 0.15  # relative difference of range by image and depth below stereo range
FOCAL_ERROR = 0.007  # relative standard deviation of the focal length
_ALONE = 1.7  # factor on the covariance by image alone, as nothing checks the tilt

_SAME_TILT = 0.03  # rad
_UNSETTLED, _NOTHING = 1.3, 5.0  # times `clear`
_HOPELESS = 3.0
EXPECTED_RISE = 3.0  # of the squared error by depth, whose plane has three parameters
_FOLLOWED = 4  # most repetitions of the edge search
_ROUGH = 5  # steps of a fit before the edges are searched again
_SAME_LINES = 1.0  # px: a start that comes so near to a pose leads to it
_SETTLED = 0.2  # px: after less movement, another edge search finds the same edges


@dataclass(frozen=True)
class Candidate:
    """A pose that the image supports.

    Attributes:
        pose: of the terminal in the optical frame.
        covariance: (6, 6) of position (m) and rotation about the optical axes (rad).
        confidence: 0 to 1.
        fused: whether depth was used.
        upright: whether the tilt is unique.
    """

    pose: TerminalPose
    covariance: Array
    confidence: float
    fused: bool
    upright: bool


@dataclass(frozen=True)
class Explanation:
    """Edges, the pose that fits them, and its squared error, including the plane's."""

    edges: Edges
    fit: PoseFit
    misfit: float


class Judge:
    """Judges pairs of blobs of one image.

    Args:
        grey: (H, W) float32, slightly smoothed.
        image: the original image.
        terminal: size of the bars.
        stereo_range: least distance (m) at which depth counts.
    """

    def __init__(self, grey: NDArray[Any], image: RgbdImage, terminal: Terminal, stereo_range: float) -> None:
        self._grey = grey
        self._image = image
        self._terminal = terminal
        self._stereo_range = stereo_range
        self._corners = terminal.corners()
        self._focal = math.sqrt(image.intrinsics.fx * image.intrinsics.fy)

    def judge(self, pair: blobs.Pair) -> Candidate | None:
        """Return the pose of a pair, or None if edges do not support it or depth contradicts it."""
        intrinsics = self._image.intrinsics
        starts = by_corners(pair, self._terminal, intrinsics)
        if not starts or not 0.7 * NEAREST_TARGET < starts[0].translation[2] < 1.4 * FARTHEST_TARGET:
            return None
        limit, dark = self._dark(starts[0])
        if not dark:
            return None
        region = self._region(starts[0], limit)
        if region.share < observed.KNOWN_SHARE:
            # Even too little depth for a plane may show that nothing is there.
            return None if self._elsewhere(region, starts[0]) else self._by_image(pair, starts[0])
        plane = observed.fit_plane(region, np.random.default_rng(0))
        if plane is None and observed.is_noise(region) and not self._elsewhere(region, starts[0]):
            return self._by_image(pair, starts[0])
        both = None if plane is None else self._by_both(pair, starts[0], plane)
        if both is not None or starts[0].translation[2] >= self._stereo_range:
            return both
        # Too near for stereo, depth may be noise or a corner of the plate; but another plane is a contradiction.
        if plane is not None and not agree(plane, starts[0], DEPTH_AGREEMENT):
            return None
        return self._by_image(pair, starts[0])

    def _hiding(self, edges: Edges, found: PoseFit, plane: observed.Plane) -> Hiding:
        dark = LIGHT_AROUND
        return hiding(
            self._grey, self._image, found.pose, self._terminal, plane, edges.points.lines, found.used, dark
        )  # fmt: skip

    def _search(
        self, start: TerminalPose, pair: blobs.Pair | None, plane: observed.Plane | None = None, least: float = math.inf
    ) -> list[Explanation]:
        """Return edges and the poses that fit them, from a start with the right tilt and a rough position.

        First the start is laid over the pair's blobs. A start is abandoned if it soon fits far worse than `least`, the
        squared error of another explanation.
        """
        found: list[Explanation] = []
        for sides in (True, False) if pair is not None else (True,):
            pose = start
            if pair is not None:
                pose = laid_over(start, pair, self._terminal, self._image.intrinsics, sides)
            followed = self._follow(pose, observed.EDGE_SEARCH, plane, _ROUGH)
            settled = False
            for round_ in range(_FOLLOWED + 1):
                hopeless = _HOPELESS * least + _AMBIGUOUS
                if followed is None or self._misfit(*followed, plane) > (4.0 if round_ == 0 else 1.0) * hopeless:
                    followed = None
                    break
                if settled or round_ == _FOLLOWED:
                    break
                if round_ > 1 and self._misfit(*followed, missed=False) < CLEAR_MISFIT:
                    break
                before = followed[1].pose
                followed = self._follow(before, observed.EDGE_FOLLOW, plane)
                settled = followed is not None and self._moved(before, followed[1].pose) < _SETTLED
            if followed is None:
                if round_ == 0 and math.isfinite(least):  # at this tilt the other silhouette would not fit either
                    break
                continue
            found.append(Explanation(*followed, self._misfit(*followed, plane)))
            least = min(least, found[-1].misfit)
            if self._misfit(*followed, missed=False) < CLEAR_MISFIT and self._share(*followed):
                break
        return sorted(found, key=lambda each: each.misfit)

    def _moved(self, before: TerminalPose, after: TerminalPose) -> float:
        """Return the largest movement of the bars' corners in the image between two poses, px."""
        one, two = (pose.points(self._corners) for pose in (before, after))
        return self._focal * float(np.abs(one[..., :2] / one[..., 2:] - two[..., :2] / two[..., 2:]).max())

    def _misfit(self, edges: Edges, found: PoseFit, plane: observed.Plane | None = None, missed: bool = True) -> float:
        return edges.misfit(found, EDGE_NOISE, plane, missed)

    def _follow(
        self, pose: TerminalPose, window: float, plane: observed.Plane | None = None, rounds: int = ROUNDS
    ) -> tuple[Edges, PoseFit] | None:
        """Return the edges near a pose's edges, and the pose that fits them."""
        edges = self._edges(pose, window)
        found = edges.fit(pose, plane, rounds=rounds)
        return None if found is None else (edges, found)

    def _edges(self, pose: TerminalPose, window: float) -> Edges:
        intrinsics = self._image.intrinsics
        spacing = intrinsics.fy * self._terminal.spacing / pose.translation[2]
        lines = observed.visible_lines(pose, self._terminal, intrinsics, EDGE_BIAS)
        points = observed.find_edges(self._grey, lines, intrinsics, min(window, max(1.5, 0.4 * spacing)))
        return Edges(points, self._terminal, self._focal)

    def _by_image(self, pair: blobs.Pair, start: TerminalPose) -> Candidate | None:
        """Return the pose by edges alone; if two tilts remain possible, its covariance spans both."""
        found = self._explained(pair, start)
        if not found:
            return None
        best, *others = found
        if self._misfit(best.edges, best.fit, missed=False) > _UNSETTLED * CLEAR_MISFIT:
            return None
        apart, upright = self._others(best, others)
        return self._candidate(best.edges, best.fit, _ALONE * best.fit.covariance + apart, False, upright)

    def _others(
        self, best: Explanation, others: list[Explanation], plane: observed.Plane | None = None
    ) -> tuple[Array, bool]:
        """Return the covariance (6, 6) by explanations that are almost as likely, and whether their tilt is one."""
        shown = self._misfit(best.edges, best.fit, plane, missed=False)
        excess = max(1.0, shown / CLEAR_MISFIT)
        covariance, upright = np.zeros((6, 6)), True
        for other in others:
            # A side too dim for an edge is weak evidence against the lines of another end.
            rises = (other.misfit - best.misfit, self._misfit(other.edges, other.fit, plane, missed=False) - shown)
            if (rise := max(0.0, min(rises)) / excess) < _AMBIGUOUS:
                turned = np.cross(best.fit.pose.rotation[:, 2], other.fit.pose.rotation[:, 2])
                step = np.concatenate([other.fit.pose.translation - best.fit.pose.translation, turned])
                likely = math.exp(-0.5 * rise)
                covariance += np.outer(step, step) * likely / (1.0 + likely)
                upright = upright and bool(np.linalg.norm(turned) < _SAME_TILT)
        return covariance, upright

    def _explained(self, pair: blobs.Pair, start: TerminalPose) -> list[Explanation]:
        """Return poses that fit the edges; try more tilts until one fits well.

        Another tilt shows other sides of the bars, so each is fitted to its own edges.
        """
        found: list[Explanation] = []
        nearest = math.inf
        for limit, leans in ((0.0, None), (1.2, SMALL_LEANS), (3.0, LARGE_LEANS)):
            best = min(found, key=lambda each: each.misfit, default=None)
            least = math.inf if best is None else best.misfit
            if least < limit * CLEAR_MISFIT or (leans is not None and nearest > _NOTHING * CLEAR_MISFIT):
                break
            if leans is None:
                tries = [start, mirrored(start)]
            else:
                centre = start if best is None else best.fit.pose
                tries = leaning(centre, leans, pair, self._image.intrinsics)
            for tried in tries:
                least = min((each.misfit for each in found), default=math.inf)
                explained = self._search(tried, pair, least=least)
                nearest = min([nearest, *(each.misfit for each in explained)])
                found += [each for each in explained if self._share(each.edges, each.fit)]
        return self._with_swapped_ends(found)

    def _with_swapped_ends(self, found: list[Explanation], plane: observed.Plane | None = None) -> list[Explanation]:
        """Return explanations with those by the other lines at the bars' visible ends, the best first."""
        for best in sorted(found, key=lambda each: each.misfit)[:1]:
            for swapped in ends_swapped(best.fit.pose, self._terminal):
                rough = self._follow(swapped, observed.EDGE_SEARCH, plane, _ROUGH)
                if rough is None or self._moved(best.fit.pose, rough[1].pose) < _SAME_LINES:
                    continue
                explained = self._search(rough[1].pose, None, plane, best.misfit)
                found += [each for each in explained if self._share(each.edges, each.fit)]
        return sorted(found, key=lambda each: each.misfit)

    def _by_both(self, pair: blobs.Pair, start: TerminalPose, plane: observed.Plane) -> Candidate | None:
        """Return the pose by edges and plane, unless the plane contradicts the edges."""
        exact, plane = plane, plane.with_bias()
        # The plane gives the tilt, and so the visible sides of the bars.
        found = self._search(tilted(start, plane.coefficients, pair, self._image.intrinsics), pair, plane)
        if not found:
            return None
        best, *others = self._with_swapped_ends(found[:1], plane)
        shown = self._hiding(best.edges, best.fit, plane)
        if shown.refuted or (shown.off and not shown.ends.all()):
            return None
        edges, fused = best.edges, best.fit if shown.ends.all() else None
        if fused is None:
            # Without its ends a bar has no length that tells the range, but what hides it seems to.
            edges, plane = edges.without_ends(shown.ends), exact
            fused = edges.fit(best.fit.pose, plane)
        alone = None if fused is None else edges.fit(fused.pose)
        if fused is None or alone is None:
            return None
        rise = edges.misfit(fused, alone.scatter, plane) - edges.misfit(alone, alone.scatter)
        if not rise <= DEPTH_RISE:
            return None
        covariance = max(1.0, rise / EXPECTED_RISE) * fused.covariance + self._others(best, others, plane)[0]
        return self._candidate(edges, fused, covariance + self._depth_doubt(fused.pose, plane), True, True)

    def _depth_doubt(self, pose: TerminalPose, plane: observed.Plane) -> Array:
        """Return the covariance (6, 6) by the plane's bias, and by the scale at which image and depth differ."""
        distance = float(pose.rotation[:, 2] @ pose.translation) + self._terminal.bar_thickness
        apart = 1.0 / (distance * float(np.linalg.norm(plane.coefficients))) - 1.0
        covariance = plane.bias**2 * np.eye(6)
        covariance[:3, :3] = (plane.bias**2 + apart**2) * np.outer(pose.translation, pose.translation)
        return covariance

    def _candidate(
        self, edges: Edges, found: PoseFit, covariance: Array, fused: bool, upright: bool
    ) -> Candidate | None:
        pose = found.pose
        away = float(np.linalg.norm(pose.translation))
        in_range = NEAREST_TARGET <= away <= FARTHEST_TARGET and facing(pose) >= math.cos(_TILT)
        confidence = self._share(edges, found)
        if not in_range or confidence <= (0.0 if fused else SEEN_UNCHECKED) or not np.all(np.isfinite(covariance)):
            return None
        if not self._dark(pose)[1]:
            return None
        # If edges fit worse than their noise explains, something is wrong with them (Birge's ratio).
        excess = self._misfit(edges, found, missed=False) / CLEAR_MISFIT
        return Candidate(pose, covariance * max(1.0, excess), confidence, fused, upright)

    def _elsewhere(self, region: observed.Region, pose: TerminalPose) -> bool:
        """Return whether known depth, within stereo's range, lies at quite another range than a pose."""
        away = float(pose.translation[2])
        if away < self._stereo_range or len(region.inverse) < observed.FEWEST_DEPTHS:
            return False
        return abs(float(np.median(region.inverse)) * away - 1.0) > 2.0 * DEPTH_AGREEMENT

    def _dark(self, pose: TerminalPose) -> tuple[float, bool]:
        intrinsics, share = self._image.intrinsics, LIGHT_AROUND
        return plate_is_dark(self._grey, pose, self._terminal, intrinsics, share)

    def _region(self, pose: TerminalPose, limit: float) -> observed.Region:
        intrinsics = self._image.intrinsics
        return observed.plate_region(self._image.depth, pose, self._terminal, intrinsics, self._grey < limit)

    def _share(self, edges: Edges, found: PoseFit) -> float:
        return supported(outline_shares(edges.points, found), found)


def agree(plane: observed.Plane, pose: TerminalPose, tolerance: float) -> bool:
    """Return whether the plane crosses the line of sight at about the range of a pose."""
    crossing = float(plane.coefficients @ pose.translation)  # 1 if exactly
    return abs(crossing - 1.0) <= tolerance
