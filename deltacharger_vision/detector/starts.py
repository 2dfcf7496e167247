# SPDX-License-Identifier: Apache-2.0
"""Initial poses that match a terminal's silhouette to a pair of blobs.

A blob covers all bright parts of a bar: its touched face and visible sides. The face's corners alone would put the
terminal too near and to the side. For a given tilt, the silhouette of the complete bar is laid over the blob.
"""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_vision.detector.pairing import Pair
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.poses import TerminalPose, facing
from deltacharger_vision.projection import project, rays
from deltacharger_vision.terminal import Terminal

_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
Leans = tuple[tuple[float, float], ...]
SMALL_LEANS: Leans = ((0.0, 0.08), (0.0, -0.08), (0.08, 0.0), (-0.08, 0.0))
LARGE_LEANS: Leans = ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.4, 0.3), (0.4, -0.3), (-0.4, 0.3), (-0.4, -0.3))
"""Tangents of the lean across and along the bars."""
_ROUNDS = 3
_SAME, _SAME_PX = 0.05, 3.0  # of the length, px: a pair is as long as the bars


def by_corners(pair: Pair, terminal: Terminal, intrinsics: Intrinsics) -> list[TerminalPose]:
    """Return the one or two poses that match the faces' corners to the outlines, the better first.

    Collins, Bartoli, "Infinitesimal plane-based pose estimation", IJCV 109 (2014).
    """
    import cv2

    corners = pair.centre[:, None] + _SIGNS[:, :1] * pair.along[:, None] + _SIGNS[:, 1:] * pair.across[:, None]
    ideal = rays(corners.reshape(-1, 1, 2), intrinsics)
    model = terminal.corners().reshape(-1, 1, 3)
    try:
        found, vectors, translations, _ = cv2.solvePnPGeneric(model, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:  # no plane in front of a camera shows these corners
        return []
    poses = []
    for vector, translation in zip(vectors[:found], translations[:found], strict=True):
        rotation, _ = cv2.Rodrigues(np.asarray(vector, dtype=float))
        pose = TerminalPose(np.asarray(rotation, dtype=float), np.asarray(translation, dtype=float).ravel())
        if np.all(np.isfinite(pose.rotation)) and pose.translation[2] > 0.0 and facing(pose) > 0.0:
            poses.append(pose)
    return poses


def mirrored(pose: TerminalPose) -> TerminalPose:
    """Return the pose with its tilt mirrored at the line of sight, which looks almost equal from afar."""
    sight = pose.translation / np.linalg.norm(pose.translation)
    half_turn = 2.0 * np.outer(sight, sight) - np.eye(3)
    return TerminalPose(half_turn @ pose.rotation @ np.diag([-1.0, -1.0, 1.0]), pose.translation)


def ends_swapped(pose: TerminalPose, terminal: Terminal) -> list[TerminalPose]:
    """Return poses whose bars end where the side at their visible end ends in `pose`, and the reverse.

    At a slant, the end of a touched face is easily taken for the side's root on the plate. Either way the bars have
    another length in the image, and so another range and place.
    """
    camera = -pose.rotation.T @ pose.translation
    beyond = abs(camera[0]) - 0.5 * terminal.bar_length
    if beyond <= 0.0:
        return []
    # Where the root's ray crosses the plane of the touched faces, m past their end.
    past = beyond * terminal.bar_thickness / (terminal.bar_thickness - camera[2])
    found = []
    for shift in (-past, past):
        aside = np.array([0.5 * np.sign(camera[0]) * shift, 0.0, 0.0])
        place = (pose.translation + pose.rotation @ aside) * terminal.bar_length / (terminal.bar_length + shift)
        found.append(TerminalPose(pose.rotation, place))
    return found


def leaning(pose: TerminalPose, leans: Leans, pair: Pair, intrinsics: Intrinsics) -> list[TerminalPose]:
    """Return the pose leaning across and along the bars by these tangents; large leans start from a frontal view."""
    axis = pose.translation if leans is LARGE_LEANS else pose.rotation[:, 2]
    along, across, upright = tilted(pose, axis, pair, intrinsics).rotation.T
    return [tilted(pose, upright + a * across + b * along, pair, intrinsics) for a, b in leans]


def tilted(pose: TerminalPose, axis: Array, pair: Pair, intrinsics: Intrinsics) -> TerminalPose:
    """Return the pose with its z axis turned to the direction `axis` (3,), and its x axis along the pair's bars."""
    axis = axis / np.linalg.norm(axis)
    middle, along = pair.centre.mean(axis=0), pair.along.mean(axis=0)
    ends = np.ones((2, 3))
    ends[:, :2] = rays(np.stack([middle - along, middle + along]), intrinsics)
    # The bars lie in the plane of both ends' rays, perpendicular to the axis.
    bars = np.cross(np.cross(ends[0], ends[1]), axis)
    bars = bars / max(float(np.linalg.norm(bars)), 1e-9)
    if bars @ (ends[1] - ends[0]) < 0.0:
        bars = -bars
    return TerminalPose(np.stack([bars, np.cross(axis, bars), axis], axis=1), pose.translation)


def laid_over(pose: TerminalPose, pair: Pair, terminal: Terminal, intrinsics: Intrinsics, sides: bool) -> TerminalPose:
    """Return the pose translated until the bars lie over a pair's blobs.

    Args:
        pose: with the tilt and a rough position.
        pair: the blobs.
        terminal: size of the bars.
        intrinsics: of the camera.
        sides: whether the blobs include the bars' sides, which may be bright or dark.
    """
    face = terminal.corners()
    whole = np.concatenate([face, face + np.array([0.0, 0.0, terminal.bar_thickness if sides else 0.0])], axis=1)
    along = pair.along.sum(axis=0)
    along = along / np.linalg.norm(along)
    across = np.array([-along[1], along[0]])
    frame = np.stack([along, across])
    seen = np.array([np.hypot(*pair.along.T).sum(), float((pair.centre[1] - pair.centre[0]) @ across)])
    middle = pair.centre.mean(axis=0)
    for _ in range(_ROUNDS):
        placed = project(pose.points(whole), intrinsics) @ frame.T
        low, high = placed.min(axis=1), placed.max(axis=1)
        centre = 0.5 * (low + high)
        shown = np.array([(high - low)[:, 0].mean(), centre[1, 1] - centre[0, 1]])
        scale = float(shown @ seen) / float(seen @ seen)
        now = rays(centre.mean(axis=0) @ frame, intrinsics)
        shift = np.append(rays(middle, intrinsics) - now, 0.0) * pose.translation[2]
        pose = TerminalPose(pose.rotation, np.asarray((pose.translation + shift) * min(max(scale, 0.5), 2.0)))
    return pose


def by_spacing(pair: Pair, terminal: Terminal, intrinsics: Intrinsics) -> TerminalPose:
    """Return the frontal pose of a terminal whose bars have the distance of a pair's lines."""
    middle = pair.centre.mean(axis=0)
    spacing = float(np.hypot(*(pair.centre[1] - pair.centre[0])))
    place = np.append(rays(middle, intrinsics), 1.0) * terminal.spacing * intrinsics.fy / max(spacing, 1e-6)
    return tilted(TerminalPose(np.eye(3), place), place, pair, intrinsics)


def on_plane(pose: TerminalPose, coefficients: Array, pair: Pair, terminal: Terminal, intrinsics: Intrinsics) -> list[
    TerminalPose
]:  # fmt: skip
    """Return poses on the plate's plane q·X = 1 whose bars end where a cut pair ends, at one end or the other.

    A single pose if the pair has the bars' length.
    """
    turned = tilted(pose, coefficients, pair, intrinsics)
    along = pair.along[0] / np.hypot(*pair.along[0])
    half = float(np.hypot(*pair.along[0]))
    middle = pair.centre.mean(axis=0)
    face = terminal.corners()
    whole = np.concatenate([face, face + np.array([0.0, 0.0, terminal.bar_thickness])], axis=1)

    def placed(pixel: Array) -> TerminalPose:
        ray = np.append(rays(pixel, intrinsics), 1.0)
        ahead = (1.0 - terminal.bar_thickness * float(np.linalg.norm(coefficients))) / float(coefficients @ ray)
        return TerminalPose(turned.rotation, ray * ahead)

    ends = (project(placed(middle).points(whole), intrinsics) - middle) @ along
    low, high = -half - float(ends.min(axis=1).mean()), half - float(ends.max(axis=1).mean())
    if abs(high - low) <= max(_SAME * 2.0 * half, _SAME_PX):
        return [placed(middle + 0.5 * (low + high) * along)]
    return [placed(middle + low * along), placed(middle + high * along)]
