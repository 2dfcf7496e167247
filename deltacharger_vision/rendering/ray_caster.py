# SPDX-License-Identifier: Apache-2.0
"""Casts boxes into a pinhole camera with numpy, all pixels' rays at once, and brushes their metal.

With r = (u, v, 1) the ray of a pixel in the optical frame, everything about a convex box is linear in r. The ray meets
a face n·p = h (n outward, h < 0 if the camera sees its front) at 1/z = n·r / h, and the box at the smallest 1/z of its
visible faces. Planes through the camera and the edges between a visible and a hidden face bound the outline: e·r ≥ 0 is
inside, and e·r over its gradient per pixel is the distance to the edge in pixels, which gives the covered share of the
pixel. Edges are therefore exact to a small part of a pixel, and nothing needs clipping.
"""

from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array, Array32, Mask
from deltacharger_vision.images import Intrinsics, undistort
from deltacharger_vision.rendering.scene import Box, SceneParameters

_SIGN = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_FACES = [(axis, sign) for axis in range(3) for sign in (-1, 1)]
_EDGES = [(i, j) for i in range(6) for j in range(i + 1, 6) if _FACES[i][0] != _FACES[j][0]]
_EDGE_FACES = np.array(_EDGES)
_FACE_AXIS = np.array([axis for axis, _ in _FACES])
_FACE_ACROSS = np.array([[(axis + 1) % 3, (axis + 2) % 3] for axis, _ in _FACES])
_FACE_SIGN = np.array([sign for _, sign in _FACES], dtype=float)
_EDGE_AXIS = np.array([3 - _FACES[i][0] - _FACES[j][0] for i, j in _EDGES])
_NEAREST = 1e-3
"""A body nearer to the camera's plane fills the image, m."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A box within the image.

    Attributes:
        window: its rows and columns of the image; (h, w) below.
        covered: (h, w) share of each pixel, 0 to 1.
        inverse: (h, w) 1/m, 1/z on its surface, valid where a pixel is covered.
        shares: (h, w) each, of the visible faces: each face's part of the covered share; (F,).
        faces: (F,) numbers of these faces: axis 0, 1, 2 and −/+ as 2 axis + (0 or 1).
        normals: (F, 3) outward, in the optical frame.
    """

    window: tuple[slice, slice]
    covered: Array32
    inverse: Array32
    shares: tuple[Array32 | float, ...]
    faces: tuple[int, ...]
    normals: Array


