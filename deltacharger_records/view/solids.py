# SPDX-License-Identifier: Apache-2.0
"""Shaded boxes and bars seen from afar: enough to draw the mechanism without a 3D library."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_records.view.shapes import Boxes, Color

_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_FACES = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
_AMBIENT = 0.62  # share of its colour that an unlit face shows
_LIGHT = np.array([0.4, 0.8, -0.45]) / np.linalg.norm([0.4, 0.8, -0.45])


class Solids:
    """Coloured faces with four corners.

    Attributes:
        corners: (n, 4, 3) m.
        colours: (n, 3), red, green, blue, 0 to 1.
    """

    def __init__(self) -> None:
        self.corners: Array = np.empty((0, 4, 3))
        self.colours: Array = np.empty((0, 3))

    def add(self, boxes: Boxes, place: Sequence[float] = (0.0, 0.0, 0.0), turn: float = 0.0) -> None:
        """Add the boxes of a frame at `place` (m), turned about z by `turn` (rad)."""
        centres, sizes = np.asarray(boxes.centres, dtype=float), np.asarray(boxes.sizes, dtype=float)
        quaternions = np.asarray(boxes.turns, dtype=float)
        angles = 2.0 * np.arctan2(quaternions[:, 2], quaternions[:, 3])
        local = 0.5 * sizes[:, None, :] * _SIGNS
        points = _about_z(_about_z(local, angles) + centres[:, None, :], np.full(len(centres), turn))
        self._append(points + np.asarray(place), boxes.colours)

    def add_bars(self, lines: Array, radius: float, colour: Color) -> None:
        """Add bars of square section (2 `radius` wide, m) along lines (n, 2, 3) m."""
        lines = np.asarray(lines, dtype=float)
        along = lines[:, 1] - lines[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        least = np.eye(3)[np.argmin(np.abs(along), axis=1)]
        aside = np.cross(along, least)
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        third = np.cross(along, aside)
        middle, half = lines.mean(axis=1), 0.5 * np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
        axes = np.stack([radius * aside, radius * third, half[:, None] * along], axis=1)
        self._append(middle[:, None, :] + _SIGNS @ axes, [colour] * len(lines))

    def seen(self, eye: Sequence[float], up: Sequence[float]) -> tuple[Array, Array]:
        """Return the projected faces (n, 4, 2) m, the farthest first, and their colours (n, 3).

        Args:
            eye: direction to the viewer, who is far away.
            up: vertical direction of the picture.
        """
        toward = np.asarray(eye, dtype=float) / np.linalg.norm(eye)
        right = np.cross(up, toward)
        right /= np.linalg.norm(right)
        basis = np.stack([right, np.cross(toward, right), toward])
        points = self.corners @ basis.T
        normals = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 3] - self.corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        normals *= np.where(normals @ toward < 0.0, -1.0, 1.0)[:, None]
        light = _AMBIENT + (1.0 - _AMBIENT) * np.clip(normals @ _LIGHT, 0.0, 1.0)
        order = np.argsort(points[:, :, 2].mean(axis=1), kind="stable")
        return points[order, :, :2], np.clip(self.colours * light[:, None], 0.0, 1.0)[order]

    def _append(self, points: Array, colours: Sequence[Color]) -> None:
        """Add boxes by their eight corners (n, 8, 3)."""
        self.corners = np.concatenate([self.corners, points[:, _FACES].reshape(-1, 4, 3)])
        self.colours = np.concatenate([self.colours, np.repeat(np.asarray(colours) / 255.0, len(_FACES), axis=0)])


def _about_z(points: Array, angles: Array) -> Array:
    """Return points (n, m, 3), turned about z by `angles` (n,) rad."""
    cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)
