# SPDX-License-Identifier: Apache-2.0
"""Judges a pair of blobs by edges and depth: a pose with its covariance, or nothing.

Image alone and image with depth are fitted separately. If depth raises the squared error by more than chance explains,
the image shows bars of another size, or no bars at all: the metric gate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_vision.detector.blobs import Pair
from deltacharger_vision.detector.edges import EDGE_FOLLOW, EDGE_SEARCH, find_edges, visible_lines
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
from deltacharger_vision.detector.plane import (
    FEWEST_DEPTHS,
    KNOWN_SHARE,
    Plane,
    Region,
    fit_plane,
    is_noise,
    plate_region,
)
from deltacharger_vision.detector.support import (
    DEPTH_RISE,
    LIGHT_AROUND,
    SEEN_UNCHECKED,
    Hiding,
    hiding,
    outline_shares,
    plate_is_dark,
    supported,
)
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.terminal import Terminal, TerminalPose, facing

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
        depth_bias: as of `ElectrodeDetector`.
    """

    def __init__(
        self, grey: NDArray[Any], image: RgbdImage, terminal: Terminal, stereo_range: float, depth_bias: float
    ) -> None:
        self._grey = grey
        self._image = image
        self._terminal = terminal
        self._stereo_range, self._depth_bias = stereo_range, depth_bias
        self._corners = terminal.corners()
        self._focal = math.sqrt(image.intrinsics.fx * image.intrinsics.fy)

    def judge(self, pair: Pair) -> Candidate | None:
        """Return the pose of a pair, or None if edges do not support it or depth contradicts it."""
        intrinsics = self._image.intrinsics
        starts = by_corners(pair, self._terminal, intrinsics)
        if not starts or not 0.7 * NEAREST_TARGET < starts[0].translation[2] < 1.4 * FARTHEST_TARGET:
            return None
        limit, dark = self._dark(starts[0])
        if not dark:
            return None
        region = self._region(starts[0], limit)
        if region.share < KNOWN_SHARE:
            # Even too little depth for a plane may show that nothing is there.
            return None if self._elsewhere(region, starts[0]) else self._by_image(pair, starts[0])
        plane = fit_plane(region, self._depth_bias, np.random.default_rng(0))
        if plane is None and is_noise(region) and not self._elsewhere(region, starts[0]):
            return self._by_image(pair, starts[0])
        both = None if plane is None else self._by_both(pair, starts[0], plane)
        if both is not None or starts[0].translation[2] >= self._stereo_range:
            return both
        # Too near for stereo, depth may be noise or a corner of the plate; but another plane is a contradiction.
        if plane is not None and not agree(plane, starts[0], DEPTH_AGREEMENT):
            return None
        return self._by_image(pair, starts[0])

    def _hiding(self, edges: Edges, found: PoseFit, plane: Plane) -> Hiding:
        dark = LIGHT_AROUND
        return hiding(
            self._grey, self._image, found.pose, self._terminal, plane, edges.points.lines, found.used, dark
        )  # fmt: skip

    def _search(
        self, start: TerminalPose, pair: Pair | None, plane: Plane | None = None, least: float = math.inf
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
            followed = self._follow(pose, EDGE_SEARCH, plane, _ROUGH)
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
                followed = self._follow(before, EDGE_FOLLOW, plane)
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

    def _misfit(self, edges: Edges, found: PoseFit, plane: Plane | None = None, missed: bool = True) -> float:
        return edges.misfit(found, EDGE_NOISE, plane, missed)

    def _follow(
        self, pose: TerminalPose, window: float, plane: Plane | None = None, rounds: int = ROUNDS
    ) -> tuple[Edges, PoseFit] | None:
        """Return the edges near a pose's edges, and the pose that fits them."""
        edges = self._edges(pose, window)
        found = edges.fit(pose, plane, rounds=rounds)
        return None if found is None else (edges, found)

    def _edges(self, pose: TerminalPose, window: float) -> Edges:
        intrinsics = self._image.intrinsics
        spacing = intrinsics.fy * self._terminal.spacing / pose.translation[2]
        lines = visible_lines(pose, self._terminal, intrinsics, EDGE_BIAS)
        points = find_edges(self._grey, lines, intrinsics, min(window, max(1.5, 0.4 * spacing)))
        return Edges(points, self._terminal, self._focal)

    def _by_image(self, pair: Pair, start: TerminalPose) -> Candidate | None:
        """Return the pose by edges alone; if two tilts remain possible, its covariance spans both."""
        found = self._explained(pair, start)
        if not found:
            return None
        best, *others = found
        if self._misfit(best.edges, best.fit, missed=False) > _UNSETTLED * CLEAR_MISFIT:
            return None
        apart, upright = self._others(best, others)
        return self._candidate(best.edges, best.fit, _ALONE * best.fit.covariance + apart, False, upright)

    def _others(self, best: Explanation, others: list[Explanation], plane: Plane | None = None) -> tuple[Array, bool]:
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

    def _explained(self, pair: Pair, start: TerminalPose) -> list[Explanation]:
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

    def _with_swapped_ends(self, found: list[Explanation], plane: Plane | None = None) -> list[Explanation]:
        """Return explanations with those by the other lines at the bars' visible ends, the best first."""
        for best in sorted(found, key=lambda each: each.misfit)[:1]:
            for swapped in ends_swapped(best.fit.pose, self._terminal):
                rough = self._follow(swapped, EDGE_SEARCH, plane, _ROUGH)
                if rough is None or self._moved(best.fit.pose, rough[1].pose) < _SAME_LINES:
                    continue
                explained = self._search(rough[1].pose, None, plane, best.misfit)
                found += [each for each in explained if self._share(each.edges, each.fit)]
        return sorted(found, key=lambda each: each.misfit)

    def _by_both(self, pair: Pair, start: TerminalPose, plane: Plane) -> Candidate | None:
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

    def _depth_doubt(self, pose: TerminalPose, plane: Plane) -> Array:
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

    def _elsewhere(self, region: Region, pose: TerminalPose) -> bool:
        """Return whether known depth, within stereo's range, lies at quite another range than a pose."""
        away = float(pose.translation[2])
        if away < self._stereo_range or len(region.inverse) < FEWEST_DEPTHS:
            return False
        return abs(float(np.median(region.inverse)) * away - 1.0) > 2.0 * DEPTH_AGREEMENT

    def _dark(self, pose: TerminalPose) -> tuple[float, bool]:
        intrinsics, share = self._image.intrinsics, LIGHT_AROUND
        return plate_is_dark(self._grey, pose, self._terminal, intrinsics, share)

    def _region(self, pose: TerminalPose, limit: float) -> Region:
        intrinsics = self._image.intrinsics
        return plate_region(self._image.depth, pose, self._terminal, intrinsics, self._grey < limit)

    def _share(self, edges: Edges, found: PoseFit) -> float:
        return supported(outline_shares(edges.points, found), found)


def agree(plane: Plane, pose: TerminalPose, tolerance: float) -> bool:
    """Return whether the plane crosses the line of sight at about the range of a pose."""
    crossing = float(plane.coefficients @ pose.translation)  # 1 if exactly
    return abs(crossing - 1.0) <= tolerance
