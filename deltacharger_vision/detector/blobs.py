# SPDX-License-Identifier: Apache-2.0
"""Blobs that may be bars, and pairs of them with the outlines of both; a cut bar is completed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_vision.terminal import Terminal

# Grey levels (0–255) above which a pixel is bright; one of them suits the light.
_LEVELS = (25, 40, 60, 90, 125, 160, 195, 230)
_NEIGHBOURHOOD = 61  # px, side of the window for the local mean
_EXCESS = 12  # least excess of a locally bright pixel over the mean, grey levels
_SHORTEST = 12.0  # px, least length of a bar
_THINNEST = 2.0  # px, least width of a bar
_STOUT = 1.4  # least length over width
_SLENDER = 14.0  # largest length over width
_FILL = 0.72  # least share of the enclosing rectangle that a blob covers
# Differences within 3 × 3 px, of 255 in any colour, that separate pieces; one of them suits the light.
_PARTING = (14, 28)
_STUB = 1.1  # least length over width of a piece of a bar
_MOST = 60  # most blobs to examine, the most rectangular first

Image = NDArray[np.uint8]

_LOST = 3.0  # px by which the edges around a piece, with the pixels beside them, narrow it


@dataclass(frozen=True)
class Blobs:
    """Rectangles around N blobs.

    Attributes:
        centre: (N, 2) px.
        direction: (N, 2) unit vector along the long side, toward +x.
        length: (N,) px.
        width: (N,) px.
        fill: (N,) share of the rectangle that is bright.
    """

    centre: Array
    direction: Array
    length: Array
    width: Array
    fill: Array

    def __len__(self) -> int:
        return len(self.length)

    def chosen(self, rows: NDArray[Any]) -> Blobs:
        """Return the blobs of an index or mask."""
        return Blobs(self.centre[rows], self.direction[rows], self.length[rows], self.width[rows], self.fill[rows])


def find_blobs(grey: Image) -> Blobs:
    """Return at most `_MOST` blobs of a grey image (H, W) that may be bars or parts of bars."""
    import cv2

    smooth = cv2.GaussianBlur(grey, (3, 3), 0)
    brightest = int(smooth.max())
    rows: list[tuple[float, ...]] = []
    for level in _LEVELS:
        if level < brightest:
            rows += _rectangles((smooth > level).view(np.uint8))
    mean = cv2.blur(smooth, (_NEIGHBOURHOOD, _NEIGHBOURHOOD))
    rows += _rectangles((cv2.subtract(smooth, mean) > _EXCESS).view(np.uint8))
    return _chosen(rows, _MOST)


def find_pieces(color: Image) -> Blobs:
    """Return the uniform parts of an image (H, W, 3) that may be pieces of bars, even if something covers the bars.

    An equally bright object across a bar merges with it at every grey level. Its edge still separates the two.
    """
    import cv2

    smooth = cv2.GaussianBlur(color, (3, 3), 0)
    change = cv2.morphologyEx(smooth, cv2.MORPH_GRADIENT, np.ones((3, 3), dtype=np.uint8)).max(axis=2)
    rows: list[tuple[float, ...]] = []
    for parting in _PARTING:
        rows += _rectangles((change < parting).view(np.uint8), _LOST)
    return _chosen(rows, _MOST)


def _chosen(rows: list[tuple[float, ...]], most: int) -> Blobs:
    table = np.array(rows, dtype=float).reshape(-1, 6)
    table = table[np.argsort(-table[:, 5])]
    blobs = Blobs(table[:, :2], _direction(table[:, 4]), table[:, 2], table[:, 3], table[:, 5])
    return blobs.chosen(_distinct(blobs, most))


def _rectangles(mask: Image, lost: float = 0.0) -> list[tuple[float, ...]]:
    """Return x, y, length, width, angle of the long side (rad), fill of each blob of a mask that may be a bar.

    If the mask shows everything too narrow by `lost` px, pieces of bars are accepted.
    """
    import cv2

    height, width = mask.shape
    shortest, stout = (_SHORTEST, _STOUT) if not lost else (0.5 * _SHORTEST, _STUB)
    contours, family = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    rows: list[tuple[float, ...]] = []
    for index, contour in enumerate(contours):
        # A hole between pieces is as large as a bar with its edges.
        if len(contour) < 4 or (lost and family[0, index, 3] >= 0):
            continue
        _, _, box_width, box_height = cv2.boundingRect(contour)
        if max(box_width, box_height) + lost < shortest or (box_width > 0.9 * width and box_height > 0.9 * height):
            continue
        (x, y), (first, second), degrees = cv2.minAreaRect(contour)
        first, second = first + 1.0 + lost, second + 1.0 + lost  # the contour runs through pixel centres
        if first < second:
            first, second, degrees = second, first, degrees + 90.0
        if first < shortest or second < _THINNEST:
            continue
        if not stout <= first / second <= _SLENDER:
            continue
        area = cv2.contourArea(contour) + 0.5 * (1.0 + lost) * cv2.arcLength(contour, True) + (1.0 + lost) ** 2
        fill = min(area / (first * second), 1.0)
        if fill >= _FILL:
            rows.append((x, y, first, second, np.radians(degrees), fill))
    return rows


def _direction(angle: Array) -> Array:
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.where(direction[:, :1] < 0.0, -direction, direction)


def _distinct(blobs: Blobs, most: int) -> NDArray[np.int64]:
    """Return the indices of at most `most` blobs that are not nearly the same as an earlier one."""
    kept: list[int] = []
    left = np.arange(len(blobs))
    while len(left) and len(kept) < most:
        first, left = left[0], left[1:]
        kept.append(int(first))
        apart = np.hypot(*(blobs.centre[left] - blobs.centre[first]).T)
        ratio, thickness = blobs.length[left] / blobs.length[first], blobs.width[left] / blobs.width[first]
        alike = (np.abs(ratio - 1.0) < 0.06) & (np.abs(thickness - 1.0) < 0.25)
        left = left[~(alike & (apart < 0.2 * blobs.width[first] + 0.5))]
    return np.array(kept, dtype=np.int64)


_ANGLE = 0.2  # rad, largest angle between the bars
_NEAR_BY_LENGTH = 0.55  # least spacing over length, 1 seen from the front
_FAR_BY_LENGTH = 1.75  # largest spacing over length
_NEAR_BY_WIDTH = 0.55  # least spacing over width, 1 seen from the front
_FAR_BY_WIDTH = 1.6  # largest spacing over width
_WIDTHS = 1.9  # largest ratio of the bars' widths
_WHOLE = 0.93  # least ratio of the lengths of two complete bars
_SHIFT = 0.15  # largest offset along the bars, in lengths
_PART = 0.2  # least length of a cut bar, in lengths of the complete one
_ASIDE = 0.35  # largest offset of a piece from the line of a bar, in widths
_PIECES = 0.3  # least share of the bars' length from the first piece to the last
_MOST_PAIRS = 6  # most pairs to examine, the likeliest first


@dataclass(frozen=True)
class Pair:
    """Outlines of two bars that may be a terminal.

    Attributes:
        centre: (2, 2) px; first the bar at −y of the terminal's frame (x along the bars, z away from the camera).
        along: (2, 2) px, from the centre of each bar to the middle of its end at +x.
        across: (2, 2) px, from the centre of each bar to the middle of its side at +y.
        doubt: deviation from a terminal seen from the front; the smallest is tried first.
    """

    centre: Array
    along: Array
    across: Array
    doubt: float


def find_pairs(blobs: Blobs, terminal: Terminal) -> list[Pair]:
    """Return the likeliest pairs, the least doubtful first."""
    if len(blobs) < 2:
        return []
    first, second = np.nonzero(~np.eye(len(blobs), dtype=bool))
    longer = blobs.length[first] >= blobs.length[second]
    first, second = first[longer], second[longer]
    cosine = np.abs(np.sum(blobs.direction[first] * blobs.direction[second], axis=1))
    offset = blobs.centre[second] - blobs.centre[first]
    direction, length = blobs.direction[first], blobs.length[first]
    along = np.abs(np.sum(offset * direction, axis=1)) / length
    spacing = np.abs(offset[:, 1] * direction[:, 0] - offset[:, 0] * direction[:, 1])
    pitch = terminal.bar_height + terminal.gap
    width = np.maximum(blobs.width[first], blobs.width[second])
    narrow = np.minimum(blobs.width[first], blobs.width[second])
    by_length = spacing / length * terminal.bar_length / pitch
    by_width = spacing / (0.5 * (width + narrow)) * terminal.bar_height / pitch
    ratio = blobs.length[second] / length
    whole = (ratio >= _WHOLE) & (along <= _SHIFT)
    part = (ratio >= _PART) & (along + 0.5 * ratio <= 0.5 + _SHIFT)
    fits = (cosine >= np.cos(_ANGLE)) & (whole | part) & (width / narrow <= _WIDTHS)
    fits &= (by_length >= _NEAR_BY_LENGTH) & (by_length <= _FAR_BY_LENGTH)
    fits &= (by_width >= _NEAR_BY_WIDTH) & (by_width <= _FAR_BY_WIDTH)
    doubt = np.abs(np.log(np.maximum(by_length, 1e-9))) + np.abs(np.log(np.maximum(by_width, 1e-9)))
    doubt += np.where(whole, along, 0.5 * (1.0 - ratio)) + 2.0 * np.arccos(np.minimum(cosine, 1.0))
    doubt += 2.0 - blobs.fill[first] - blobs.fill[second]
    rows = np.flatnonzero(fits)
    rows = rows[np.argsort(doubt[rows])]
    pairs: list[Pair] = []
    for row in rows:
        pair = _outline(blobs, int(first[row]), int(second[row]), bool(whole[row]), float(doubt[row]))
        if all(_differs(pair, other) for other in pairs):
            pairs.append(pair)
            if len(pairs) == _MOST_PAIRS:
                break
    return pairs


def find_cut_pairs(pieces: Blobs, terminal: Terminal) -> list[Pair]:
    """Return the likeliest pairs of lines through pieces of two bars, from the first end of a piece to the last."""
    if len(pieces) < 2:
        return []
    pitch = terminal.bar_height + terminal.gap
    first, second = np.nonzero(pieces.length[:, None] >= pieces.length)
    first, second = first[first != second], second[first != second]
    cosine = np.abs(np.sum(pieces.direction[first] * pieces.direction[second], axis=1))
    offset, direction = pieces.centre[second] - pieces.centre[first], pieces.direction[first]
    spacing = np.abs(offset[:, 1] * direction[:, 0] - offset[:, 0] * direction[:, 1])
    width = np.maximum(pieces.width[first], pieces.width[second])
    narrow = np.minimum(pieces.width[first], pieces.width[second])
    by_width = spacing / (0.5 * (width + narrow)) * terminal.bar_height / pitch
    fits = (cosine >= np.cos(_ANGLE)) & (width / narrow <= _WIDTHS)
    fits &= (by_width >= _NEAR_BY_WIDTH) & (by_width <= _FAR_BY_WIDTH)
    fits &= np.abs(np.sum(offset * direction, axis=1)) < 1.2 * terminal.bar_length / pitch * spacing
    pairs: list[Pair] = []
    for row in np.flatnonzero(fits):
        pair = _cut(pieces, int(first[row]), int(second[row]), terminal)
        if pair is not None:
            pairs.append(pair)
    found: list[Pair] = []
    for pair in sorted(pairs, key=lambda each: each.doubt):
        if all(_differs(pair, other) for other in found):
            found.append(pair)
    return found[:_MOST_PAIRS]


def _cut(pieces: Blobs, first: int, second: int, terminal: Terminal) -> Pair | None:
    """Return the pair of lines through two pieces, as long as all pieces on them; None if that is too long."""
    direction = pieces.direction[first] * pieces.length[first]
    other = pieces.direction[second] * pieces.length[second]
    direction = direction + (other if other @ direction > 0.0 else -other)
    direction = direction / np.hypot(*direction)
    across = np.array([-direction[1], direction[0]])
    along, aside = (pieces.centre - pieces.centre[first]) @ direction, (pieces.centre - pieces.centre[first]) @ across
    spacing, width = aside[second], max(pieces.width[first], pieces.width[second])
    whole = abs(spacing) * terminal.bar_length / terminal.spacing
    near = np.minimum(np.abs(aside), np.abs(aside - spacing)) < _ASIDE * width
    near &= (pieces.width < _WIDTHS * width) & (pieces.width > width / _WIDTHS)
    near &= np.abs(pieces.direction @ direction) > np.cos(2.0 * _ANGLE)
    near &= np.abs(along - 0.5 * along[second]) < whole
    near[[first, second]] = True
    low, high = (along - 0.5 * pieces.length)[near].min(), (along + 0.5 * pieces.length)[near].max()
    seen = float(pieces.length[near].sum())
    if not _PIECES < (high - low) / whole < 1.0 / _NEAR_BY_LENGTH:
        return None
    middle = pieces.centre[first] + 0.5 * (low + high) * direction
    centre = np.stack([middle, middle + spacing * across])[:: 1 if spacing > 0.0 else -1]
    half = 0.5 * (high - low) * direction
    doubt = 1.0 - 0.5 * seen / max(whole, high - low) + abs(np.log((high - low) / whole))
    return Pair(centre, np.stack([half, half]), np.stack([0.5 * width * across] * 2), float(doubt))


def _outline(blobs: Blobs, first: int, second: int, whole: bool, doubt: float) -> Pair:
    direction = blobs.direction[first]
    across = np.array([-direction[1], direction[0]])
    offset = blobs.centre[second] - blobs.centre[first]
    if whole:
        centre = np.stack([blobs.centre[first], blobs.centre[second]])
        other = blobs.direction[second]
        other = other if other @ direction > 0.0 else -other
        directions = np.stack([direction, other])
        half = 0.5 * blobs.length[[first, second]]
    else:
        # A cut bar shows its line, the complete one its length and ends.
        centre = blobs.centre[first] + np.stack([np.zeros(2), across * (offset @ across)])
        directions = np.stack([direction, direction])
        half = np.full(2, 0.5 * blobs.length[first])
    order = [0, 1] if offset @ across > 0.0 else [1, 0]
    sides = np.stack([-directions[:, 1], directions[:, 0]], axis=1) * 0.5 * blobs.width[[first, second], None]
    return Pair(centre[order], (directions * half[:, None])[order], sides[order], doubt)


def _differs(pair: Pair, other: Pair) -> bool:
    """Whether refinement would not bring both to the same edges."""
    reach = np.hypot(*other.across.T).min()
    moved = np.abs(pair.centre - other.centre).max() + np.abs(pair.along - other.along).max()
    return bool(moved > reach)