class Rays:
    """The ray of every pixel of a camera."""

    def __init__(self, intrinsics: Intrinsics) -> None:
        self.focal = (intrinsics.fx, intrinsics.fy)
        self.shape = (intrinsics.height, intrinsics.width)
        across = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
        down = (np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy
        if intrinsics.distortion:
            seen = np.stack(np.broadcast_arrays(across[None, :], down[:, None]), axis=-1)
            ideal = undistort(seen, intrinsics.distortion)
            self._u, self._v = (np.ascontiguousarray(ideal[..., i], dtype=np.float32) for i in (0, 1))
        else:
            self._u, self._v = across[None, :].astype(np.float32), down[:, None].astype(np.float32)
        # The range of u in each column and of v in each row, for windows that hold a box with any lens.
        margin = 4.0
        self._columns = (self._u.min(axis=0) - margin / self.focal[0], self._u.max(axis=0) + margin / self.focal[0])
        self._rows = (self._v.min(axis=1) - margin / self.focal[1], self._v.max(axis=1) + margin / self.focal[1])

    def linear(self, vector: Array, window: tuple[slice, slice] = (slice(None), slice(None))) -> Array32:
        """Return (h, w) vector·(u, v, 1) over a window."""
        rows, columns = window
        if self._u.shape[0] > 1:
            u, v = self._u[rows, columns], self._v[rows, columns]
        else:
            u, v = self._u[:, columns], self._v[rows]
        x, y, z = (np.float32(part) for part in vector)
        return np.asarray(u * x + (v * y + z), dtype=np.float32)

    def window(self, corners: Array) -> tuple[slice, slice] | None:
        """Return rows and columns of a convex body with corners (N, 3) m; None if it is out of sight."""
        if corners[:, 2].max() <= _NEAREST:
            return None
        if corners[:, 2].min() <= _NEAREST:
            return slice(0, self.shape[0]), slice(0, self.shape[1])
        u, v = corners[:, 0] / corners[:, 2], corners[:, 1] / corners[:, 2]
        columns = np.flatnonzero((self._columns[0] <= u.max()) & (self._columns[1] >= u.min()))
        rows = np.flatnonzero((self._rows[0] <= v.max()) & (self._rows[1] >= v.min()))
        if not len(columns) or not len(rows):
            return None
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)

    def per_pixel(self, vector: Array) -> float:
        """Return the change of vector·(u, v, 1) per pixel, in the middle of an undistorted image."""
        return float(np.hypot(vector[0] / self.focal[0], vector[1] / self.focal[1])) or 1e-30

    def cast(self, pose: Array, size: tuple[float, float, float], edge_width: float) -> Piece | None:
        """Return the visible part of a box with (4, 4) pose in the optical frame; None if there is none.

        Args:
            pose: of its centre.
            size: (3,) m.
            edge_width: px of an edge's ramp.
        """
        axes, centre, half = pose[:3, :3].T, pose[:3, 3], np.asarray(size) / 2
        window = self.window(centre + (_SIGN * half) @ axes)
        if window is None:
            return None
        normals = _FACE_SIGN[:, None] * axes[_FACE_AXIS]
        heights = normals @ centre + half[_FACE_AXIS]
        # A face without area has no outline, and its plane would cut off pixels that an edge half covers.
        seen = (heights < -1e-9) & (half[_FACE_ACROSS].prod(axis=1) > 0.0)
        if not seen.any():
            return None
        covered = self._covered(axes, centre, half, seen, window, edge_width)
        if covered is None:
            return None
        faces = np.flatnonzero(seen)
        planes = normals[faces] / heights[faces, None]
        inverses = [self.linear(plane, window) for plane in planes]
        inverse = inverses[0]
        for other in inverses[1:]:
            inverse = np.asarray(np.minimum(inverse, other))
        shares = self._shares(planes, inverses, edge_width)
        return Piece(window, covered, inverse, shares, tuple(int(face) for face in faces), normals[faces])

    def _covered(
        self,
        axes: Array,
        centre: Array,
        half: Array,
        seen: Mask,
        window: tuple[slice, slice],
        edge_width: float,
    ) -> Array32 | None:
        first, second = _EDGE_FACES.T
        outline = np.flatnonzero(seen[first] != seen[second])
        first, second = first[outline], second[outline]
        towards = (_FACE_SIGN * half[_FACE_AXIS])[:, None] * axes[_FACE_AXIS]
        planes = np.cross(centre + towards[first] + towards[second], axes[_EDGE_AXIS[outline]])
        planes *= np.where(planes @ centre < 0, -1.0, 1.0)[:, None]
        covered: Array32 | None = None
        for plane in planes:
            distance = self.linear(plane / (edge_width * self.per_pixel(plane)), window)
            if covered is None:
                covered = distance
            else:
                np.minimum(covered, distance, out=covered)
        if covered is None:
            return None
        covered += np.float32(0.5)
        np.clip(covered, 0.0, 1.0, out=covered)
        return covered

    def _shares(self, planes: Array, inverses: list[Array32], edge_width: float) -> tuple[Array32 | float, ...]:
        """Return each visible face's share of covered pixels: the smallest 1/z counts, with edges blended."""
        if len(planes) == 1:
            return (1.0,)
        found: list[Array32] = []
        for i, plane in enumerate(planes):
            share: Array32 = np.full(inverses[i].shape, 1.0, dtype=np.float32)
            for j, other in enumerate(planes):
                if j == i:
                    continue
                ahead: Array32 = inverses[j] - inverses[i]
                ahead *= np.float32(1.0 / (edge_width * self.per_pixel(other - plane)))
                ahead += np.float32(0.5)
                np.minimum(share, ahead, out=share)
            np.maximum(share, np.float32(0.0), out=share)
            found.append(share)
        total: Array32 = np.asarray(np.sum(found, axis=0, dtype=np.float32))
        np.maximum(total, np.float32(1e-6), out=total)
        return tuple(share / total for share in found)


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
