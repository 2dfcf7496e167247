# SPDX-License-Identifier: Apache-2.0
"""Finds the pose of a terminal's two electrodes in an RGB-D image, or None.

Blobs → pairs → corners (IPPE) → edges → plane of the plate → one least-squares fit of edges and plane → judgement.
If that fails: pieces between edges → pairs of lines → positions on the plate's plane → edges → judgement.
A pose without visible outlines, or contradicted by depth, is not returned.

Poses of partly hidden bars on the plane of their plate, from visible parts only.
A cable or a strap cuts a bar into pieces, and an end of a piece need not be an end of a bar. The plate's plane gives
the bars' distance, and so their length in the image. Each end visible beside the plate then fixes their position.
There is no result if the plate is visible where a pose has a bar, if a bar continues beyond its end, or if two poses
explain the image.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision import errors, images, mount
from deltacharger_vision.detector import blobs, fit, judgement, observed
from deltacharger_vision.terminal import Detection, Terminal, cross_matrix

_LONG, _ENDS = (0, 2), (1, 3)
_LEAST_ENDS = 2  # of four must be beside the plate
_MESSY = 1.2  # times `clear`: a squared error that pieces do not explain


class PartsJudge(judgement.Judge):
    """A judge that also handles pairs of pieces."""

    def judge_cut(self, pair: blobs.Pair) -> list[judgement.Candidate]:
        """Return the poses of partly hidden bars on the plate's plane; none if depth shows no plane."""
        intrinsics = self._image.intrinsics
        start = fit.by_spacing(pair, self._terminal, intrinsics)
        if not 0.7 * judgement.NEAREST_TARGET < start.translation[2] < 1.4 * judgement.FARTHEST_TARGET:
            return []
        region = self._region(start, self._dark(start)[0])
        plane = observed.fit_plane(region, np.random.default_rng(0))
        if plane is None or not judgement.agree(plane, start, 3.0 * judgement.DEPTH_AGREEMENT):
            return []
        found = []
        for pose in fit.on_plane(start, plane.coefficients, pair, self._terminal, intrinsics):
            for each in self._search(pose, None, plane)[:1]:
                if (candidate := self._by_parts(each, plane)) is not None:
                    found.append(candidate)
        return found

    def _by_parts(self, explained: judgement.Explanation, plane: observed.Plane) -> judgement.Candidate | None:
        """Return the pose by visible parts of the bars, unless the plate is visible where they should be."""
        edges, fused = explained.edges, explained.fit
        shown = self._hiding(edges, fused, plane)
        # A bar with a visible side ends where the side ends: the face's edge alone may be the other bar's.
        ends, any_line = (
            shown.ends & (judgement.outline_shares(edges.points, fused, outer)[:, _ENDS] >= judgement.END_SEEN)
            for outer in (True, False)
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
        if not rise <= judgement.DEPTH_RISE or both.scatter > judgement.LARGEST_SCATTER:
            return None
        shares = judgement.outline_shares(kept.points, both)
        sides = shares[:, _LONG]
        if sides.min() < judgement.SIDE_SEEN or sides.mean() < judgement.SIDES_SEEN:
            return None
        excess = self._misfit(kept, both, missed=False) / judgement.CLEAR_MISFIT
        if excess > _MESSY:
            return None
        covariance = both.covariance * max(1.0, rise / judgement.EXPECTED_RISE, excess) + self._depth_doubt(
            both.pose, plane
        )
        if not ends.any(axis=0).all():
            # With one end only, it is unknown whether its face's edge or its side's root is visible.
            unsure = self._side_seen(edges.points.lines, ends) * both.pose.translation[2] / self._focal
            axis = both.pose.rotation[:, 0]
            covariance[:3, :3] += unsure**2 * np.outer(axis, axis)
        return judgement.Candidate(both.pose, covariance, float(shares.mean()), True, True)

    @staticmethod
    def _side_seen(lines: observed.Lines, ends: Mask) -> float:
        """Return the width (px) of the sides visible beside the ends (2, 2) that are True."""
        two = np.isfinite(lines.room) & np.isin(lines.side, np.asarray(_ENDS)[ends.any(axis=0)])
        return float(lines.room[two].max(initial=0.0))


_SMOOTHING = 0.6  # px, standard deviation of the blur before edges are searched
_SURE = 0.8  # confidence at which the search ends
_NORMAL_STDDEV = 0.06  # rad, largest standard deviation of a reported normal

_LARGEST = 1_100_000  # px that are searched, such as 1280 × 800: time and memory are those of a small image
_APART = 4.0  # standard deviations beyond which two poses differ
_LINEAR = (255.0 * images.LIGHT).astype(np.float32)


class ElectrodeDetector:
    """Finds two bright bars of known size on a dark plate.

    Args:
        terminal: size of the bars.
        stereo_range: least distance (m) at which depth counts.
    """

    def __init__(self, terminal: Terminal | None = None, stereo_range: float = images.NEAREST_DEPTH) -> None:
        self.terminal = terminal or Terminal()
        self._stereo_range = stereo_range

    def detect(self, image: images.RgbdImage) -> Detection | None:
        """Return the terminal with the best support in the image, or None. Deterministic.

        Raises:
            CameraInfoError: the lens's distortion is not one-to-one over the image.
        """
        import cv2

        intrinsics = image.intrinsics
        image = _reduced(image)
        too_near = image.depth < self._stereo_range
        image = replace(image, depth=np.where(too_near, np.float32(np.nan), image.depth))
        grey = np.asarray(cv2.cvtColor(image.color, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        # An edge lies at half the light, not at half its encoded value.
        smooth = cv2.GaussianBlur(cv2.LUT(grey, _LINEAR), (0, 0), _SMOOTHING)
        images.check_lens(image.intrinsics)
        judge = PartsJudge(smooth, image, self.terminal, self._stereo_range)
        best: judgement.Candidate | None = None
        for pair in blobs.find_pairs(blobs.find_blobs(grey), self.terminal):
            if best is not None and self._covers(best, pair, image.intrinsics):
                continue
            try:
                candidate = judge.judge(pair)
            except errors.CameraInfoError:  # a cut bar is completed beyond the lens's view
                continue
            if candidate is not None and (best is None or candidate.confidence > best.confidence):
                best = candidate
                if best.confidence >= _SURE:
                    break
        if best is None:
            best = self._in_pieces(image, judge)
        return None if best is None else self._detection(best, intrinsics)

    def _in_pieces(self, image: images.RgbdImage, judge: PartsJudge) -> judgement.Candidate | None:
        """Return a partly hidden terminal, or None if two poses explain the image."""
        found = []
        pieces = blobs.find_pieces(image.color)
        for pair in blobs.find_cut_pairs(pieces, self.terminal):
            try:
                found += judge.judge_cut(pair)
            except errors.CameraInfoError:
                continue
        best = max(found, key=lambda each: each.confidence, default=None)
        if best is None or any(_differ(best, each) for each in found):
            return None
        return best

    def _covers(self, found: judgement.Candidate, pair: blobs.Pair, intrinsics: images.Intrinsics) -> bool:
        """Return whether a pair lies on a found terminal: no other can be there."""
        middle, end = np.zeros(3), np.array([0.5 * self.terminal.bar_length, 0.0, 0.0])
        here, there = images.project(found.pose.points(np.stack([middle, end])), intrinsics)
        return bool(np.hypot(*(pair.centre.mean(axis=0) - here)) < np.hypot(*(there - here)))

    def _detection(self, found: judgement.Candidate, intrinsics: images.Intrinsics) -> Detection:
        pose = found.pose
        x, y = pose.rotation[0, 0], pose.rotation[1, 0]
        roll = mount.line_angle(x, y)
        turning = cross_matrix(pose.rotation[:, 2])
        spread = turning @ found.covariance[3:, 3:] @ turning.T
        # If expected depth is missing, two tilts in a hundred are off by far more than the edges show.
        checked = found.fused or pose.translation[2] < self._stereo_range
        known = math.sqrt(float(np.linalg.eigvalsh(spread)[-1])) <= _NORMAL_STDDEV
        covariance = found.covariance.copy()
        # A longer focal length moves everything away in proportion, and nothing aside.
        covariance[2, 2] += (judgement.FOCAL_ERROR * pose.translation[2]) ** 2
        return Detection(
            position=pose.translation,
            roll=roll,
            axis=pose.rotation[:, 0] * math.copysign(1.0, x * math.cos(roll) + y * math.sin(roll)),
            normal=-pose.rotation[:, 2] if found.upright and checked and known else np.full(3, np.nan),
            covariance=covariance,
            confidence=found.confidence,
            range=float(np.linalg.norm(pose.translation)),
            bars=images.project(pose.points(self.terminal.corners()), intrinsics),
            source="both" if found.fused else "image",
        )


def _reduced(image: images.RgbdImage) -> images.RgbdImage:
    """Return a large image averaged over squares, with the depth of their middles; others unchanged."""
    import cv2

    intrinsics = image.intrinsics
    side = math.ceil(math.sqrt(intrinsics.width * intrinsics.height / _LARGEST))
    if side == 1:
        return image
    width, height = intrinsics.width // side, intrinsics.height // side
    color = cv2.resize(image.color[: height * side, : width * side], (width, height), interpolation=cv2.INTER_AREA)
    depth = image.depth[side // 2 : height * side : side, side // 2 : width * side : side]
    return images.RgbdImage(np.asarray(color, dtype=np.uint8), depth, intrinsics.binned(side, side))


def _differ(one: judgement.Candidate, other: judgement.Candidate) -> bool:
    """Return whether two poses differ by more than their covariances explain."""
    apart = one.pose.translation - other.pose.translation
    spread = one.covariance[:3, :3] + other.covariance[:3, :3]
    return float(apart @ np.linalg.solve(spread, apart)) > _APART**2


_GREEN, _RED = (60, 220, 60), (230, 60, 60)
_FRACTION = 4  # binary digits after the point of drawn coordinates
_ARROW = 0.03  # m


def annotated(image: images.RgbdImage, found: Detection | None) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 RGB: the bars' outlines, their midpoint, the normal if known, and the figures.

    The image itself is not changed.
    """
    import cv2

    picture = np.ascontiguousarray(image.color).copy()
    if found is None:
        _write(picture, ["no electrodes found"])
        return picture
    outlines = [np.round(bar * 2**_FRACTION).astype(np.int32) for bar in found.bars]
    cv2.polylines(picture, outlines, True, _GREEN, 1, cv2.LINE_AA, _FRACTION)
    middle = _pixel(found.position, image.intrinsics)
    cv2.drawMarker(picture, middle, _RED, cv2.MARKER_CROSS, 11, 1, cv2.LINE_AA)
    if np.all(np.isfinite(found.normal)):
        tip = _pixel(found.position + _ARROW * found.normal, image.intrinsics)
        cv2.arrowedLine(picture, middle, tip, _RED, 1, cv2.LINE_AA)
    spread = 1e3 * np.sqrt(np.diag(found.covariance)[:3])
    x, y, z = 1e3 * found.position
    lines = [
        f"x {x:.1f}  y {y:.1f}  z {z:.1f} mm",
        f"+- {spread[0]:.2f}  {spread[1]:.2f}  {spread[2]:.2f} mm",
        f"roll {math.degrees(found.roll):.2f} deg  confidence {found.confidence:.2f}  {found.source}",
    ]
    _write(picture, lines)
    return picture


def _pixel(point: Array, intrinsics: images.Intrinsics) -> tuple[int, int]:
    x, y = np.clip(np.round(images.project(point, intrinsics)), -(2**15), 2**15)
    return int(x), int(y)


def _write(picture: NDArray[np.uint8], lines: list[str]) -> None:
    """Write lines of text into the upper left corner."""
    import cv2

    scale = max(0.35, picture.shape[0] / 900.0)
    for row, line in enumerate(lines, start=1):
        cv2.putText(picture, line, (4, round(36 * scale * row)), cv2.FONT_HERSHEY_SIMPLEX, scale, _GREEN)
