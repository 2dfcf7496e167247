# SPDX-License-Identifier: Apache-2.0
"""From true depth to the depth of two cameras with block matching."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array32, Mask
from deltacharger_vision.rendering.image_defects import white
from deltacharger_vision.rendering.parameters import CameraParameters

_LOGISTIC = 1.702
"""1 / (1 + exp(−1.702 x)) is the normal distribution within 0.01."""
_TOLERANCE = 0.5
"""Distance in front of a pixel, as disparity, from which something hides it, px."""


def measured(
    inverse: Array32, holes: Array32, focal: float, parameters: CameraParameters, random: np.random.Generator
) -> Array32:
    """Return depth (H, W) m, NaN = unknown.

    Args:
        inverse: (H, W) 1/m, one over the true depth.
        holes: (H, W) share of holes.
        focal: px of this image along x.
        parameters: of the camera.
        random: draws noise and holes.
    """
    p = parameters
    per_inverse = p.stereo_focal * p.baseline
    disparity = inverse * np.float32(per_inverse)
    unknown = disparity > p.disparities
    if p.occlusion:
        unknown |= _hidden(inverse, focal * p.baseline)
    if p.fattening:
        disparity = _fattened(disparity, p.fattening, p.fattening_step)
    if p.disparity_noise:
        disparity += np.float32(p.disparity_noise) * blotches(disparity.shape, p.noise_width, random)
    if p.disparity_step:
        disparity *= np.float32(1.0 / p.disparity_step)
        np.rint(disparity, out=disparity)
        disparity *= np.float32(p.disparity_step)
    unknown |= ~((disparity <= p.disparities) & (disparity >= per_inverse / p.farthest))
    if p.hole_metal or p.hole_glare or p.hole_matte:
        unknown |= _holes(holes, p.hole_width, random)
    np.maximum(disparity, np.float32(1e-6), out=disparity)
    depth = np.float32(per_inverse) / disparity
    if p.whole_millimetres:
        depth = np.rint(depth * np.float32(1e3)) * np.float32(1e-3)
    depth[unknown] = np.nan
    return depth


def blotches(shape: tuple[int, ...], width: int, random: np.random.Generator) -> Array32:
    """Return normal noise (H, W) of variance 1, correlated over `width` px: white noise averaged over squares."""
    rows, columns = shape
    single = white((rows + width - 1, columns + width - 1), random)
    down = single[:rows].copy()
    for shift in range(1, width):
        down += single[shift : shift + rows]
    found = down[:, :columns].copy()
    for shift in range(1, width):
        found += down[:, shift : shift + columns]
    found *= np.float32(1.0 / width)
    return found


def _hidden(inverse: Array32, per_inverse: float) -> Mask:
    """Return the pixels that one of the two cameras, half a baseline on either side of this image, cannot see.

    The right camera sees column x at x − d/2. Something further right hides x if it appears left of that place; for the
    left camera, the reverse. Pixels outside a camera's image are also invisible.
    """
    columns = np.arange(inverse.shape[1], dtype=np.float32)
    half = inverse * np.float32(0.5 * per_inverse)
    right, left = columns - half, columns + half
    nearest = np.minimum.accumulate(right[:, ::-1], axis=1)[:, ::-1]
    farthest = np.maximum.accumulate(left, axis=1)
    hidden = (right > nearest + np.float32(_TOLERANCE)) | (left < farthest - np.float32(_TOLERANCE))
    last = inverse.shape[1] - 1
    return np.asarray(hidden | (right < -_TOLERANCE) | (left > last + _TOLERANCE))


def _fattened(disparity: Array32, reach: int, step: float) -> Array32:
    """Return disparity with near parts spread by `reach` px over parts farther by more than `step` px."""
    largest = disparity
    for axis in (0, 1):
        padded = np.pad(largest, [(reach, reach) if i == axis else (0, 0) for i in (0, 1)], mode="edge")
        largest = largest.copy()
        size = disparity.shape[axis]
        for shift in range(2 * reach + 1):
            part = padded[shift : shift + size] if axis == 0 else padded[:, shift : shift + size]
            np.maximum(largest, part, out=largest)
    return np.where(largest - disparity > np.float32(step), largest, disparity)


def _holes(share: Array32, width: int, random: np.random.Generator) -> Mask:
    """Return blobs of about `width` px that cover the given share (H, W), drawn at half the resolution."""
    rows, columns = share.shape
    coarse = blotches(((rows + 1) // 2, (columns + 1) // 2), max(1, width // 2), random)
    even = 1.0 / (1.0 + np.exp(np.float32(-_LOGISTIC) * coarse))
    fine = np.repeat(np.repeat(even, 2, axis=0), 2, axis=1)[:rows, :columns]
    return np.asarray(fine < share)
