# SPDX-License-Identifier: Apache-2.0
"""Subpixel corners of printed squares: the intersections of their straight edges.

An edge lies where the light is half-way between both sides, found from the area under a profile across it in linear
light. In the encoded values of an image (sRGB), the middle of a blurred edge is displaced.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_vision.images import LIGHT

_PROFILE = 13  # samples across an edge
_ENDS = 2  # of them at either end, for the levels of both sides
_WIDEST, _NARROWEST = 4.0, 1.2  # px to either side
_CONTRAST = 0.25  # of the strongest edge; a weaker sample is no edge
_FEWEST = 4  # samples of an edge
_PASSES = 3


def refined(gray: NDArray[np.uint8], pixels: Array, offsets: Array, free: float) -> Array:
    """Return where edges cross, (K, 2) px; NaN if they are invisible or elsewhere.

    Args:
        gray: (H, W) sRGB.
        pixels: (K, 2) px, corners within one or two pixels.
        offsets: (K, 2, M, 2) px, from each corner to samples on its two edges.
        free: px on either side of the edges without other features.
    """
    light = LIGHT.astype(np.float32)[gray]
    width = float(np.clip(free, _NARROWEST, _WIDEST))
    found = np.array(pixels, dtype=float)
    along = offsets[:, :, -1] - offsets[:, :, 0]
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    for _ in range(_PASSES):
        place, weight = _edges(light, found[:, None, None] + offsets, across, width)
        # The edge is the line across·(x − found) = level + slope along·(x − found).
        level, slope = _fitted(np.einsum("kemi,kei->kem", offsets, along), place, weight)
        normals = across - slope[..., None] * along
        with np.errstate(invalid="ignore"):
            step = np.linalg.solve(_invertible(normals), level[..., None])[..., 0]
        found = found + step
    return np.asarray(np.where(np.abs(found - pixels).max(axis=1, keepdims=True) <= width, found, np.nan))


def _edges(light: NDArray[np.float32], points: Array, across: Array, width: float) -> tuple[Array, Array]:
    """Return the edge's position (K, 2, M) px along `across` from points (K, 2, M, 2), and the weight of each."""
    import cv2

    steps = np.linspace(-width, width, _PROFILE)
    samples = (points[..., None, :] + steps[:, None] * across[:, :, None, None]).astype(np.float32)
    flat = np.nan_to_num(samples.reshape(len(samples), -1, 2), nan=-1.0)
    seen = cv2.remap(light, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    profile = np.asarray(seen, dtype=float).reshape(samples.shape[:-1])
    first, last = profile[..., :_ENDS].mean(axis=-1), profile[..., -_ENDS:].mean(axis=-1)
    contrast = last - first
    strong = np.abs(contrast) > _CONTRAST * np.abs(contrast).max()
    height, width_px = light.shape
    x, y = samples[..., 0], samples[..., 1]
    inside = ((x >= 0) & (y >= 0) & (x <= width_px - 1) & (y <= height - 1)).all(axis=-1)
    share = (profile - first[..., None]) / np.where(strong, contrast, 1.0)[..., None]
    # The trapezoid's area under the share of the far side.
    area = (share[..., 1:-1].sum(axis=-1) + 0.5 * (share[..., 0] + share[..., -1])) / (_PROFILE - 1)
    return width * (1.0 - 2.0 * area), (strong & inside).astype(float)


def _fitted(along: Array, place: Array, weight: Array) -> tuple[Array, Array]:
    """Return level and slope (K, 2) of place = level + slope · along (K, 2, M); NaN with too few samples."""
    with np.errstate(invalid="ignore", divide="ignore"):
        total = weight.sum(axis=-1)
        middle, mean = ((weight * values).sum(axis=-1) / total for values in (along, place))
        centred = along - middle[..., None]
        slope = (weight * centred * place).sum(axis=-1) / (weight * centred**2).sum(axis=-1)
    enough = total >= _FEWEST
    return np.where(enough, mean - slope * middle, np.nan), np.where(enough, slope, np.nan)


def _invertible(matrices: Array) -> Array:
    """Return matrices (K, 2, 2) with NaN for edges that hardly cross."""
    crossing = np.abs(np.linalg.det(np.nan_to_num(matrices))) > 0.1
    return np.where(crossing[:, None, None], matrices, np.nan)
