# SPDX-License-Identifier: Apache-2.0
"""Checks a hand-eye calibration and states what to do.

A doubt is a reason not to use the mount; a note is a hint for the next calibration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_vision.hand_eye.calibrate import Calibration, axis_name, count_places, moved

GOOD_VIEWS = 15
"""More views gain little against the error of the board's offset."""
_GOOD_PLACES = 10
_GOOD_SPAN = 0.030  # m
_SIZE, _SIZE_SIGMAS = 0.008, 4.0
_SHARE = 0.2  # of views that contradict the others
_ROTATION = math.radians(0.3)  # standard deviation
_ARM, _PIXEL, _HELD_OUT = 0.001, 0.8, 0.002  # m, px, m
_SURPRISE = 16.3  # of χ² with three degrees of freedom; one correct arm in 1000 exceeds it
_NAMED = 5
# A moved camera: least shift that matters, its chance among random orders of the views, and number of such orders.
_SHIFT, _CHANCE, _DRAWS = 0.0004, 0.002, 2000
_FEWEST_SIDE = 3


def doubts(found: Calibration, size: float, names: Sequence[str]) -> list[str]:
    """Return why the mount should not be used; empty if it should.

    Args:
        found: calibration to check.
        size: stated size of the board, m: of the tag's black square or of a chessboard square.
        names: (N,) of the images.
    """
    wrong_size = _size(found, size)
    if wrong_size:
        return [wrong_size]  # other doubts would follow from it
    reasons = [*_moved(found, names), *_agreement(found, names), _joints(found), _certainty(found)]
    if not found.decided:
        reasons.append("the board could also be tilted the other way: turn it by 20° on the platform, or move it more")
    return [text for text in reasons if text]


def notes(found: Calibration, names: Sequence[str]) -> list[str]:
    """Return hints for a better mount; arguments as in `doubts`."""
    hints = []
    kept = found.positions[found.fit.kept]
    if len(kept) < GOOD_VIEWS:
        hints.append(f"{len(kept)} views are few; take {GOOD_VIEWS} or more")
    places = count_places(kept)
    if places < min(_GOOD_PLACES, len(kept)):
        hints.append(f"the platform stood at {places} places only; more places help more than more images")
    for extent, axis in zip(*moved(kept), strict=True):
        if extent < _GOOD_SPAN:
            hints.append(
                f"the platform moved by {1e3 * extent:.0f} mm only along {axis_name(axis)}; give it "
                f"{1e3 * _GOOD_SPAN:.0f} mm and more, as far as the camera sees the board"
            )
    if 0 < np.count_nonzero(~found.fit.kept) <= _SHARE * len(names):
        hints.append(f"left out, as the others contradict: {_named(found, names)}")
    return hints


def drift(moves: Array) -> tuple[int, float, float]:
    """Find the moment of the largest shift between images, as by a pushed camera.

    Args:
        moves: (N, 3) m, residuals in order of time.

    Returns:
        The first view after it, the shift (m), and the chance that a random order shifts as much.
    """
    count = len(moves)
    if count < 2 * _FEWEST_SIDE:
        return 0, 0.0, 1.0
    length = np.linalg.norm(moves, axis=1, keepdims=True)
    limit = 10.0 * float(np.median(length))
    clipped = moves * np.minimum(1.0, limit / np.maximum(length, 1e-12))
    random = np.random.default_rng(0)
    orders = np.stack([np.arange(count), *(random.permutation(count) for _ in range(_DRAWS))])
    sides = np.arange(_FEWEST_SIDE, count - _FEWEST_SIDE + 1)
    before = np.cumsum(clipped[orders], axis=1)[:, sides - 1]
    total = clipped.sum(axis=0)
    apart = np.linalg.norm((total - before) / (count - sides)[:, None] - before / sides[:, None], axis=2)
    evidence = apart * np.sqrt(sides * (count - sides) / count)
    best = int(np.argmax(evidence[0]))
    chance = float(np.mean(evidence[1:].max(axis=1) >= evidence[0].max()))
    return int(sides[best]), float(apart[0, best]), chance


def _size(found: Calibration, size: float) -> str:
    off = abs(math.log(found.size))
    if off < max(_SIZE, _SIZE_SIGMAS * found.size_stddev / found.size):
        return ""
    likely, spread = 1e3 * size * found.size, 1e3 * size * found.size_stddev
    return (
        f"the platform's moves show that the board's size is {likely:.2f} ± {spread:.2f} mm, not {1e3 * size:g} mm: "
        "measure the print. If it is right, the image is over-exposed, or focal length or the arm's geometry is wrong"
    )


def _moved(found: Calibration, names: Sequence[str]) -> list[str]:
    first, shift, chance = drift(found.fit.apart.moves)
    if chance > _CHANCE or shift < _SHIFT:
        return []
    return [
        f"from {names[first]} on the board appears {1e3 * shift:.1f} mm elsewhere: was the camera or the board moved? "
        "Fix it and take all images again"
    ]


def _agreement(found: Calibration, names: Sequence[str]) -> list[str]:
    reasons = []
    spread = found.fit.spread
    left = int(np.count_nonzero(~found.fit.kept))
    if left > _SHARE * len(names):
        reasons.append(
            f"{left} of {len(names)} views contradict the others ({_named(found, names)}): do their positions belong "
            "to these images?"
        )
    if spread.arm > _ARM:
        reasons.append(
            f"platform and images disagree by {1e3 * spread.arm:.1f} mm in each direction: calibrate the arm, fasten "
            "the board, and let the arm come to rest before each image"
        )
    if spread.pixel > _PIXEL:
        reasons.append(
            f"corners scatter by {spread.pixel:.1f} px about the board's shape: is the board flat, the image sharp, "
            "the camera's calibration that of this image size?"
        )
    error = held_out_rms(found)
    if error > _HELD_OUT:
        reasons.append(f"held-out images show the board {1e3 * error:.1f} mm from where it is expected")
    return reasons


def held_out_rms(found: Calibration) -> float:
    """Return the root mean square length (m) of the held-out errors, without views that contradict the others."""
    good = found.fit.kept[list(found.held_out)]
    return math.sqrt(float(np.mean(np.sum(found.held_out_errors[good] ** 2, axis=1)))) if good.any() else math.nan


def _joints(found: Calibration) -> str:
    if found.joint_surprise < _SURPRISE:
        return ""
    worst = math.degrees(float(np.abs(found.joints[0]).max()))
    return (
        f"the arm's angles are off by more than stated, by at least {worst:.1f}°: calibrate the arm and give its "
        "--geometry, or state more"
    )


def _certainty(found: Calibration) -> str:
    worst = math.sqrt(float(np.linalg.eigvalsh(found.mount.covariance[3:, 3:])[-1]))
    if worst < _ROTATION:
        return ""
    return (
        f"the camera's rotation is known to ±{math.degrees(worst):.2f}° only: take more views, further apart, as far "
        "as the camera sees the board"
    )


def _named(found: Calibration, names: Sequence[str]) -> str:
    left = [names[index] for index in np.flatnonzero(~found.fit.kept).tolist()]
    more = f" and {len(left) - _NAMED} more" if len(left) > _NAMED else ""
    return ", ".join(left[:_NAMED]) + more
