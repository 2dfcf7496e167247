# SPDX-License-Identifier: Apache-2.0
"""Poses of partly hidden bars on the plane of their plate, from visible parts only.

A cable or a strap cuts a bar into pieces, and an end of a piece need not be an end of a bar. The plate's plane gives
the bars' distance, and so their length in the image. Each end visible beside the plate then fixes their position.
There is no result if the plate is visible where a pose has a bar, if a bar continues beyond its end, or if two poses
explain the image.
"""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Mask
from deltacharger_vision.detector.judgement import (
    CLEAR_MISFIT,
    DEPTH_AGREEMENT,
    EXPECTED_RISE,
    FARTHEST_TARGET,
    NEAREST_TARGET,
    Candidate,
    Explanation,
    Judge,
    agree,
)
from deltacharger_vision.detector.outlines import Lines
from deltacharger_vision.detector.pairing import Pair
from deltacharger_vision.detector.plane import Plane, fit_plane
from deltacharger_vision.detector.starts import by_spacing, on_plane
from deltacharger_vision.detector.support import (
    DEPTH_RISE,
    END_SEEN,
    LARGEST_SCATTER,
    SIDE_SEEN,
    SIDES_SEEN,
    outline_shares,
)

_LONG, _ENDS = (0, 2), (1, 3)
_LEAST_ENDS = 2  # of four must be beside the plate
_MESSY = 1.2  # times `clear`: a squared error that pieces do not explain


class PartsJudge(Judge):
    """A judge that also handles pairs of pieces."""

    def judge_cut(self, pair: Pair) -> list[Candidate]:
        """Return the poses of partly hidden bars on the plate's plane; none if depth shows no plane."""
        intrinsics = self._image.intrinsics
        start = by_spacing(pair, self._terminal, intrinsics)
        if not 0.7 * NEAREST_TARGET < start.translation[2] < 1.4 * FARTHEST_TARGET:
            return []
        region = self._region(start, self._dark(start)[0])
        plane = fit_plane(region, self._depth_bias, np.random.default_rng(0))
        if plane is None or not agree(plane, start, 3.0 * DEPTH_AGREEMENT):
            return []
        found = []
        for pose in on_plane(start, plane.coefficients, pair, self._terminal, intrinsics):
            for each in self._search(pose, None, plane)[:1]:
                if (candidate := self._by_parts(each, plane)) is not None:
                    found.append(candidate)
        return found

    def _by_parts(self, explained: Explanation, plane: Plane) -> Candidate | None:
        """Return the pose by visible parts of the bars, unless the plate is visible where they should be."""
        edges, fused = explained.edges, explained.fit
        shown = self._hiding(edges, fused, plane)
        # A bar with a visible side ends where the side ends: the face's edge alone may be the other bar's.
        ends, any_line = (
            shown.ends & (outline_shares(edges.points, fused, outer)[:, _ENDS] >= END_SEEN) for outer in (True, False)
        )
        # Between a bar and the plate there is an edge, or the bar ends elsewhere.
        if shown.refuted or shown.off or int(ends.sum()) < _LEAST_ENDS or np.any(shown.ends & ~any_line):
            return None
        # An edge at the end of a piece beside anything but the plate belongs to that thing.
        kept = edges.without_ends(shown.ends)
        both = kept.fit(fused.pose, plane)
        alone = None if both is None else kept.fit(both.pose)
        if both is None or alone is None:
            return None
        rise = kept.misfit(both, alone.scatter, plane) - kept.misfit(alone, alone.scatter)
        if not rise <= DEPTH_RISE or both.scatter > LARGEST_SCATTER:
            return None
        shares = outline_shares(kept.points, both)
        sides = shares[:, _LONG]
        if sides.min() < SIDE_SEEN or sides.mean() < SIDES_SEEN:
            return None
        excess = self._misfit(kept, both, missed=False) / CLEAR_MISFIT
        if excess > _MESSY:
            return None
        covariance = both.covariance * max(1.0, rise / EXPECTED_RISE, excess) + self._depth_doubt(both.pose, plane)
        if not ends.any(axis=0).all():
            # With one end only, it is unknown whether its face's edge or its side's root is visible.
            unsure = self._side_seen(edges.points.lines, ends) * both.pose.translation[2] / self._focal
            axis = both.pose.rotation[:, 0]
            covariance[:3, :3] += unsure**2 * np.outer(axis, axis)
        return Candidate(both.pose, covariance, float(shares.mean()), True, True)

    @staticmethod
    def _side_seen(lines: Lines, ends: Mask) -> float:
        """Return the width (px) of the sides visible beside the ends (2, 2) that are True."""
        two = np.isfinite(lines.room) & np.isin(lines.side, np.asarray(_ENDS)[ends.any(axis=0)])
        return float(lines.room[two].max(initial=0.0))
