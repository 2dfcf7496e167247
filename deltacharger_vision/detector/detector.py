# SPDX-License-Identifier: Apache-2.0
"""Finds the pose of a terminal's two electrodes in an RGB-D image, or None.

Blobs → pairs → corners (IPPE) → edges → plane of the plate → one least-squares fit of edges and plane → judgement.
If that fails: pieces between edges → pairs of lines → positions on the plate's plane → edges → judgement.
A pose without visible outlines, or contradicted by depth, is not returned.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from deltacharger_vision.detector.detection import Detection
from deltacharger_vision.detector.judgement import FOCAL_ERROR, Candidate
from deltacharger_vision.detector.pairing import Pair, find_cut_pairs, find_pairs
from deltacharger_vision.detector.parts import PartsJudge
from deltacharger_vision.detector.segmentation import find_blobs, find_pieces
from deltacharger_vision.errors import CameraInfoError
from deltacharger_vision.images import DEPTH_BIAS, LIGHT, NEAREST_DEPTH, Intrinsics, RgbdImage
from deltacharger_vision.mount import line_angle
from deltacharger_vision.poses import cross_matrix
from deltacharger_vision.projection import check_lens, project
from deltacharger_vision.terminal import Terminal

_SMOOTHING = 0.6  # px, standard deviation of the blur before edges are searched
_SURE = 0.8  # confidence at which the search ends
_NORMAL_STDDEV = 0.06  # rad, largest standard deviation of a reported normal

_LARGEST = 1_100_000  # px that are searched, such as 1280 × 800: time and memory are those of a small image
_APART = 4.0  # standard deviations beyond which two poses differ
_LINEAR = (255.0 * LIGHT).astype(np.float32)


class ElectrodeDetector:
    """Finds two bright bars of known size on a dark plate.

    Args:
        terminal: size of the bars.
        stereo_range: least distance (m) at which depth counts.
        depth_bias: standard deviation of the relative error of all depth, and of its change per unit ray.
    """

    def __init__(
        self, terminal: Terminal | None = None, stereo_range: float = NEAREST_DEPTH, depth_bias: float = DEPTH_BIAS
    ) -> None:
        self.terminal = terminal or Terminal()
        self._stereo_range, self._depth_bias = stereo_range, depth_bias

    def detect(self, image: RgbdImage) -> Detection | None:
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
        check_lens(image.intrinsics)
        judge = PartsJudge(smooth, image, self.terminal, self._stereo_range, self._depth_bias)
        best: Candidate | None = None
        for pair in find_pairs(find_blobs(grey), self.terminal):
            if best is not None and self._covers(best, pair, image.intrinsics):
                continue
            try:
                candidate = judge.judge(pair)
            except CameraInfoError:  # a cut bar is completed beyond the lens's view
                continue
            if candidate is not None and (best is None or candidate.confidence > best.confidence):
                best = candidate
                if best.confidence >= _SURE:
                    break
        if best is None:
            best = self._in_pieces(image, judge)
        return None if best is None else self._detection(best, intrinsics)

    def _in_pieces(self, image: RgbdImage, judge: PartsJudge) -> Candidate | None:
        """Return a partly hidden terminal, or None if two poses explain the image."""
        found = []
        pieces = find_pieces(image.color)
        for pair in find_cut_pairs(pieces, self.terminal):
            try:
                found += judge.judge_cut(pair)
            except CameraInfoError:
                continue
        best = max(found, key=lambda each: each.confidence, default=None)
        if best is None or any(_differ(best, each) for each in found):
            return None
        return best

    def _covers(self, found: Candidate, pair: Pair, intrinsics: Intrinsics) -> bool:
        """Return whether a pair lies on a found terminal: no other can be there."""
        middle, end = np.zeros(3), np.array([0.5 * self.terminal.bar_length, 0.0, 0.0])
        here, there = project(found.pose.points(np.stack([middle, end])), intrinsics)
        return bool(np.hypot(*(pair.centre.mean(axis=0) - here)) < np.hypot(*(there - here)))

    def _detection(self, found: Candidate, intrinsics: Intrinsics) -> Detection:
        pose = found.pose
        x, y = pose.rotation[0, 0], pose.rotation[1, 0]
        roll = line_angle(x, y)
        turning = cross_matrix(pose.rotation[:, 2])
        spread = turning @ found.covariance[3:, 3:] @ turning.T
        # If expected depth is missing, two tilts in a hundred are off by far more than the edges show.
        checked = found.fused or pose.translation[2] < self._stereo_range
        known = math.sqrt(float(np.linalg.eigvalsh(spread)[-1])) <= _NORMAL_STDDEV
        covariance = found.covariance.copy()
        # A longer focal length moves everything away in proportion, and nothing aside.
        covariance[2, 2] += (FOCAL_ERROR * pose.translation[2]) ** 2
        return Detection(
            position=pose.translation,
            roll=roll,
            axis=pose.rotation[:, 0] * math.copysign(1.0, x * math.cos(roll) + y * math.sin(roll)),
            normal=-pose.rotation[:, 2] if found.upright and checked and known else np.full(3, np.nan),
            covariance=covariance,
            confidence=found.confidence,
            range=float(np.linalg.norm(pose.translation)),
            bars=project(pose.points(self.terminal.corners()), intrinsics),
            source="both" if found.fused else "image",
        )


def _reduced(image: RgbdImage) -> RgbdImage:
    """Return a large image averaged over squares, with the depth of their middles; others unchanged."""
    import cv2

    intrinsics = image.intrinsics
    side = math.ceil(math.sqrt(intrinsics.width * intrinsics.height / _LARGEST))
    if side == 1:
        return image
    width, height = intrinsics.width // side, intrinsics.height // side
    color = cv2.resize(image.color[: height * side, : width * side], (width, height), interpolation=cv2.INTER_AREA)
    depth = image.depth[side // 2 : height * side : side, side // 2 : width * side : side]
    return RgbdImage(np.asarray(color, dtype=np.uint8), depth, intrinsics.binned(side, side))


def _differ(one: Candidate, other: Candidate) -> bool:
    """Return whether two poses differ by more than their covariances explain."""
    apart = one.pose.translation - other.pose.translation
    spread = one.covariance[:3, :3] + other.covariance[:3, :3]
    return float(apart @ np.linalg.solve(spread, apart)) > _APART**2
