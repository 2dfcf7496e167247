# SPDX-License-Identifier: Apache-2.0
"""Brushed metal: streaks, and a highlight that is narrow along the brushing and wide across it."""

from __future__ import annotations

import numpy as np

from deltacharger_core.arrays import Array, Array32
from deltacharger_vision.rendering.parameters import SceneParameters
from deltacharger_vision.rendering.ray_caster import Piece, Rays
from deltacharger_vision.rendering.scene import Box

_STREAKS = 48
_BLOTCHES = 12


def brushed(
    rays: Rays,
    box: Box,
    pose: Array,
    piece: Piece,
    gray: Array32 | np.float32,
    light: Array,
    parameters: SceneParameters,
    random: np.random.Generator,
) -> tuple[Array32 | np.float32, Array32 | None]:
    """Return the diffuse light (h, w) of metal brushed along the box's x, with streaks, and the highlight (h, w).

    The highlight is Ward's exp(−((h·x/a)² + (h·y/b)²)/(h·n)²) with h between light and eye, x along and y across
    the brushing. The faces at the box's ends have none.

    Args:
        rays: of the camera.
        box: to paint.
        pose: (4, 4) of the box in the optical frame.
        piece: its visible part.
        gray: diffuse light without streaks.
        light: (3,) unit vector toward the light in the optical frame.
        parameters: of the scene.
        random: draws the streaks.
    """
    uneven = bool(parameters.streaks or parameters.mirrored)
    if not parameters.highlight and not uneven:
        return gray, None
    axes = pose[:3, :3].T
    along, *across = (rays.linear(axis, piece.window) for axis in axes)
    if uneven:
        gray = gray * streaks(box, pose, piece.inverse, (along, *across), parameters, random)
    if not parameters.highlight:
        return gray, None
    length = np.sqrt(along * along + across[0] * across[0] + across[1] * across[1])
    seen = [axis @ light - part / length for axis, part in zip(axes, (along, *across), strict=True)]
    glare = np.zeros(piece.covered.shape, dtype=np.float32)
    for face, share in zip(piece.faces, piece.shares, strict=True):
        axis, sign = face // 2, 2 * (face % 2) - 1
        if axis == 0 or sign * (axes[axis] @ light) <= 0.0:
            continue
        beside = seen[2 if axis == 1 else 1]
        slope = (seen[0] / parameters.lobe_along) ** 2 + (beside / parameters.lobe_across) ** 2
        glare += share * np.exp(-slope / np.maximum(seen[axis] * seen[axis], 1e-6))
    return gray, np.float32(parameters.highlight) * glare


def streaks(
    box: Box,
    pose: Array,
    inverse: Array32,
    along: tuple[Array32, ...],
    parameters: SceneParameters,
    random: np.random.Generator,
) -> Array32:
    """Return (h, w) factors about 1 on the light of metal: lines along its x, and slow changes from end to end.

    Args:
        box: the metal.
        pose: (4, 4) of the box in the optical frame.
        inverse: (h, w) 1/m, 1/z on its surface.
        along: (h, w) each, dot products of every pixel's ray with the box's three axes.
        parameters: strengths of both.
        random: draws them.
    """
    fine = 1.0 + parameters.streaks * random.standard_normal(_STREAKS)
    slow = 1.0 + parameters.mirrored * random.standard_normal(_BLOTCHES)
    centre = pose[:3, :3].T @ pose[:3, 3]
    depth = 1.0 / np.maximum(inverse, 1e-6)
    # y and z together: a line continues from the front face to the upper one.
    beside = (along[1] + along[2]) * depth - (centre[1] + centre[2])
    x = along[0] * depth - centre[0]
    width, length = max(box.size[1] + box.size[2], 1e-6), max(box.size[0], 1e-6)
    lines = np.interp((beside / width + 0.5) * (_STREAKS - 1), np.arange(_STREAKS), fine)
    ends = np.interp((x / length + 0.5) * (_BLOTCHES - 1), np.arange(_BLOTCHES), slow)
    return np.asarray(np.maximum(lines * ends, 0.0), dtype=np.float32)
